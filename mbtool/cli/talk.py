"""What commands say to a person beside their data: on standard error, and when to stop."""

from __future__ import annotations

import signal
import sys
import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType


def say(text: str) -> None:
    """Tell something that is no data, if anyone still listens."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)  # noqa: T201 - the one place that talks


class Interrupt:
    """Whether someone asked the command to stop."""

    def __init__(self) -> None:
        self._event = threading.Event()

    @property
    def asked(self) -> bool:
        return self._event.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Wait until someone asks, at most so long; the answer is whether someone has."""
        return self._event.wait(timeout_s)

    def ask(self, _signal: int, _frame: FrameType | None) -> None:
        """Note the first signal; a second one ends the program at once."""
        if self.asked:
            raise KeyboardInterrupt
        self._event.set()


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
