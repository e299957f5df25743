"""mbtool sniff: listen on links, decode, log."""

from __future__ import annotations

from typing import Annotated

import typer

from mbtool.cli.options import (
    AllowOption,
    DeviceOption,
    EventsOption,
    Format,
    PortOption,
    RtuPortOption,
    T15Option,
    T35Option,
    WhereOption,
)
from mbtool.cli.tls_options import (
    TlsCaOption,
    TlsCertOption,
    TlsKeyOption,
    TlsTargetCaOption,
    TlsTargetCertOption,
    TlsTargetKeyOption,
    TlsTargetNameOption,
    TlsTargetUnverifiedOption,
)


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
    port: PortOption = None,
    rtu_port: RtuPortOption = None,
    t1_5: T15Option = None,
    t3_5: T35Option = None,
    format_: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
    events: EventsOption = None,
    allow: AllowOption = None,
    tls_cert: TlsCertOption = None,
    tls_key: TlsKeyOption = None,
    tls_ca: TlsCaOption = None,
    tls_target_ca: TlsTargetCaOption = None,
    tls_target_unverified: TlsTargetUnverifiedOption = False,
    tls_target_cert: TlsTargetCertOption = None,
    tls_target_key: TlsTargetKeyOption = None,
    tls_target_name: TlsTargetNameOption = None,
) -> None:
    """Listen on links, show each transaction as it ends, and log it.

    Sniffing never writes to the line; only a tap passes on what it hears. --where chooses what is
    shown; the log gets everything.
    """
    from functools import partial
    from math import inf

    from mbtool.cli.options import assignments, condition, silence, tcp_ports
    from mbtool.cli.output import open_output
    from mbtool.cli.talk import interruptible, say
    from mbtool.cli.tls_options import listen_tls, target_tls, with_tls
    from mbtool.core import InterfaceLink, TapLink, UsageError, parse_link
    from mbtool.core.link_spec import HEARD
    from mbtool.decode.decoder import Decoder
    from mbtool.decode.line_timing import LineTiming
    from mbtool.devices import Namer
    from mbtool.logs import Rotation
    from mbtool.logs.opening import check_log_path, create_log
    from mbtool.ports.allowed_peers import AllowedPeers
    from mbtool.ports.clock import now_ns
    from mbtool.ports.tls import why_outdated
    from mbtool.workflows.settling import settled
    from mbtool.workflows.shared.model_hints import ModelHints
    from mbtool.workflows.shared.reading import DEFAULT_PORT
    from mbtool.workflows.sniff import Sniffer, serial_lines

    if rotate is not None and write is None:
        raise UsageError("--rotate needs a log to rotate: name one with -w FILE.mcap")
    specs = with_tls(
        [parse_link(link, HEARD) for link in links],
        listen_tls(tls_cert, tls_key, tls_ca),
        target_tls(
            tls_target_ca,
            tls_target_cert,
            tls_target_key,
            tls_target_name,
            unverified=tls_target_unverified,
        ),
    )
    for option, cert in (("--tls-cert", tls_cert), ("--tls-target-cert", tls_target_cert)):
        if cert is not None and (why := why_outdated(option, cert)) is not None:
            say(f"mbtool: {why}")
    allowed = AllowedPeers.parse(allow or ())
    if allow and not any(isinstance(one, TapLink) for one in specs):
        raise UsageError("--allow is for taps, and there is none; write tap:LISTEN=TARGET")
    devices, wanted = assignments(device), condition(where)
    ports, rtu_ports, any_port = tcp_ports(port, rtu_port)
    ports = ports or [DEFAULT_PORT]
    if port and not any_port and not any(isinstance(one, InterfaceLink) for one in specs):
        say("mbtool: --port has no effect: it is for interfaces (net:), and there is none")
    timing = LineTiming(devices, silence("--t1-5", t1_5), silence("--t3-5", t3_5))
    rotation = None if rotate is None else Rotation.parse(rotate)
    # To find settings may take minutes: what cannot be done is said before.
    serial_lines(specs)
    if write is not None:
        check_log_path(write, overwrite=overwrite)
    specs = timing.given(settled(specs, say))
    sniffer = Sniffer(
        specs,
        Decoder(
            Namer(devices),
            lines=serial_lines(specs),
            timing=timing,
            ports=ports,
            rtu_ports=rtu_ports,
            any_port=any_port,
        ),
        begin_log=None
        if write is None
        else partial(
            create_log,
            write,
            specs,
            devices,
            ports=ports,
            rtu_ports=rtu_ports,
            any_port=any_port,
            rotation=rotation,
            overwrite=overwrite,
        ),
        ports=[] if any_port else [*ports, *rtu_ports],
        allowed=allowed,
        on_lost=lambda error: say(f"mbtool: {error}"),
        on_discarded=lambda event: say(f"mbtool: {event.link}: {event.message}"),
        on_refused=lambda event: say(f"mbtool: a master was turned away: {event.message}"),
    )
    hints = ModelHints(devices.profile_for)
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
        ) as out,
    ):
        say(f"listening on {', '.join(sniffer.places)}; Ctrl-C ends")
        end_ns = inf if duration is None else now_ns() + duration * 1e9

        def stop(at_ns: int) -> bool:
            out.wait()
            return interrupt.asked or out.is_full or at_ns >= end_ns

        for record in sniffer.records(stop):
            if (hint := hints.note(record)) is not None:
                say(f"mbtool: {hint}")
            if not out.is_full:
                out.add(record)
    if write is not None:
        say(f"log: {write}")
    if interrupt.asked:
        raise KeyboardInterrupt
