"""Runs a slave until the user stops it, for `slave` and `replay --as-slave`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import typer

from mbtool.cli import exit_codes
from mbtool.cli.talk import interruptible, say

if TYPE_CHECKING:
    from mbtool.slave.shells import Shell
    from mbtool.slave.shells.opening import ShellGroup


_LOOK_EVERY_S = 0.2
_SILENT_LOOKS = 50
"""After a message about refused connections, the next such message comes at least this many rounds
of the loop later (50 x 0.2 s = 10 s), as a refused master usually connects again at once."""


def serve(
    shell: Shell | ShellGroup,
    who: str,
    look: Callable[[], None] = lambda: None,
    say_more: Callable[[], None] = lambda: None,
) -> None:
    """Answer requests until Ctrl-C, then raise typer.Exit; call `look` every 0.2 s and at the end.

    `who` names the slave in the message that it has started. `say_more` is called after the shell
    (endpoint or serial line) has started, just before the message that says so. Raises LinkError
    when the link is lost, and the errors of `look`.
    """
    with interruptible() as interrupt, shell:
        say_more()
        say(f"{who} on {shell.place}; Ctrl-C ends")
        said, silent = 0, 0
        while not interrupt.asked:
            shell.wait(_LOOK_EVERY_S)
            look()
            for note in shell.notes():
                say(f"mbtool: {note}")
            silent = max(silent - 1, 0)
            if shell.turned_away > said and not silent:
                say(_turned_away(shell.turned_away - said, shell.places))
                said, silent = shell.turned_away, _SILENT_LOOKS
    look()
    raise typer.Exit(exit_codes.INTERRUPTED)


def while_read(show: Callable[[], None]) -> Callable[[], None]:
    """Return a function that calls `show`, which prints to standard output, until nobody reads it.

    Then it says so, once: masters are still answered.
    """
    has_reader = True

    def show_if_read() -> None:
        nonlocal has_reader
        if not has_reader:
            return
        try:
            show()
        except BrokenPipeError:
            has_reader = False
            say("mbtool: nobody reads standard output any more; the slave goes on")

    return show_if_read


def _turned_away(count: int, places: int) -> str:
    connections = "a connection was" if count == 1 else f"{count} connections were"
    return f"mbtool: {connections} turned away: the slave takes {places} at once"
