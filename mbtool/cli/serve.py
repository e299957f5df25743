"""Runs a slave until someone stops it: what `slave` and `replay --as-slave` share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from mbtool.cli import exit_codes
from mbtool.cli.talk import interruptible, say

if TYPE_CHECKING:
    from mbtool.slave import Shell


def serve(shell: Shell, who: str) -> None:
    """Answer until Ctrl-C. Raises LinkError when the link is lost."""
    with interruptible() as interrupt, shell:
        say(f"{who} on {shell.place}; Ctrl-C ends")
        while not interrupt.asked:
            shell.wait(0.2)
    raise typer.Exit(exit_codes.INTERRUPTED)
