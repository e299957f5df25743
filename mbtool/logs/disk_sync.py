"""Syncs a growing file to the disk in a thread of its own, as a sync can take seconds."""

# One sync runs at a time. Requests that come during a sync are served together by one more sync
# after it. The thread starts with the first request. A log that is converted from a file requests
# none, so it has no thread.

from __future__ import annotations

import os
from threading import Event, Thread
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from collections.abc import Callable

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
