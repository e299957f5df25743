"""mbtool recover: make a whole log from a damaged one."""

from __future__ import annotations

from typing import Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.output_file import report_left
from mbtool.cli.talk import say
from mbtool.core.moments import counted


def recover(
    broken: Annotated[
        str, typer.Argument(metavar="BROKEN", help="The damaged log, plain or compressed, or -.")
    ],
    *,
    good: Annotated[str, typer.Option("-o", "--output", metavar="GOOD", help="The log to write.")],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace GOOD if it exists.")
    ] = False,
) -> None:
    """Copy what is whole in a damaged log into a new one.

    Every whole message before and behind the damage is copied, with settings and profiles. Each
    part that is lost is a line on standard output: its place in the file, its bytes and its times.
    Exit 1 when something is lost.
    """
    from mbtool.workflows.recover import loss_text, recover

    with report_left(good):
        result = recover(broken, good, lambda loss: typer.echo(loss_text(loss)), replace=overwrite)
    if result.remark:
        say(f"mbtool: {result.remark}")
    lost = "nothing is lost"
    if result.losses or result.lost_messages:
        lost = f"{result.lost_bytes:,} bytes in {counted(result.losses, 'place')} are lost"
        if result.lost_messages is not None:
            lost += f", {counted(result.lost_messages, 'message')}"
    say(f"{good}: {counted(result.messages, 'message')} of {broken}; {lost}")
    if result.losses or result.lost_messages:
        raise typer.Exit(exit_codes.NO)
