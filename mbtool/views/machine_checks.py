"""Prints what `mbtool doctor` found: a line for each check, and the command that mends it."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from mbtool.views.tables import plain

if TYPE_CHECKING:
    from rich.console import Console

MARKS = {"ok": "ok", "missing": "-", "broken": "!!"}
_STYLES = {"ok": "", "missing": "yellow", "broken": "bold red"}
_NARROWEST = 40


def print_machine_checks(console: Console, checks: Sequence[tuple[str, str, str, str]]) -> None:
    """Print checks, each a tuple of state (`ok`, `missing` or `broken`), name, result and remedy.

    The remedy is a command that mends the problem; empty if there is none.
    """
    names = max((len(name) for _, name, _, _ in checks), default=0)
    indent = " " * (names + 6)
    for state, name, found, remedy in checks:
        start = f"{MARKS[state]:<3} {name:<{names}}  "
        for line in wrap(
            found,
            max(console.width, _NARROWEST),
            initial_indent=start,
            subsequent_indent=indent,
            break_on_hyphens=False,
        ):
            console.print(plain(line, _STYLES[state]), soft_wrap=True)
        if remedy:
            # Users copy this command, so it gets no line breaks.
            console.print(plain(f"{indent}{remedy}"), soft_wrap=True)
