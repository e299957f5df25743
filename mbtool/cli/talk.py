"""What commands say to a person beside their data: on standard error, and when to stop."""

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
"""What takes away a line that is drawn over and over."""


def say(text: str) -> None:
    """Tell something that is no data, if anyone still listens."""
    for wipe in _wipes:
        wipe()
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)  # noqa: T201 - the one place that talks


@contextmanager
def drawn_line(wipe: Callable[[], None]) -> Iterator[None]:
    """While one line is drawn over and over, take it away before something is said."""
    _wipes.append(wipe)
    try:
        yield
    finally:
        _wipes.remove(wipe)


class Interrupt:
    """Whether someone asked the command to stop."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._at_once = False

    @property
    def asked(self) -> bool:
        return self._event.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Wait until someone asks, at most so long; the answer is whether someone has."""
        return self._event.wait(timeout_s)

    def ask(self, _signal: int, _frame: FrameType | None) -> None:
        """Note the first signal; a second one ends the program at once."""
        if self.asked or self._at_once:
            raise KeyboardInterrupt
        self._event.set()

    def breakable(self, items: Iterator[T]) -> Iterator[T]:
        """Give items; the wait for one, which may be long, is broken off by KeyboardInterrupt.

        What is done with an item is not: a line half written would be lost.
        """
        while True:
            self._at_once = True
            try:
                if self.asked:
                    raise KeyboardInterrupt
                item = next(items, None)
            finally:
                self._at_once = False
            if item is None:
                return
            yield item


@contextmanager
def interruptible() -> Iterator[Interrupt]:
    """Turn Ctrl-C and SIGTERM into a wish that the command grants when it is ready."""
    interrupt = Interrupt()
    before = {
        number: signal.signal(number, interrupt.ask) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
