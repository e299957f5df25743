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
    """Register `wipe` while the context is open: it erases a line before each message."""
    _wipes.append(wipe)
    try:
        yield
    finally:
        _wipes.remove(wipe)


class Interrupt:
    """A request of the user to stop the command, made by a signal."""

    # `ask` runs as a signal handler, at any line of the main thread, also while `wait` runs. So it
    # takes no lock that `wait` may hold: Event.set() would, and Ctrl-C could hang the program.

    def __init__(self) -> None:
        self.asked = False
        """True if a signal has come."""
        self._at_once = False
        self._woken = threading.Lock()
        self._woken.acquire()

    def wait(self, timeout_s: float) -> bool:
        """Wait until someone asks, at most `timeout_s` seconds. True if someone has asked."""
        return self.asked or self._woken.acquire(timeout=timeout_s)

    def ask(self, _signal: int, _frame: FrameType | None) -> None:
        """Handle a signal: note the first one, and end the program at once on a second one."""
        if self.asked or self._at_once:
            raise KeyboardInterrupt
        self.asked = True
        self._woken.release()

    def breakable(self, items: Iterator[T]) -> Iterator[T]:
        """Give the items; raise KeyboardInterrupt if a signal comes while waiting for the next.

        A signal that comes while the caller works on an item does not interrupt that work, so that
        no line is left half written; KeyboardInterrupt is raised when the caller asks for the next
        item.
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
    """While the context is open, only note Ctrl-C and SIGTERM; the command ends when ready."""
    interrupt = Interrupt()
    before = {
        number: signal.signal(number, interrupt.ask) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
