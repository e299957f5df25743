"""mbtool sniff: listen on links, decode, log."""

from __future__ import annotations

from typing import Annotated

import typer

from mbtool.cli.options import DeviceOption, PortOption, RtuPortOption, WhereOption
from mbtool.cli.output import EventChoice, Format


def sniff(
    links: Annotated[
        list[str],
        typer.Argument(
            metavar="LINK...",
            help="rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, net:INTERFACE, "
            "tap:LISTEN=TARGET; several are heard at once.",
        ),
    ],
    write: Annotated[
        str | None, typer.Option("--write", "-w", metavar="FILE.mcap", help="Log everything.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the log if there is one of that name.")
    ] = False,
    device: DeviceOption = None,
    where: WhereOption = None,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", min=0, help="Stop after so long.")
    ] = None,
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="Stop after so many transactions.")
    ] = None,
    rotate: Annotated[
        str | None,
        typer.Option(
            "--rotate", metavar="100MB|1h", help="Go on in a next file at this size or age."
        ),
    ] = None,
    port: PortOption = None,
    rtu_port: RtuPortOption = None,
    format_: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
    events: Annotated[
        EventChoice | None,
        typer.Option("--events", help="Which wire events to print, as for decode."),
    ] = None,
) -> None:
    """Listen, show each transaction as it ends, and log the bytes it was decoded from.

    Sniffing never writes to the line. --where chooses what is shown; the log gets everything.
    """
    from mbtool.cli.options import assignments, condition
    from mbtool.cli.output import open_output
    from mbtool.cli.talk import interruptible, say
    from mbtool.core import UsageError, parse_link
    from mbtool.devices import Namer
    from mbtool.sources.clock import now_ns
    from mbtool.workflows.decoding import Decoder
    from mbtool.workflows.reading import DEFAULT_PORT
    from mbtool.workflows.recording import begin_log
    from mbtool.workflows.sniffing import Sniffer, serial_lines

    if rotate is not None and write is None:
        raise UsageError("--rotate needs a log to rotate: name one with -w FILE.mcap")
    specs = [parse_link(link) for link in links]
    devices, wanted = assignments(device), condition(where)
    rtu_ports = rtu_port or []
    ports = port or ([] if rtu_ports else [DEFAULT_PORT])
    decoder = Decoder(Namer(devices), lines=serial_lines(specs), ports=ports, rtu_ports=rtu_ports)
    log = None
    if write is not None:
        log = begin_log(
            write,
            specs,
            devices,
            ports=ports,
            rtu_ports=rtu_ports,
            rotation=rotate,
            overwrite=overwrite,
        )
    sniffer = Sniffer(
        specs,
        decoder,
        log=log,
        ports=[*ports, *rtu_ports],
        on_lost=lambda error: say(f"mbtool: {error}"),
    )
    with (
        open_output(None, format_, events, devices.profile_for, wanted, count) as out,
        interruptible() as interrupt,
        sniffer,
    ):
        say(f"listening on {', '.join(map(str, specs))}; Ctrl-C ends")
        end_ns = None if duration is None else now_ns() + int(duration * 1e9)

        def stop(at_ns: int) -> bool:
            out.wait()
            return interrupt.asked or out.is_full or (end_ns is not None and at_ns >= end_ns)

        for record in sniffer.records(stop):
            if not out.is_full:
                out.add(record)
    if write is not None:
        say(f"log: {write}")
    if interrupt.asked:
        raise KeyboardInterrupt
