"""The base class of all shells: a thread that answers requests on a link until it is stopped."""

# A shell owns the sockets or the port, and the clock; the responder decides what to answer. Only
# the shell's thread may call the responder, so two shells never share one.

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
"""Called in the shell's thread with each request and its response; None for no response."""

STOP_TIMEOUT_S = 5.0


class Shell(ABC):
    """Answers requests on a link between `start` and `stop`, or inside a `with` statement."""

    def __init__(self) -> None:
        self.turned_away = 0
        """The number of connections refused so far because `places` masters were connected."""
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None

    @property
    @abstractmethod
    def place(self) -> str:
        """The link as text for the user; a TCP port 0 is replaced by the port that the system
        chose.
        """

    @property
    def places(self) -> int:
        """The number of masters that may be connected at once; 1 on a serial line."""
        return 1

    def notes(self) -> list[str]:
        """Messages for the user on what has happened to connections since the last call."""
        return []

    def start(self) -> None:
        """Open the link and begin to answer.

        Raises LinkError if the link cannot be opened, UsageError if other machines can reach a TCP
        endpoint and none is allowed to connect.
        """
        if self._thread is not None:
            raise RuntimeError("a shell is started once")
        self._open()
        self._thread = threading.Thread(target=self._run_to_end, name="slave", daemon=True)
        self._thread.start()

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until the shell has ended, or `timeout_s` seconds have passed.

        If an error ended the shell, it is raised: LinkError if the link was lost.
        """
        if self._thread is not None:
            self._thread.join(timeout_s)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Stop answering, and close the link. A second call does nothing."""
        if self._thread is not None and self._thread.is_alive():
            with suppress(RuntimeError):  # RuntimeError: its event loop was closed meanwhile.
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
        """Open the link, in the thread that calls `start`.

        Raises LinkError or UsageError, as `start` describes.
        """

    @abstractmethod
    def _run(self) -> None:
        """Answer until `_interrupt` is called, then close the link.

        Raises LinkError if the link is lost.
        """

    @abstractmethod
    def _interrupt(self) -> None:
        """Make `_run` return soon. Called from another thread than `_run`."""
