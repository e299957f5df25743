"""mbtool line: make a virtual serial line with several ends."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.talk import interruptible, say
from mbtool.core import SerialFormat


def line(
    ends: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PATH",
            help="Where to put each end, as a symbolic link. [default: three unnamed ends]",
        ),
    ] = None,
    settings: Annotated[
        str,
        typer.Option(
            "--settings",
            metavar="BAUD-FORMAT",
            help="How fast it carries characters. Programs "
            "that the system refuses parity on such a port work with 19200-8N1.",
        ),
    ] = "19200-8E1",
) -> None:
    """Lay a virtual serial line, until Ctrl-C.

    What one end sends, every other end hears, as slowly as on RS-485. For trying things without
    hardware: a slave on one end, a master on another, a sniffer on a third.
    """
    from mbtool.sources.virtual_line import VirtualLine

    names = [str(path) for path in ends or ()]
    virtual = VirtualLine(
        ends=max(len(names), 3 if not names else 2),
        format=SerialFormat.parse(settings),
        link_names=names,
    )
    with interruptible() as interrupt, virtual:
        for port in virtual.ports:
            typer.echo(port)
        say(f"{len(virtual.ports)} ends of one line at {virtual.format}; Ctrl-C takes it down")
        while not interrupt.wait(1.0):
            pass
    raise typer.Exit(exit_codes.INTERRUPTED)
