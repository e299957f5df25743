"""Messages to the user on standard error, and how a user stops a command."""

from __future__ import annotations

import signal
import sys
import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType


T = TypeVar("T")


_wipes: list[Callable[[], None]] = []
"""Functions that erase the lines that are redrawn in place."""


def say(text: str) -> None:
    """Print a message to standard error, if it is still open."""
    for wipe in _wipes:
        wipe()
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)  # noqa: T201 - the one place that talks


@contextmanager
def redrawn_line(wipe: Callable[[], None]) -> Iterator[None]:
    """While a line is redrawn in place, erase it before each message."""
    _wipes.append(wipe)
    try:
        yield
    finally:
        _wipes.remove(wipe)


class Interrupt:
    """Knows whether the user asked the command to stop."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._is_waiting = False
        """True while a signal ends the program at once, as nothing is half done."""

    @property
    def asked(self) -> bool:
        return self._event.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the user asks or the time is over. True if the user has asked."""
        return self._event.wait(timeout_s)

    def ask(self, _signal: int, _frame: FrameType | None) -> None:
        """Note the first signal; a second one ends the program at once."""
        if self.asked or self._is_waiting:
            raise KeyboardInterrupt
        self._event.set()

    def breakable(self, items: Iterator[T]) -> Iterator[T]:
        """Give items; a signal raises KeyboardInterrupt while the next one is waited for.

        It does not while the caller works on an item, which could leave a line half written.
        """
        while True:
            self._is_waiting = True
            try:
                if self.asked:
                    raise KeyboardInterrupt
                item = next(items, None)
            finally:
                self._is_waiting = False
            if item is None:
                return
            yield item


@contextmanager
def interruptible() -> Iterator[Interrupt]:
    """Note Ctrl-C and SIGTERM, so that the command can end when it is ready."""
    interrupt = Interrupt()
    before = {
        number: signal.signal(number, interrupt.ask) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
