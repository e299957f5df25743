"""mbtool demo: record the traffic of two slaves and replay the recording, on this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.options import EventChoice, Format
from mbtool.cli.talk import say


def demo(
    write: Annotated[
        str | None,
        typer.Option("--write", "-w", metavar="FILE.mcap", help="Keep the log under this name."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the log if there is one of that name.")
    ] = False,
) -> None:
    """Show the whole loop on this machine, without hardware.

    An FT1A Touch on a virtual RS-485 line at 19200 baud and an FA3-AT1M8X on loopback TCP answer
    two masters, while mbtool sniffs both into one log; then the log answers in the devices' place.
    """
    from tempfile import TemporaryDirectory

    from mbtool.cli.output import open_output
    from mbtool.logs.opening import check_log_path
    from mbtool.workflows.demo import Demo

    if write is not None:
        check_log_path(write, overwrite=overwrite)
    with TemporaryDirectory(prefix="mbtool-demo-") as folder, _log_named_at_interruption(write):
        run = Demo(write or str(Path(folder) / "demo.mcap"), overwrite=overwrite)
        say("1. An FT1A Touch (RTU, 19200 baud) and an FA3-AT1M8X (Modbus/TCP) answer two masters;")
        say("   mbtool hears both and logs them:")
        say("")
        with open_output(
            None,
            Format.TABLE,
            EventChoice.TROUBLE,
            lambda one: run.assignments.profile_for(one),
            lambda _: True,
        ) as out:
            for record in run.record():
                out.add(record)
        say("")
        say("2. The log plays both devices on loopback; the same requests are asked again:")
        say("")
        agreement = run.replay()
        for unit, request, answer in agreement.differences:
            typer.echo(
                f"unit {unit} {request.hex(' ')}: {answer.hex(' ') if answer else 'silence'}"
            )
        agreed = agreement.asked - len(agreement.differences)
        typer.echo(f"{agreed} of {agreement.asked} answers agree with the devices' own.")
        if write is not None:
            say("")
            say(f"The log is {write}: try mbtool decode {write}")
    if agreement.differences or not agreement.asked:
        raise typer.Exit(exit_codes.NO)


@contextmanager
def _log_named_at_interruption(write: str | None) -> Iterator[None]:
    """Print the path `write` of the log if Ctrl-C ends the context and the log exists."""
    try:
        yield
    except KeyboardInterrupt:
        if write is not None and os.path.exists(write):
            say(f"log: {write}")
        raise
