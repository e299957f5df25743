"""What plays a responder on a link: opened, run in a thread of its own, and stopped."""

# A shell owns the link and the clock; what to answer is the responder's matter. The responder is
# called from the shell's thread only, so one responder belongs to one shell.

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
"""Gets each request that was heard, and the answer or None for silence, in the shell's thread."""

STOP_TIMEOUT_S = 5.0


class Shell(ABC):
    """Answers on a link between `start` and `stop`, or inside `with`."""

    def __init__(self) -> None:
        self.turned_away = 0
        """How many connections were closed at once, because as many as `places` were open."""
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None

    @property
    @abstractmethod
    def place(self) -> str:
        """The link it answers on, as opened: with the port it was given, where it asked for 0."""

    @property
    def places(self) -> int:
        """How many masters it takes at once: a line has one."""
        return 1

    def notes(self) -> list[str]:
        """What it has done by the device's rules since the last time, in sentences for the user."""
        return []

    def start(self) -> None:
        """Open the link and begin to answer. Raises LinkError or UsageError."""
        if self._thread is not None:
            raise RuntimeError("a shell is started once")
        self._open()
        self._thread = threading.Thread(target=self._run_to_end, name="slave", daemon=True)
        self._thread.start()

    def wait(self, timeout_s: float | None = None) -> None:
        """Return when the shell has ended or the time is over.

        Raises what ended it: LinkError for a lost link.
        """
        if self._thread is not None:
            self._thread.join(timeout_s)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End, and give the link free. Does nothing the second time."""
        if self._thread is not None and self._thread.is_alive():
            with suppress(RuntimeError):  # It has just ended, and its event loop with it.
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
        """Answer until interrupted, and close the link. Raises LinkError where it is lost."""

    @abstractmethod
    def _interrupt(self) -> None:
        """Make `_run` return soon; called from another thread."""
