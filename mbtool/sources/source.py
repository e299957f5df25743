"""What all live sources have in common: their link, their inbox, and how they are opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from threading import Thread
from typing import TYPE_CHECKING, Generic, Self, TypeVar

from mbtool.core import InterfaceLink, SerialLink, TapLink

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.sources.inbox import Sink

HeardLink = TypeVar("HeardLink", bound=SerialLink | InterfaceLink | TapLink)


class LiveSource(ABC, Generic[HeardLink]):
    """Puts what it hears into an inbox while its context is open, and Ended when it has ended.

    Entering the context raises LinkError. When it is left, all that was heard is in the inbox.
    """

    def __init__(self, link: HeardLink, inbox: Sink) -> None:
        self._link = link
        self._inbox = inbox
        self._thread: Thread | None = None

    @property
    def link(self) -> str:
        """The name that its items carry."""
        return self._link.name

    @property
    def place(self) -> str:
        """The link as opened: with the port that the system chose where 0 was asked for."""
        return str(self._link)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def open(self) -> None:
        """Open the link and begin to listen. Raises LinkError."""

    def accept(self) -> None:
        """Let masters in, if it is a source that masters connect to."""

    @abstractmethod
    def close(self) -> None:
        """End; all that was heard is then in the inbox, and Ended. A second call does nothing."""

    def _start_thread(self, run: Callable[[], None]) -> None:
        self._thread = Thread(target=run, name=f"source {self.link}", daemon=True)
        self._thread.start()
