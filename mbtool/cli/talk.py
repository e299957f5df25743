"""Messages to the user on standard error, and how a user stops a command."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType


T = TypeVar("T")

PATIENCE_S = 0.5
"""A recording waits so many seconds for standard error to take a message, and only once."""

_wipes: list[Callable[[], None]] = []
"""Functions that erase lines that are redrawn in place, such as the progress line."""


class _Waiting:
    """Settings of `say` for a standard error that takes no text, as of a stopped terminal."""

    patience_s: float | None = None
    """Drop the message after so many seconds; None to wait for ever."""


@contextmanager
def never_waiting() -> Iterator[None]:
    """While the context is open, drop messages that standard error does not take."""
    _Waiting.patience_s = PATIENCE_S
    try:
        yield
    finally:
        _Waiting.patience_s = None


def _has_room(timeout_s: float) -> bool:
    """True if standard error takes text within the time, or if the system cannot tell."""
    try:
        return bool(select.select([], [sys.stderr.fileno()], [], timeout_s)[1])
    except (OSError, ValueError):  # Windows asks only sockets; a file in memory has no descriptor.
        return True


def say(text: str, *, is_error: bool = False) -> None:
    """Print a message to standard error, if it is still open; in systemd's journal, with its level.

    Characters that a terminal would obey, such as those in a file's name, are escaped.
    """
    for wipe in _wipes:
        wipe()
    if _Waiting.patience_s is not None and not _has_room(_Waiting.patience_s):
        _Waiting.patience_s = 0.0
        return
    with suppress(OSError):
        print(_for_journal(text, is_error=is_error) + escaped(text), file=sys.stderr, flush=True)  # noqa: T201 - the one place that talks


def _for_journal(text: str, *, is_error: bool) -> str:
    """The level of a line as systemd reads it (sd-daemon(3)), if standard error is its journal."""
    journal = os.environ.get("JOURNAL_STREAM")
    if not journal:
        return ""
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return ""
    if journal != f"{status.st_dev}:{status.st_ino}":
        return ""
    if is_error:
        return "<3>"
    return "<4>" if text.startswith("mbtool: ") else "<6>"


def escaped(text: str) -> str:
    r"""The text with \x1b and the like in place of characters that cannot be shown."""
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or one == "\n" else one.encode("unicode_escape").decode()
        for one in text
    )


@contextmanager
def redrawn_line(wipe: Callable[[], None]) -> Iterator[None]:
    """While the context is open, call `wipe` before each message, to erase a redrawn line."""
    _wipes.append(wipe)
    try:
        yield
    finally:
        _wipes.remove(wipe)


def _end_line_of_echo() -> None:
    """Let what follows begin in a new line of the terminal, not behind the `^C` it has echoed.

    Where a line is redrawn in place, its erasing removes the `^C` as well.
    """
    with suppress(OSError, ValueError, AttributeError):
        if sys.stderr.isatty() and not _wipes and _has_room(0.0):
            os.write(sys.stderr.fileno(), b"\n")


class Interrupt:
    """The user's wish to stop the command, given by a signal (Ctrl-C, SIGTERM or SIGHUP)."""

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

    def ask(self, number: int, _frame: FrameType | None) -> None:
        """Signal handler: note the first signal; on the second one, end the program at once."""
        if number == signal.SIGINT and not self.asked:
            _end_line_of_echo()
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


NOTHING_WRITTEN = "interrupted; nothing was written"


class Interrupted(KeyboardInterrupt):
    """Ctrl-C ended the command, and the user knows what was kept; main.py says so otherwise."""


@contextmanager
def interruption_told(text: str = NOTHING_WRITTEN) -> Iterator[None]:
    """If Ctrl-C ends what runs in the context, say so, and what was kept."""
    try:
        yield
    except Interrupted:
        raise
    except KeyboardInterrupt:
        say(text)
        raise Interrupted from None


@contextmanager
def never_suspended() -> Iterator[Callable[[], None]]:
    """While the context is open, Ctrl-Z does not stop the command, as nothing would be heard.

    Yields a function that tells the user so after Ctrl-Z; it is called now and then. SIGTTOU, which
    stops a command in the background that prints, is ignored, too.
    """
    pressed = [False]

    def note(_signal: int, _frame: FrameType | None) -> None:
        pressed[0] = True

    def tell() -> None:
        if pressed[0]:
            pressed[0] = False
            say("mbtool: Ctrl-Z does not stop a recording, which would lose what comes; "
                "Ctrl-C ends it")  # fmt: skip

    if sys.platform == "win32":
        yield tell
        return
    before = signal.signal(signal.SIGTSTP, note), signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    try:
        yield tell
    finally:
        signal.signal(signal.SIGTSTP, before[0])
        signal.signal(signal.SIGTTOU, before[1])


@contextmanager
def interruptible() -> Iterator[Interrupt]:
    """While the context is open, only note Ctrl-C, SIGTERM and SIGHUP (the terminal is gone).

    The command ends when ready. A SIGHUP that is ignored, as under nohup, stays ignored.
    """
    interrupt = Interrupt()
    numbers = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none.
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        numbers.append(hangup)
    before = {number: signal.signal(number, interrupt.ask) for number in numbers}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
