"""Prints messages to standard error, and lets the user stop a command."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TypeVar

from mbtool.cli.view_queue import ViewQueue, unwaited

if TYPE_CHECKING:
    from types import FrameType


T = TypeVar("T")

_wipes: list[Callable[[], None]] = []
"""Functions that erase lines that are redrawn in place, such as the progress line."""


@contextmanager
def never_waiting() -> Iterator[None]:
    """While the context is open, standard error does not hold up the command.

    Messages go into a queue that a thread writes. Those that a stopped terminal does not take are
    lost at the end.
    """
    before = sys.stderr
    sys.stderr = queued = unwaited(before)
    try:
        yield
    finally:
        sys.stderr = before
        if isinstance(queued, ViewQueue):
            with suppress(OSError):
                queued.drain(lambda: True)


def say(text: str, *, is_error: bool = False) -> None:
    """Print a message of one line to standard error; in systemd's journal, with its level.

    Line ends and characters that a terminal would obey, as in a file's name, are escaped. Nothing
    happens if standard error is closed.
    """
    for wipe in _wipes:
        wipe()
    if isinstance(sys.stderr, ViewQueue) and sys.stderr.is_full:
        return
    with suppress(OSError):
        print(_journal_prefix(text, is_error=is_error) + escaped(text), file=sys.stderr, flush=True)  # noqa: T201 - the one place that talks


@contextmanager
def shown_progress(least_s: float | None = None) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows how far a long work is, in one line of a terminal that is redrawn
    and erased at the end.

    Where standard error is no terminal, it says the text instead, at most each `least_s` seconds;
    never if it is None.
    """
    told_s = time.monotonic()
    is_drawn = False

    def wipe() -> None:
        nonlocal is_drawn
        if is_drawn:
            is_drawn = False
            with suppress(OSError):
                sys.stderr.write("\r\x1b[K")
                sys.stderr.flush()

    def show(text: str) -> None:
        nonlocal told_s, is_drawn
        if is_terminal:
            wipe()
            is_drawn = True
            with suppress(OSError):
                sys.stderr.write(escaped(text))
                sys.stderr.flush()
        elif least_s is not None and time.monotonic() - told_s >= least_s:
            told_s = time.monotonic()
            say(text)

    is_terminal = sys.stderr.isatty()
    if not is_terminal:
        yield show
        return
    with redrawn_line(wipe):
        try:
            yield show
        finally:
            wipe()


def _journal_prefix(text: str, *, is_error: bool) -> str:
    """Return the prefix that tells systemd's journal the level of a line, such as `<3>`.

    It is empty if standard error is no journal (sd-daemon(3)).
    """
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
    r"""Return the text with escapes such as \x1b in place of characters that cannot be shown."""
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in text
    )


@contextmanager
def redrawn_line(wipe: Callable[[], None]) -> Iterator[None]:
    """While the context is open, call `wipe` before each message.

    `wipe` erases a line that is redrawn in place, such as the progress of a replay.
    """
    _wipes.append(wipe)
    try:
        yield
    finally:
        _wipes.remove(wipe)


def _has_room() -> bool:
    """True if standard error takes a byte at once, or if the system cannot tell."""
    try:
        return bool(select.select([], [sys.stderr.fileno()], [], 0.0)[1])
    except (OSError, ValueError):  # Windows asks only sockets; a file in memory has no descriptor.
        return True


def _end_line_of_echo() -> None:
    """Begin a new line on the terminal, so that the next message is not behind the echoed `^C`.

    If a line is redrawn in place, erasing it removes the `^C` as well.
    """
    with suppress(OSError, ValueError, AttributeError):
        if sys.stderr.isatty() and not _wipes and _has_room():
            os.write(sys.stderr.fileno(), b"\n")


class Interrupt:
    """Notes that a signal (Ctrl-C, SIGTERM or SIGHUP) asks the command to stop."""

    # `ask` runs as a signal handler, at any line of the main thread, also while `wait` runs. So it
    # takes no lock that `wait` may hold: Event.set() would, and Ctrl-C could hang the program.

    def __init__(self) -> None:
        self.asked = False
        """True if a signal (Ctrl-C, SIGTERM or SIGHUP) has come."""
        self._at_once = False
        self._woken = threading.Lock()
        self._woken.acquire()

    def wait(self, timeout_s: float) -> bool:
        """Wait for a signal, at most `timeout_s` seconds. Returns True if one has come."""
        return self.asked or self._woken.acquire(timeout=timeout_s)

    def ask(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal: note the first one, and raise KeyboardInterrupt at the second one.

        While `breakable` waits for an item, the first signal also raises KeyboardInterrupt.
        """
        if number == signal.SIGINT and not self.asked:
            _end_line_of_echo()
        if self.asked or self._at_once:
            raise KeyboardInterrupt
        self.asked = True
        self._woken.release()

    def breakable(self, items: Iterator[T]) -> Iterator[T]:
        """Yield the items; raise KeyboardInterrupt if a signal comes while the next one is awaited.

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
    """Ctrl-C ended the command, and the user was told what was kept.

    For any other KeyboardInterrupt, main.py prints a message.
    """


@contextmanager
def say_if_interrupted(text: str | Callable[[], str] = NOTHING_WRITTEN) -> Iterator[None]:
    """Print `text`, which says what was kept, if Ctrl-C ends the context.

    A function is called then to return the text.
    """
    try:
        yield
    except Interrupted:
        raise
    except KeyboardInterrupt:
        say(text if isinstance(text, str) else text())
        raise Interrupted from None


@contextmanager
def never_suspended() -> Iterator[Callable[[], None]]:
    """While the context is open, Ctrl-Z does not stop the command, as it would miss traffic.

    Yields a function to be called now and then: after Ctrl-Z it prints why nothing happened.
    SIGTTOU, which stops a background command that prints, is ignored, too.
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

    The command itself looks at the Interrupt and ends when ready. A SIGHUP that is ignored, as
    under nohup, stays ignored.
    """
    interrupt = Interrupt()
    numbers = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)  # Windows has no SIGHUP.
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        numbers.append(hangup)
    before = {number: signal.signal(number, interrupt.ask) for number in numbers}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
