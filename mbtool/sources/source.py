"""The base class of all live sources: serial ports, network interfaces and taps."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from threading import Thread
from typing import TYPE_CHECKING, Generic, Self, TypeVar

from mbtool.core import InterfaceLink, SerialLink, TapLink
from mbtool.core.closing import ClosesOnExit

if TYPE_CHECKING:
    from mbtool.sources.inbox import Sink

HeardLink = TypeVar("HeardLink", bound=SerialLink | InterfaceLink | TapLink)


class LiveSource(ClosesOnExit, Generic[HeardLink]):
    """Puts captured chunks or packets into an inbox while its context is open; Ended comes last.

    Entering the context raises LinkError if the link cannot be opened. Leaving it waits until
    everything captured is in the inbox.
    """

    def __init__(self, link: HeardLink, inbox: Sink) -> None:
        self._link = link
        self._inbox = inbox
        self._thread: Thread | None = None
        self.is_lost = False
        """True while the link is lost and this source tries to open it again."""

    @property
    def link(self) -> str:
        """The link's name, which each item of this source carries."""
        return self._link.name

    @property
    def place(self) -> str:
        """The link as text, with the port that the system chose in place of TCP port 0."""
        return str(self._link)

    def __enter__(self) -> Self:
        self.open()
        return self

    @abstractmethod
    def open(self) -> None:
        """Open the link and begin to listen. Raises LinkError if the link cannot be opened."""

    def accept(self) -> None:
        """Let masters connect, if this source is a tap; other sources do nothing."""

    @abstractmethod
    def close(self) -> None:
        """Stop capturing, and put everything captured, followed by Ended, into the inbox.

        A second call does nothing.
        """

    def _start_thread(self, run: Callable[[], None]) -> None:
        self._thread = Thread(target=run, name=f"source {self.link}", daemon=True)
        self._thread.start()
