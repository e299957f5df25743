"""mbtool replay --as-slave: answer a live master as the recorded slaves did."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from mbtool.cli import exit_codes
from mbtool.cli.keys import keyboard
from mbtool.cli.progress import with_progress
from mbtool.cli.serve import serve
from mbtool.cli.talk import say
from mbtool.core.wording import plural
from mbtool.slave.shells import slave_link
from mbtool.workflows.replay_slave import SlaveRun

if TYPE_CHECKING:
    from mbtool.core import LinkSpec
    from mbtool.ports.allowed_peers import AllowedPeers
    from mbtool.workflows.replay_slave import SlaveOptions


def play_as_slave(file: str, on: LinkSpec, options: SlaveOptions, allowed: AllowedPeers) -> None:
    """Answer a live master as the recorded slaves did, until Ctrl-C."""
    slave_link(on)  # A link that no slave can use is an error before a long recording is read.
    run = SlaveRun(file, options, say, with_progress)
    played = run.on(on, allowed=allowed)
    with keyboard() as keys:

        def look() -> None:
            if keys is None:
                return
            for control in keys.controls():
                played.control(control)
            keys.show(played.progress())
            if keys.has_quit:
                raise typer.Exit(exit_codes.INTERRUPTED)

        serve(played.shell, _what_is_played(file, run), look)


def _what_is_played(file: str, run: SlaveRun) -> str:
    count = len(run.recording.answers)
    requests = "1 request" if count == 1 else f"{count:,} different requests"
    units = sorted(run.recording.units)
    if not units:
        return f"{file}: {requests}; no intact response to any of them was recorded"
    return f"{file}: {requests} to {plural(len(units), 'unit')} {', '.join(map(str, units))}"
