"""mbtool decode: what is in a capture or a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.options import DeviceOption, PortOption, RtuPortOption, WhereOption
from mbtool.cli.output import EventChoice, Format

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.workflows.decoding import Record
    from mbtool.workflows.reading import Reading


def decode(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE...",
            help="Captures (.pcap, .pcapng) or logs (.mcap), plain, .gz or .zst; - is standard "
            "input. Several captures are read as parts of one.",
        ),
    ],
    device: DeviceOption = None,
    where: WhereOption = None,
    format_: Annotated[
        Format | None,
        typer.Option(
            "--format", help="How to print. [default: table, or what the name of --output says]"
        ),
    ] = None,
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="OUT", help="Write to a file.")
    ] = None,
    limit: Annotated[
        int | None, typer.Option("--limit", min=1, help="Stop after so many transactions.")
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Go on as a log that is being written grows.")
    ] = False,
    raw: Annotated[
        bool,
        typer.Option("--raw", help="Decode a log's evidence afresh, in place of what it says."),
    ] = False,
    port: PortOption = None,
    rtu_port: RtuPortOption = None,
    events: Annotated[
        EventChoice | None,
        typer.Option(
            "--events",
            help="Skipped bytes, gaps and the like (trouble), connections too (all), or none. "
            "[default: trouble in a table, else none]",
        ),
    ] = None,
) -> None:
    """Decode captures and logs into transactions, one line each."""
    from mbtool.cli.options import assignments, condition
    from mbtool.cli.output import open_output
    from mbtool.cli.talk import interruptible
    from mbtool.core import UsageError
    from mbtool.workflows.reading import Reading, ReadingOptions, followed

    devices = assignments(device)
    wanted = condition(where)
    options = ReadingOptions(
        assignments=devices, ports=port or (), rtu_ports=rtu_port or (), raw=raw
    )
    if follow and (raw or len(files) > 1):
        raise UsageError("--follow goes with one log, and not with --raw")
    reading = Reading(files, options)
    with (
        open_output(output, format_, events, devices.profile_for, wanted, limit) as out,
        interruptible() as interrupt,
    ):
        records = reading.records()
        if follow:
            records = followed(files[0], options, lambda: out.wait() and not interrupt.wait(0.2))
        for record in records if follow else _shown(reading, records, hidden=out.on_terminal):
            out.add(record)
            if out.is_full or interrupt.asked:
                break
    if interrupt.asked:
        raise KeyboardInterrupt


def _shown(reading: Reading, records: Iterator[Record], *, hidden: bool) -> Iterator[Record]:
    """The same records, with a progress bar on the terminal where it would not be in the way."""
    import sys

    if hidden or not sys.stderr.isatty() or reading.fraction is None:
        yield from records
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("decoding", total=1.0)
        for number, record in enumerate(records):
            if number % 500 == 0:
                progress.update(task, completed=reading.fraction)
            yield record
