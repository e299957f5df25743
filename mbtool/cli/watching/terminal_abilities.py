"""Asks terminfo if the terminal can move its cursor and show colours."""

from __future__ import annotations

import os
import sys
from typing import NamedTuple

from mbtool.core import UsageError


class TerminalAbilities(NamedTuple):
    """Two abilities of a terminal; both are assumed if terminfo does not know the terminal."""

    has_cursor: bool = True
    """True if a program can move the cursor to any place of the screen."""
    has_colours: bool = True


def terminal_abilities() -> TerminalAbilities:
    """Return the abilities of the terminal that the environment variable TERM names."""
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

    An empty NO_COLOR has no meaning (no-color.org), but textual only checks if the variable exists.
    Raises UsageError for a terminal on which no full screen can be drawn.
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
