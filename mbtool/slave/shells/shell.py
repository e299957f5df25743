"""What all slaves share: a link that a thread of its own answers on, until it is stopped."""

# A shell owns the link and the clock; the responder decides what to answer. Only the shell's thread
# calls the responder, so each shell has a responder of its own.

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from types import TracebackType

    from mbtool.modbus.adu import Adu
    from mbtool.modbus.response import Response

OnExchange = Callable[["Adu", "Response | None"], None]
"""Called in the shell's thread with each request, and the response, or None if there is none."""

STOP_TIMEOUT_S = 5.0


class Shell(ABC):
    """Answers on a link between `start` and `stop`, or inside `with`."""

    def __init__(self) -> None:
        self.turned_away = 0
        """How many connections were closed because `places` others were open."""
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None

    @property
    @abstractmethod
    def place(self) -> str:
        """The link, as opened: with the port that the system chose where 0 was asked for."""

    @property
    def places(self) -> int:
        """How many masters may be connected at once; a serial line has one."""
        return 1

    def notes(self) -> list[str]:
        """What has happened to connections since the last call, in sentences for the user."""
        return []

    def start(self) -> None:
        """Open the link and begin to answer. Raises LinkError, UsageError."""
        if self._thread is not None:
            raise RuntimeError("a shell is started once")
        self._open()
        self._thread = threading.Thread(target=self._run_to_end, name="slave", daemon=True)
        self._thread.start()

    def wait(self, timeout_s: float | None = None) -> None:
        """Return when the shell has ended or the time is over.

        Raises the error that ended it: LinkError for a lost link.
        """
        if self._thread is not None:
            self._thread.join(timeout_s)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End, and close the link. A second call does nothing."""
        if self._thread is not None and self._thread.is_alive():
            with suppress(RuntimeError):  # Its event loop has just been closed.
                self._interrupt()
            self._thread.join(STOP_TIMEOUT_S)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()

    def _run_to_end(self) -> None:
        try:
            self._run()
        except Exception as error:
            self._failure = error

    @abstractmethod
    def _open(self) -> None:
        """Open the link, in the caller's thread. Raises LinkError or UsageError."""

    @abstractmethod
    def _run(self) -> None:
        """Answer until interrupted, and close the link. Raises LinkError if the link is lost."""

    @abstractmethod
    def _interrupt(self) -> None:
        """Make `_run` return soon; called from another thread."""
