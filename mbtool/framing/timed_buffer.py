"""A byte queue that keeps the arrival time and the origin of each byte."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mbtool.core import Origin

if TYPE_CHECKING:
    import re


class TimedBuffer:
    """A queue of bytes: `append` adds at the end, `take` removes from the start.

    The bytes of one `append` share their time (ns) and their origin (packet or file).
    """

    __slots__ = ("_last_end", "_marks", "_taken", "data")

    def __init__(self) -> None:
        self.data = bytearray()
        """The bytes; only this class changes them."""
        self._taken = 0
        """The number of bytes that were removed from the start so far."""
        self._marks: deque[tuple[int, int, Origin | None]] = deque()
        """For each `append` that has bytes left in the buffer: the number of bytes ever appended up
        to its end, the time of its bytes in ns, and their origin."""
        self._last_end = 0
        """The number of bytes ever appended up to the end of the last `append` taken wholly."""

    def __len__(self) -> int:
        return len(self.data)

    def append(self, data: bytes, ts_ns: int, origin: Origin | None = None) -> None:
        if data:
            self.data += data
            self._marks.append((self._taken + len(self.data), ts_ns, origin))

    @property
    def first_ns(self) -> int:
        """The time of the first byte in ns; the buffer must not be empty."""
        return self._marks[0][1]

    def mark_at(self, index: int) -> tuple[int, Origin | None]:
        """Return the time in ns and the origin of the byte at an index of the buffer.

        Raises IndexError beyond the end.
        """
        at = bisect_left(self._marks, (self._taken + index + 1,))
        if at == len(self._marks):
            raise IndexError(index)
        return self._marks[at][1:]

    def is_append_boundary(self, index: int) -> bool:
        """True if an `append` began or ended directly before the byte at an index of the buffer."""
        place = self._taken + index
        if place == self._last_end:
            return True
        at = bisect_left(self._marks, (place,))
        return at < len(self._marks) and self._marks[at][0] == place

    def peek(self, size: int, at: int = 0) -> bytes:
        """Return up to `size` bytes from index `at` on, which stay in the buffer."""
        return bytes(self.data[at : at + size])

    def find(self, pattern: re.Pattern[bytes], at: int) -> int | None:
        """Return the index of the first match of a pattern from index `at` on; None if none."""
        match = pattern.search(self.data, at)
        return None if match is None else match.start()

    def take(self, size: int) -> bytes:
        """Remove the first `size` bytes, or all if there are fewer, and return them."""
        taken = bytes(self.data[:size])
        del self.data[:size]
        self._taken += len(taken)
        while self._marks and self._marks[0][0] <= self._taken:
            self._last_end = self._marks.popleft()[0]
        return taken

    def drain(self, size: int) -> Iterator[tuple[bytes, int]]:
        """Remove the first `size` bytes, or all if there are fewer, and yield them in pieces.

        Each piece holds bytes of one `append` and comes with their time in ns.
        """
        left = min(size, len(self.data))
        while left:
            end, ts_ns, _ = self._marks[0]
            piece = self.take(min(left, end - self._taken))
            left -= len(piece)
            yield piece, ts_ns
