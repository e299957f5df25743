"""Writes the full screen to the terminal, and finds out whether the terminal is gone."""

# textual writes in a thread of its own. If a write raised an error there, the thread would end, its
# queue of 30 texts would fill up, and the main thread would wait for ever for room in it. So a
# write that fails only notes that the terminal is gone. The queue also fills up while a terminal
# accepts nothing. So the terminal is opened a second time with O_NONBLOCK, and no write waits. Once
# the program is asked to end, text that the terminal does not accept is dropped.

from __future__ import annotations

import codecs
import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import NamedTuple, TextIO

from mbtool.core import UsageError


def accept_any_byte() -> None:
    """Let a key that is no UTF-8 be an unknown key; textual would end the screen with an error."""
    with suppress(ImportError):  # Windows has another driver.
        from textual.drivers import linux_driver

        decoder = codecs.getincrementaldecoder("utf-8")
        linux_driver.getincrementaldecoder = lambda _: partial(decoder, "replace")  # type: ignore[attr-defined]


class TerminalAbilities(NamedTuple):
    """Two abilities of a terminal; both are assumed if terminfo does not know the terminal."""

    has_cursor: bool = True
    """True if a program can move the cursor to any place of the screen."""
    has_colours: bool = True


def terminal_abilities() -> TerminalAbilities:
    """Return the abilities of the terminal that the environment variable TERM names (terminfo)."""
    try:
        import curses
    except ImportError:  # As on Windows.
        return TerminalAbilities()
    try:
        curses.setupterm(fd=sys.stdout.fileno())
    except (OSError, ValueError, curses.error):  # There is no terminfo, or it does not know TERM.
        return TerminalAbilities()
    return TerminalAbilities(curses.tigetstr("cup") is not None, curses.tigetnum("colors") > 0)


def prepare_terminal() -> None:
    """Set NO_COLOR if the terminal shows no colours, and remove it if it is empty.

    An empty NO_COLOR has no meaning (no-color.org), but textual only checks whether the variable
    exists. Raises UsageError for a terminal on which no full screen can be drawn.
    """
    able = terminal_abilities()
    if not able.has_cursor:
        raise UsageError(
            f"watch needs a terminal that can place its cursor; TERM={os.environ.get('TERM')} "
            "cannot: use sniff, decode or stats"
        )
    if not os.environ.get("NO_COLOR"):
        os.environ.pop("NO_COLOR", None)
        if not able.has_colours:
            os.environ["NO_COLOR"] = "1"


_LOOK_S = 0.1
_PATIENCE_S = 0.5
"""Once the program is asked to end, a terminal that takes nothing for this long, in s, gets no
further text. The text that gives the terminal back is among the last ones, so a slow terminal gets
some time."""


class TerminalOutput:
    """The terminal as a file that never raises an error, and does not wait after the end."""

    def __init__(self, file: TextIO, ends: Callable[[], bool]) -> None:
        """`file` writes to the terminal; `ends` returns True once the program is asked to end."""
        self._file, self._ends = file, ends
        self._encoding = file.encoding
        self._own: int | None = None
        with suppress(OSError):  # In a container, the terminal may have no name.
            name = os.ttyname(file.fileno())
            self._own = os.open(name, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        self._has_failed = self._is_full = False

    @property
    def is_gone(self) -> bool:
        """True if the terminal was closed, as its window or the connection to it."""
        return self._has_failed or self._is_hung_up()

    def write(self, text: str) -> int:
        left = memoryview(text.encode(self._encoding, "backslashreplace"))
        while left and not self._has_failed and self._waits_for_room():
            try:
                left = left[os.write(self.fileno(), left) :]
            except BlockingIOError:
                continue
            except OSError:
                self._has_failed = True
        return len(text)

    def flush(self) -> None:
        """Do nothing, as `write` keeps nothing back."""

    def close(self) -> None:
        if self._own is not None:
            os.close(self._own)
            self._own = None

    def fileno(self) -> int:
        return self._file.fileno() if self._own is None else self._own

    def isatty(self) -> bool:
        return self._file.isatty()

    def _waits_for_room(self) -> bool:
        """Wait until the terminal takes text; return False if the wait is given up."""
        waited_s = 0.0
        while not self._is_full and not self._has_room():
            if self._ends():
                waited_s += _LOOK_S
                self._is_full = waited_s > _PATIENCE_S
        return not self._is_full

    def _has_room(self) -> bool:
        # `select.select` raises an error for descriptors from 1024 on.
        poll = select.poll()
        poll.register(self.fileno(), select.POLLOUT)
        return bool(poll.poll(_LOOK_S * 1000))

    def _is_hung_up(self) -> bool:
        poll = select.poll()
        poll.register(self.fileno(), 0)
        return any(what & select.POLLHUP for _, what in poll.poll(0))


@contextmanager
def terminal_output(ends: Callable[[], bool]) -> Iterator[Callable[[], bool]]:
    """While the context is open, textual writes its screen to standard output in the safe way.

    textual would write to standard error, which may be a file while the terminal is on standard
    output. `ends` returns True once the program is asked to end. Yields a function that returns
    True if the terminal is gone.
    """
    if sys.platform == "win32":  # textual writes in another way there.
        yield lambda: False
        return
    output = TerminalOutput(sys.stdout, ends)
    before = sys.__stderr__
    sys.__stderr__ = output  # type: ignore[misc, assignment]
    try:
        yield lambda: output.is_gone
    finally:
        sys.__stderr__ = before  # type: ignore[misc]
        output.close()
