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
"""Functions that erase lines that are redrawn in place, such as the progress line."""


def say(text: str) -> None:
    """Print a message to standard error, if it is still open."""
    for wipe in _wipes:
        wipe()
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)  # noqa: T201 - the one place that talks


@contextmanager
def redrawn_line(wipe: Callable[[], None]) -> Iterator[None]:
    """While the context is open, call `wipe` before each message, to erase a redrawn line."""
    _wipes.append(wipe)
    try:
        yield
    finally:
        _wipes.remove(wipe)


class Interrupt:
    """The user's wish to stop the command, given by a signal (Ctrl-C or SIGTERM)."""

    # `ask` runs as a signal handler, at any line of the main thread, also while `wait` runs. So it
    # takes no lock that `wait` may hold: Event.set() would, and Ctrl-C could hang the program.

    def __init__(self) -> None:
        self.asked = False
        """True if a signal has come."""
        self._at_once = False
        self._woken = threading.Lock()
        self._woken.acquire()

    def wait(self, timeout_s: float) -> bool:
        """Wait for a signal, at most `timeout_s` seconds. True if a signal has come."""
        return self.asked or self._woken.acquire(timeout=timeout_s)

    def ask(self, _signal: int, _frame: FrameType | None) -> None:
        """Signal handler: note the first signal; on the second one, end the program at once."""
        if self.asked or self._at_once:
            raise KeyboardInterrupt
        self.asked = True
        self._woken.release()

    def breakable(self, items: Iterator[T]) -> Iterator[T]:
        """Yield the items; raise KeyboardInterrupt if a signal comes while waiting for the next.

        A signal does not interrupt the caller's work on an item, so that no line is left half
        written; KeyboardInterrupt is then raised when the caller asks for the next item.
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
