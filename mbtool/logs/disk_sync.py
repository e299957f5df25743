"""Syncs a growing file to the disk in a thread of its own; on a busy disk that takes seconds."""

# One sync at a time; a request that comes meanwhile is served by one more sync behind it. The
# thread starts with the first request, so a log that is made from a file has none.

from __future__ import annotations

import os
from threading import Event, Thread
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from collections.abc import Callable

sync_data = os.fdatasync if hasattr(os, "fdatasync") else os.fsync


class DiskSync:
    """Syncs one file on request."""

    def __init__(self, hold: Callable[[], BinaryIO]) -> None:
        """`hold` returns a handle of the file that this object closes."""
        self._hold = hold
        self._thread: Thread | None = None
        self._wanted = Event()
        self._is_closing = False
        self._error: OSError | None = None

    def request(self) -> None:
        """Have everything that is written so far synced soon. Raises the OSError of a past sync."""
        if self._error is not None:
            raise self._error
        if self._thread is None:
            self._thread = Thread(target=self._run, args=(self._hold(),), daemon=True)
            self._thread.start()
        self._wanted.set()

    def close(self) -> None:
        """Wait for the sync that is under way. A second call does nothing."""
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
