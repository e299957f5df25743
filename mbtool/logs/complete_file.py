"""A file that is a complete MCAP file at every moment, however its writer ends."""

# Layout while it grows (docs/decisions/0001-always-complete-log.md):
#
#     records so far | DataEnd Footer magic            the tail, 50 bytes; the summary is empty
#
# Strategy: more records replace the tail back to front. First the tail is written where it will
# end; readers stop at the old one, and the file ends as a file must. Then all between. Last the
# old tail's own 50 bytes, which makes everything visible at once. A private record of a few bytes
# keeps every tail inside one 512-byte sector: a kernel that is told to kill a process stops a
# write between pages only, and a disk that loses power writes a sector or does not. What the disk
# has no room for is never in view, so there is nothing to repair.

from __future__ import annotations

import os
import zlib
from typing import TYPE_CHECKING, BinaryIO

from mbtool.core import OutputError
from mbtool.logs.layout import (
    DATA_END_SIZE,
    FOOTER_SIZE,
    RECORD_HEAD,
    TAIL_SIZE,
    data_end,
    empty_record,
    footer,
)

if TYPE_CHECKING:
    from collections.abc import Callable

SECTOR = 512

_sync_data = os.fdatasync if hasattr(os, "fdatasync") else os.fsync


class CompleteFile:
    """Grows by whole records. `file` is empty, unbuffered, and closed by `close`."""

    def __init__(self, file: BinaryIO, name: str, head: bytes) -> None:
        """Write the magic and the first records, `head`. Raises OutputError."""
        self._file = file
        self._name = name
        self._failure: OutputError | None = None
        head += _padding(len(head), TAIL_SIZE, 0)
        self.position = len(head)
        """Where the next record goes."""
        self._crc = zlib.crc32(head)
        try:
            self._write(0, head + data_end(self._crc) + footer())
        except OSError as error:
            file.close()
            raise self._error(error) from error

    @property
    def size(self) -> int:
        return self.position + TAIL_SIZE

    @property
    def closed(self) -> bool:
        return self._file.closed

    def hold(self) -> BinaryIO:
        """The file once more, with the lock that it has."""
        return open(os.dup(self._file.fileno()), "wb", buffering=0)

    def append(self, records: bytes, *, sync: bool) -> None:
        """Add records; with `sync`, they are on the disk afterwards. Raises OutputError.

        After an error the file is as it was and takes no more: each later write raises that error,
        so that the reason is told whichever of them comes to be the last.
        """
        records += _padding(self.position + len(records), TAIL_SIZE, TAIL_SIZE - len(records))
        crc = zlib.crc32(records, self._crc)
        new = records + data_end(crc) + footer()
        self._guarded(lambda: self._replace(self.position, new, TAIL_SIZE, sync=sync))
        self.position += len(records)
        self._crc = crc

    def finish(self, summary: Callable[[int], tuple[bytes, bytes]]) -> None:
        """Add the summary section: `summary` makes it and its footer, given where it starts.

        Its length must not depend on where that is. Raises OutputError.
        """
        length = DATA_END_SIZE + len(summary(0)[0])
        if not _fits(self.position + length, FOOTER_SIZE):
            # Few positions are bad for a tail or a footer, so one of a sector's is good for both.
            size = next(
                size
                for size in range(TAIL_SIZE, TAIL_SIZE + SECTOR)
                if _fits(self.position + size, TAIL_SIZE)
                and _fits(self.position + size + length, FOOTER_SIZE)
            )
            self.append(empty_record(size), sync=False)
        start = self.position + DATA_END_SIZE
        section, end = summary(start)

        def write() -> None:
            # The empty footer keeps the file readable from its start until the summary stands.
            self._replace(start, section + footer(), FOOTER_SIZE, sync=True)
            self._write(start + len(section), end)
            self._sync()

        self._guarded(write)

    def close(self) -> None:
        self._file.close()

    def _guarded(self, write: Callable[[], None]) -> None:
        if self._failure is not None:
            raise self._failure
        try:
            write()
        except OSError as error:
            self._failure = self._error(error)
            raise self._failure from error

    def _replace(self, at: int, new: bytes, old_size: int, *, sync: bool) -> None:
        """Replace the last `old_size` bytes of the file, which stand at `at`, back to front."""
        end = len(new) - old_size
        self._write(at + end, new[end:])
        self._write(at + old_size, new[old_size:end])
        if sync:
            self._sync()
        self._write(at, new[:old_size])
        if sync:
            self._sync()

    def _write(self, at: int, data: bytes) -> None:
        self._file.seek(at)
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]

    def _sync(self) -> None:
        _sync_data(self._file.fileno())

    def _error(self, error: OSError) -> OutputError:
        return OutputError(
            f"{self._name}: the log cannot be written: {error.strerror or error}; "
            "what was written before can be read"
        )


def _padding(end: int, tail: int, minimum: int) -> bytes:
    """A private record of at least `minimum` bytes after which a tail fits into one sector."""
    size = max(minimum, RECORD_HEAD.size) if minimum > 0 else 0
    if not _fits(end + size, tail):
        size = max(size + SECTOR - (end + size) % SECTOR, RECORD_HEAD.size)
    return empty_record(size) if size else b""


def _fits(start: int, size: int) -> bool:
    return start % SECTOR + size <= SECTOR
