"""Writes text to a terminal or pipe from a thread of its own, so that no caller waits for it."""

# A terminal that is stopped (Ctrl-S), a pager or a hanging ssh takes no more text, and a write to
# it then waits. A recording must not wait. So the text goes into a queue, and one thread writes it
# to the file descriptor. When the queue holds MAX_WAITING bytes it is full, until half of it has
# been written: few large gaps in the output are easier to read than many small ones. A full queue
# still takes text, but its owner should check `is_full` and leave out whole rows.
#
# The thread writes to the descriptor and not to Python's file object. It may wait there for ever,
# and the interpreter could not end while a thread holds the lock of a file object.

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from io import UnsupportedOperation
from threading import Condition, Thread
from time import monotonic
from typing import TextIO, cast

MAX_WAITING = 2**20
"""The queue is full at this many bytes of text: about 10,000 rows."""
STUCK_S = 0.5
"""After the user has asked for the end, the command stops waiting for a reader that takes no text
for this many seconds."""
HURRY_S = 1.0
"""After the user has asked for the end, the command waits at most this many seconds in all for the
reader to take the remaining text."""
_LOOK_S = 0.05
_PIECE = 2**12
"""Bytes in one write: a pipe that has any room takes this many at once."""


class ViewQueue:
    """A text file whose writes do not wait: its own thread writes the text.

    An error of that thread is raised by the next call of `write`, `flush` or `drain`.
    """

    def __init__(self, file: TextIO) -> None:
        """`file` is open and has a file descriptor; nobody else writes to it."""
        file.flush()
        self._file = file
        self._descriptor = file.fileno()
        self.encoding = file.encoding
        self._waiting: deque[bytes] = deque()
        self._size = 0
        self._is_full = False
        self._written = 0
        """The number of pieces of text written to the file so far. While it stays the same, the
        reader of the terminal or pipe takes no text."""
        self._is_idle = True
        self._error: OSError | None = None
        self._changed = Condition()
        Thread(target=self._run, name="view", daemon=True).start()

    @property
    def is_full(self) -> bool:
        """True if no more text should be written, as the reader takes it too slowly."""
        return self._is_full

    def isatty(self) -> bool:
        return self._file.isatty()

    def fileno(self) -> int:
        return self._descriptor

    def write(self, text: str) -> int:
        """Put text into the queue, and return its number of characters.

        Raises the OSError with which the thread failed to write earlier text.
        """
        self.flush()
        data = text.encode(self.encoding, "backslashreplace")
        if data:
            with self._changed:
                self._waiting.append(data)
                self._size += len(data)
                self._is_full = self._is_full or self._size >= MAX_WAITING
                self._is_idle = False
                self._changed.notify_all()
        return len(text)

    def flush(self) -> None:
        """Raise the OSError with which the thread failed, if any; does not wait for the queue."""
        if self._error is not None:
            raise self._error

    def drain(self, is_hurried: Callable[[], bool]) -> bool:
        """Wait until the whole queue is written; return False if it gave up before that.

        Once `is_hurried` returns True, stop waiting after HURRY_S, or sooner when the reader takes
        nothing for STUCK_S. Raises the OSError of a write.
        """
        stuck_s, hurried_s, written = 0.0, 0.0, -1
        with self._changed:
            while not self._is_idle and self._error is None:
                if stuck_s >= STUCK_S or hurried_s >= HURRY_S:
                    break
                begin_s = monotonic()
                self._changed.wait(_LOOK_S)
                passed_s = monotonic() - begin_s
                stuck_s = stuck_s + passed_s if is_hurried() and written == self._written else 0
                hurried_s += passed_s if is_hurried() else 0
                written = self._written
        self.flush()
        return self._is_idle

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: bool(self._waiting))
                    data = b"".join(self._waiting)
                    self._waiting.clear()
                self._write(data)
        except OSError as error:
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            count = os.write(self._descriptor, rest[:_PIECE])
            rest = rest[count:]
            with self._changed:
                self._written += 1
                self._size -= count
                self._is_full = self._is_full and self._size > MAX_WAITING // 2
                self._is_idle = not self._size
                self._changed.notify_all()


def unwaited(file: TextIO) -> TextIO:
    """Return a file whose writes do not wait; `file` itself if it has no file descriptor."""
    try:
        queue = ViewQueue(file)
    except (UnsupportedOperation, ValueError):  # A file in memory, or a closed one.
        return file
    # ViewQueue has the methods of TextIO that printers use: write, flush, isatty, fileno, encoding.
    return cast("TextIO", queue)
