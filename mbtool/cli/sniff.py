"""mbtool sniff: listen on links, decode, log."""

from __future__ import annotations

from functools import partial
from math import inf
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.option_groups import takes_groups
from mbtool.cli.options import (
    AllowOption,
    DeviceOption,
    EventsOption,
    Format,
    PortOptions,
    SilenceOptions,
    TableOptionGroup,
    WhereOption,
)
from mbtool.cli.tls_options import TlsOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mbtool.cli.options import TcpPorts
    from mbtool.cli.output import RecordOutput
    from mbtool.cli.talk import Interrupt
    from mbtool.core import LinkSpec, SerialLink
    from mbtool.decode.line_timing import LineTiming
    from mbtool.devices import Assignments
    from mbtool.logs import LogWriter, RotatingLog
    from mbtool.ports.allowed_peers import AllowedPeers
    from mbtool.workflows.sniff import Sniffer


@takes_groups
def sniff(
    links: Annotated[
        list[str],
        typer.Argument(
            metavar="LINK",
            help="rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, net:INTERFACE or tap:LISTEN=TARGET. "
            "Several are heard at once. rtu:PORT,PORT@... is one line with two taps: the master's "
            "side, the slaves' side. rtutap:PORT@...=PORT relays between the ends of a cut line.",
        ),
    ],
    *,
    write: Annotated[
        str | None,
        typer.Option("--write", "-w", metavar="FILE.mcap", help="Log all that is heard."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the log if there is one of that name.")
    ] = False,
    device: DeviceOption = None,
    where: WhereOption = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=0, help="Stop after so many seconds."),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option("--count", metavar="N", min=1, help="Stop after so many transactions."),
    ] = None,
    rotate: Annotated[
        str | None,
        typer.Option(
            "--rotate",
            metavar="100MB|1h",
            help="Go on in a next file when the log has this size or age.",
        ),
    ] = None,
    ports: PortOptions,
    silences: SilenceOptions,
    format_: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
    table: TableOptionGroup,
    events: EventsOption = None,
    allow: AllowOption = None,
    tls: TlsOptions,
) -> None:
    """Listen on links, show each transaction as it ends, and log it.

    Sniffing never writes to the line; only a tap passes on what it hears. --where chooses what is
    shown; the log gets everything.
    """
    from mbtool.cli.options import assignments, condition
    from mbtool.cli.output import open_output
    from mbtool.cli.talk import interruptible, say
    from mbtool.core import UsageError, parse_link
    from mbtool.core.link_spec import HEARD
    from mbtool.decode.line_timing import LineTiming
    from mbtool.logs import Rotation
    from mbtool.logs.opening import check_log_path, create_log
    from mbtool.workflows.sniff import serial_lines, with_settings

    if rotate is not None and write is None:
        raise UsageError("--rotate needs a log to rotate: name one with -w FILE.mcap")
    specs = tls.on_taps([parse_link(link, HEARD) for link in links])
    for warning in tls.warnings():
        say(f"mbtool: {warning}")
    allowed = _allowed(specs, allow)
    devices, wanted = assignments(device), condition(where)
    tcp_ports = _tcp_ports(specs, ports)
    timing = LineTiming(devices, *silences.read())
    rotation = None if rotate is None else Rotation.parse(rotate)
    # Finding the settings of a line may take minutes, so errors are raised before it begins.
    serial_lines(specs)
    if write is not None:
        check_log_path(write, overwrite=overwrite)
    specs = timing.given(with_settings(specs, say))
    begin = None
    if write is not None:
        begin = partial(
            create_log,
            write,
            specs,
            devices,
            rotation=rotation,
            overwrite=overwrite,
            **tcp_ports._asdict(),
        )
    sniffer = _sniffer(specs, timing, tcp_ports, allowed, begin)
    with (
        interruptible() as interrupt,
        sniffer,
        open_output(
            None,
            format_,
            events,
            devices.profile_for,
            wanted,
            count,
            is_kept=write is not None,
            table=table.read(),
        ) as out,
    ):
        say(f"listening on {', '.join(sniffer.places)}; Ctrl-C ends")
        _show(sniffer, out, devices, serial_lines(specs), _end(interrupt, out, duration))
    if write is not None:
        say(f"log: {write}")
    if interrupt.asked:
        raise KeyboardInterrupt


def _tcp_ports(links: Sequence[LinkSpec], options: PortOptions) -> TcpPorts:
    """The TCP ports of --port and --rtu-port; 502 if --port names none.

    Raises UsageError for what is no port, and for a port that both options name.
    """
    from mbtool.cli.talk import say
    from mbtool.core import InterfaceLink
    from mbtool.workflows.shared.reading import DEFAULT_PORT

    given = options.tcp_ports()
    if (
        options.port
        and not given.any_port
        and not any(isinstance(one, InterfaceLink) for one in links)
    ):
        say("mbtool: --port has no effect: it is for interfaces (net:), and there is none")
    return given if given.ports else given._replace(ports=[DEFAULT_PORT])


def _allowed(links: Sequence[LinkSpec], networks: Sequence[str] | None) -> AllowedPeers:
    """The networks whose masters a tap accepts.

    Raises UsageError for what is no network, and if there are networks but no tap.
    """
    from mbtool.core import TapLink, UsageError
    from mbtool.ports.allowed_peers import AllowedPeers

    if networks and not any(isinstance(one, TapLink) for one in links):
        raise UsageError("--allow is for taps, and there is none; write tap:LISTEN=TARGET")
    return AllowedPeers.parse(networks or ())


def _sniffer(
    links: Sequence[LinkSpec],
    timing: LineTiming,
    ports: TcpPorts,
    allowed: AllowedPeers,
    begin: Callable[[], LogWriter | RotatingLog] | None,
) -> Sniffer:
    """Make a sniffer that tells a person what goes wrong while it runs."""
    from mbtool.cli.talk import say
    from mbtool.decode.decoder import Decoder
    from mbtool.devices import Namer
    from mbtool.workflows.sniff import Sniffer, serial_lines

    namer, lines = Namer(timing.assignments), serial_lines(links)
    return Sniffer(
        links,
        Decoder(namer, lines=lines, timing=timing, **ports._asdict()),
        begin_log=begin,
        ports=[] if ports.any_port else [*ports.ports, *ports.rtu_ports],
        allowed=allowed,
        on_remark=lambda text: say(f"mbtool: {text}"),
    )


def _end(
    interrupt: Interrupt, out: RecordOutput, duration_s: float | None
) -> Callable[[int], bool]:
    """A function that is given the time (ns) and tells whether the run ends now."""
    from mbtool.ports.clock import now_ns

    end_ns = inf if duration_s is None else now_ns() + duration_s * 1e9

    def ends(at_ns: int) -> bool:
        out.wait()
        return interrupt.asked or out.is_full or at_ns >= end_ns

    return ends


def _show(
    sniffer: Sniffer,
    out: RecordOutput,
    devices: Assignments,
    lines: Mapping[str, SerialLink],
    ends: Callable[[int], bool],
) -> None:
    """Print records as they come; say which devices tell their model, and which serial lines cannot
    be read.
    """
    from mbtool.cli.talk import say
    from mbtool.workflows.shared.model_hints import ModelHints
    from mbtool.workflows.shared.unreadable_lines import UnreadableLines

    hints = ModelHints(devices.profile_for)
    unreadable = UnreadableLines(lines.get, is_live=True)
    for record in sniffer.records(ends):
        for remark in (hints.note(record), unreadable.note(record)):
            if remark is not None:
                say(f"mbtool: {remark}")
        if not out.is_full:
            out.add(record)
