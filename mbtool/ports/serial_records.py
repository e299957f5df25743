"""The records that a process that reads serial ports sends through a pipe to its parent process."""

# The layout of a record:
#
#     kind     time                length     data
#     1 byte   8 bytes, signed     4 bytes    length bytes        little-endian
#
#     DATA     one read of the port, with the time taken right after it
#     QUIET    no data; the line was silent up to this time. The first QUIET tells the parent that
#              the port is open
#     LOST     8 bytes: the number of bytes of the line that did not fit into the pipe
#     ERROR    why the process ends, in one line for the user, UTF-8; no record follows
#     DAMAGE   the driver's report of damaged bytes, one line, UTF-8
#     OVERRUN  8 bytes: the number of bytes that the driver has lost, as it reports
#     STOPPED  why bytes before this record may be missing, one line, UTF-8
#     ANSWER   like DATA, but from the slaves' side of a serial tap; its master's side gives DATA
#
# A record is never larger than PIPE_BUF, so a write to the pipe succeeds whole or not at all. The
# writer does not wait for the reader: while the pipe is full, records are dropped. The bytes of
# dropped DATA and ANSWER records are counted, and a LOST record with that count is written before
# the next record that fits. On Linux the pipe holds 1 MiB, if the system allows it: more than 40 s
# of a busy line at 19200 baud with a record for each character. Elsewhere it has the system's usual
# size. On Windows a write to a full pipe waits, and the driver's buffer must hold the bytes that
# arrive in the meantime.

from __future__ import annotations

import os
import select
import struct
import sys
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum

_HEADER = struct.Struct("<BqI")
_COUNT = struct.Struct("<q")
_PIPE_SIZE = 2**20

MAX_DATA = getattr(select, "PIPE_BUF", 4096) - _HEADER.size
"""The most bytes of data that a record can have, so that the record is not larger than PIPE_BUF."""


class RecordKind(IntEnum):
    """The kinds of records; the comment at the top of serial_records.py says what each means."""

    DATA = 1
    QUIET = 2
    LOST = 3
    ERROR = 4
    DAMAGE = 5
    OVERRUN = 6
    ANSWER = 7
    STOPPED = 8


_READS = frozenset((RecordKind.DATA, RecordKind.ANSWER))


@dataclass(frozen=True, slots=True)
class SerialRecord:
    """One record: its kind, its time in UTC ns, and its data."""

    kind: RecordKind
    ts_ns: int
    data: bytes = b""

    @property
    def lost(self) -> int:
        """The number in the data of a LOST or OVERRUN record: the number of lost bytes."""
        count: int = _COUNT.unpack(self.data)[0]
        return count


class RecordWriter:
    """Writes records into a pipe.

    Its methods raise BrokenPipeError once the reader has closed the pipe.
    """

    def __init__(self, pipe: int) -> None:
        self._pipe = pipe
        self._lost = 0
        if sys.platform == "linux":
            import fcntl

            with suppress(OSError):
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_SIZE)
        self._let_writes_wait(False)

    def put(self, kind: RecordKind, ts_ns: int, data: bytes = b"") -> None:
        """Write a record with its time in UTC ns; if the pipe is full, drop the record.

        The bytes of a dropped DATA or ANSWER record are counted for the next LOST record.
        """
        if self._lost and self._write(RecordKind.LOST, ts_ns, _COUNT.pack(self._lost)):
            self._lost = 0
        if self._lost or not self._write(kind, ts_ns, data):
            self._lost += len(data) if kind in _READS else 0

    def put_count(self, kind: RecordKind, ts_ns: int, count: int) -> None:
        """Write a record whose data is the number `count`, with its time in UTC ns."""
        self.put(kind, ts_ns, _COUNT.pack(count))

    def end(self, ts_ns: int, error: str = "") -> None:
        """Write a LOST record for bytes not yet reported, then an ERROR record with `error`.

        Without lost bytes there is no LOST record, with an empty `error` no ERROR record. The
        method waits until the pipe has room.
        """
        self._let_writes_wait(True)
        if self._lost:
            self._write(RecordKind.LOST, ts_ns, _COUNT.pack(self._lost))
        if error:
            self._write(RecordKind.ERROR, ts_ns, error.encode()[:MAX_DATA])

    def _let_writes_wait(self, wait: bool) -> None:
        if sys.platform != "win32":
            os.set_blocking(self._pipe, wait)

    def _write(self, kind: RecordKind, ts_ns: int, data: bytes) -> bool:
        try:
            os.write(self._pipe, _HEADER.pack(kind, ts_ns, len(data)) + data)
        except BlockingIOError:
            return False
        return True


class RecordReader:
    """Splits the bytes from the pipe into records; keeps an incomplete record for the next call."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[SerialRecord]:
        """Take data from the pipe; return the records that are now complete."""
        buffer = self._buffer + data
        records = []
        start = 0
        while len(buffer) - start >= _HEADER.size:
            kind, ts_ns, length = _HEADER.unpack_from(buffer, start)
            end = start + _HEADER.size + length
            if end > len(buffer):
                break
            records.append(
                SerialRecord(RecordKind(kind), ts_ns, buffer[start + _HEADER.size : end])
            )
            start = end
        self._buffer = buffer[start:]
        return records
