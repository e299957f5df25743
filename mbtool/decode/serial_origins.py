"""Finds where the frames of a serial line stand in the file that holds its bytes."""

# The raw bytes of a splitter's events, in order, are the bytes that the splitter was fed. So counts
# of the bytes fed and of the bytes in events give the place of every frame. In a file of bytes this
# is the offset of its first byte; in a file of packets, the packet with its last byte.
#
# Memory: one mark for each read that still has bytes in the splitter.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Origin
from mbtool.modbus.adu import Adu

if TYPE_CHECKING:
    from mbtool.core import StreamPlace
    from mbtool.modbus.adu import Skipped


class SerialOrigins:
    """Counts the bytes into and out of a splitter, to find where each ADU stands in its file."""

    def __init__(self) -> None:
        self._marks: deque[tuple[int, int, StreamPlace | None]] = deque()
        """For each read that still has bytes in the splitter: the number of bytes fed before the
        read, the number fed up to its end, and its place in the file."""
        self._fed = 0
        self._given = 0

    @property
    def held(self) -> int:
        """The number of reads of which the splitter still holds bytes."""
        return len(self._marks)

    def note(self, size: int, place: StreamPlace | None) -> None:
        """Note that the splitter is fed `size` bytes, which stand at `place` in a capture file.

        `place` is None if that is unknown.
        """
        if size:
            self._marks.append((self._fed, self._fed + size, place))
            self._fed += size

    def added_to(self, events: list[Adu | Skipped]) -> list[Adu | Skipped]:
        """Return the splitter's next events, with the origin of each ADU added."""
        found: list[Adu | Skipped] = []
        for event in events:
            start, self._given = self._given, self._given + len(event.raw)
            if isinstance(event, Adu):
                found.append(replace(event, origin=self._origin(start, self._given - 1)))
            else:
                found.append(event)
            while self._marks and self._marks[0][1] <= self._given:
                self._marks.popleft()
        return found

    def _origin(self, first: int, last: int) -> Origin | None:
        """Return where an ADU stands in its file; None if that is unknown.

        `first` and `last` are the numbers of its bytes, counted from 0, among all bytes fed.
        """
        for begin, end, place in self._marks:
            if place is None or place.origin is None:
                continue
            origin = place.origin
            if not origin.packet and begin <= first < end:
                return Origin(origin.file, 0, origin.addresses, place.position + first - begin)
            if origin.packet and begin <= last < end:
                return origin
        return None
