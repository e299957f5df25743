"""mbtool status: show the state of a recording."""

from __future__ import annotations

from typing import Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.talk import escaped


def status(
    log: Annotated[
        str,
        typer.Argument(metavar="LOG", help="The log, as sniff -w names it, also if it is rotated."),
    ],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Say how a recording is doing, also while it runs.

    What it has heard and what it has lost is counted in the last heartbeat of sniff --service. Of
    a log in parts, the last part is read. Exit 1 if the recording was killed, a link of it is
    lost, or no heartbeat comes.
    """
    import msgspec

    from mbtool.views.status import RecordedLog, status_document, status_lines
    from mbtool.workflows.status import heartbeat_numbers, recording_of

    one = recording_of(log)
    of_log = one.log.size, one.log.capture, one.log.links, one.log.heartbeat
    known = RecordedLog(str(one.path), one.state, *of_log, heartbeat_numbers(one.log), one.now_ns)
    if as_json:
        typer.echo(msgspec.json.encode(status_document(known)).decode())
    else:
        for line in status_lines(known):
            typer.echo(escaped(line))
    if not one.is_well:
        raise typer.Exit(exit_codes.NO)
