"""Writes a file that is a complete MCAP file at every moment, even if its writer is killed."""

# Layout while the file grows (docs/decisions/0001-always-complete-log.md):
#
#     records so far | DataEnd Footer magic            the tail, 50 bytes; the summary is empty
#
# New records replace the tail, and are written back to front:
#
#     1  the new tail, at its final place: readers still stop at the old tail, and the file has a
#        valid end
#     2  everything between the old tail and the new one
#     3  the 50 bytes of the old tail, which makes all new records visible at once
#
# A tail must not be written in part. So a filler record (a private record of a few bytes) is
# inserted where needed to keep each tail inside one 512-byte sector: the kernel stops the write of
# a killed process only between pages, and a disk that loses power writes a sector entirely or not
# at all. If the disk is full, step 3 never happens and the file stays as it was. All steps may be
# repeated once there is room.

from __future__ import annotations

import errno
import os
import zlib
from collections.abc import Callable
from threading import Event, Thread
from typing import BinaryIO

from mbtool.core import OutputError
from mbtool.core.errors import reason_of
from mbtool.logs.layout import (
    DATA_END_SIZE,
    FOOTER_SIZE,
    RECORD_HEAD,
    TAIL_SIZE,
    data_end,
    empty_record,
    footer,
)

# The code below syncs a growing file to the disk in a thread of its own, as a sync can take
# seconds.
#
# One sync runs at a time. Requests that come during a sync are served together by one more sync
# after it. The thread starts with the first request. A log that is converted from a file requests
# none, so it has no thread.

sync_data = os.fdatasync if hasattr(os, "fdatasync") else os.fsync


class DiskSync:
    """Syncs one file to the disk, in a thread, when asked to."""

    def __init__(self, hold: Callable[[], BinaryIO]) -> None:
        """`hold` returns a new handle of the file, which the sync thread closes at its end."""
        self._hold = hold
        self._thread: Thread | None = None
        self._wanted = Event()
        self._is_closing = False
        self._error: OSError | None = None

    def request(self) -> None:
        """Ask for a sync of everything written so far, and return at once.

        If an earlier sync has failed, raises its OSError.
        """
        if self._error is not None:
            raise self._error
        if self._thread is None:
            self._thread = Thread(target=self._run, args=(self._hold(),), daemon=True)
            self._thread.start()
        self._wanted.set()

    def close(self) -> None:
        """End the thread and wait until its present sync is done. A second call does nothing.

        A sync that was requested and has not begun is left out.
        """
        self._is_closing = True
        self._wanted.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self, file: BinaryIO) -> None:
        with file:
            while True:
                self._wanted.wait()
                self._wanted.clear()
                if self._is_closing:
                    return
                try:
                    sync_data(file.fileno())
                except OSError as error:
                    self._error = error
                    return


SECTOR = 512
DISK_FULL = frozenset({errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)})


class CompleteFile:
    """A growing MCAP file that has a valid end after each write, even if the process is killed."""

    def __init__(
        self, file: BinaryIO, name: str, head: bytes, make_room: Callable[[], bool] = lambda: False
    ) -> None:
        """Begin the file with `head` (the MCAP magic bytes and the first records) and a valid end.

        `file` is empty and unbuffered; `close` closes it. `name` appears in error messages.
        `make_room` is called when the disk is full; it returns True if it has removed another file.
        Raises OutputError if the file cannot be written.
        """
        self._make_room = make_room
        self._file = file
        self._name = name
        self._failure: OutputError | None = None
        self._disk = DiskSync(self.hold)
        head += _padding(len(head), TAIL_SIZE, 0)
        self.position = len(head)
        """The file offset at which the next record will be written."""
        self._crc = zlib.crc32(head)
        try:
            self._guarded(lambda: self._write(0, head + data_end(self._crc) + footer()))
        except OutputError:
            file.close()
            raise

    @property
    def size(self) -> int:
        return self.position + TAIL_SIZE

    @property
    def closed(self) -> bool:
        return self._file.closed

    def hold(self) -> BinaryIO:
        """Return a second handle of the open file, which the caller closes.

        The file stays locked until both handles are closed.
        """
        return open(os.dup(self._file.fileno()), "wb", buffering=0)

    def append(self, records: bytes, *, sync: bool) -> None:
        """Add records to the file; with `sync`, return only when they are on the disk.

        Raises OutputError if they cannot be written. Readers then still see the file as it was
        before, and every later write raises the same error.
        """
        records += _padding(self.position + len(records), TAIL_SIZE, TAIL_SIZE - len(records))
        crc = zlib.crc32(records, self._crc)
        new = records + data_end(crc) + footer()
        self._guarded(lambda: self._replace(self.position, new, TAIL_SIZE, sync=sync))
        self.position += len(records)
        self._crc = crc

    def sync_soon(self) -> None:
        """Ask for a sync of the added records to the disk, without waiting for it.

        Raises OutputError if an earlier write or sync has failed.
        """
        self._guarded(self._disk.request, is_sync=True)

    def finish(self, summary: Callable[[int], tuple[bytes, bytes]]) -> None:
        """Add the summary section, and return when it is on the disk.

        `summary` takes the offset at which the section starts and returns the section and its
        footer; their lengths must not depend on the offset. Raises OutputError if they cannot be
        written.
        """
        length = DATA_END_SIZE + len(summary(0)[0])
        if not _fits(self.position + length, FOOTER_SIZE):
            # The footer behind the summary would cross the boundary of a 512-byte sector. So a
            # filler record moves it. The size of the filler is chosen such that neither this
            # footer nor the tail (DataEnd and Footer) behind the filler crosses a boundary.
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
            # Until the summary is on the disk, the file ends in a footer that says "no summary", so
            # that it can be read at any moment.
            self._replace(start, section + footer(), FOOTER_SIZE, sync=True)
            self._write(start + len(section), end)
            self._sync()

        self._guarded(write)

    def close(self) -> None:
        self._disk.close()
        self._file.close()

    def _guarded(self, write: Callable[[], None], *, is_sync: bool = False) -> None:
        if self._failure is not None:
            raise self._failure
        while True:
            try:
                write()
            except OSError as error:
                # Free space cannot repair a failed sync, so only a failed write is tried again.
                if not is_sync and error.errno in DISK_FULL and self._make_room():
                    continue
                self._failure = self._error(error)
                raise self._failure from error
            return

    def _replace(self, at: int, new: bytes, old_size: int, *, sync: bool) -> None:
        """Replace the end of the file, from offset `at` on, by the longer `new`.

        `old_size` is the number of bytes in the file from `at` on. The new bytes are written back
        to front, so that the old end stays valid until the last step: first the last `old_size`
        bytes of `new`, then its middle, and last the first `old_size` bytes, over the old end. With
        `sync` the new bytes are on the disk before the last step, and all when the method returns.
        """
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
        sync_data(self._file.fileno())

    def _error(self, error: OSError) -> OutputError:
        return OutputError(
            f"{self._name}: the log cannot be written: {reason_of(error)}; "
            "what was written before can be read"
        )


def _padding(end: int, tail: int, minimum: int) -> bytes:
    """Make a filler record so that the tail after it does not cross a 512-byte sector boundary.

    `end` is the file offset at which the record begins, `tail` the size of the tail in bytes. The
    record has at least `minimum` bytes. Returns b"" if `minimum` is not above 0 and a tail at `end`
    crosses no boundary.
    """
    size = max(minimum, RECORD_HEAD.size) if minimum > 0 else 0
    if not _fits(end + size, tail):
        size = max(size + SECTOR - (end + size) % SECTOR, RECORD_HEAD.size)
    return empty_record(size) if size else b""


def _fits(start: int, size: int) -> bool:
    """True if the `size` bytes from file offset `start` on are inside one 512-byte sector."""
    return start % SECTOR + size <= SECTOR
