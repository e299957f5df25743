"""Makes the Sniffer, which records and decodes, for the commands that listen on links."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.cli.connection_options import ConnectionOptions
    from mbtool.cli.options import PortOptions, TcpPorts
    from mbtool.core import LinkSpec
    from mbtool.decode.line_timing import LineTiming
    from mbtool.ports.tcp_listener import AllowedPeers
    from mbtool.workflows.shared.recorder import Log
    from mbtool.workflows.sniff import Sniffer


def heard_ports(links: Sequence[LinkSpec], options: PortOptions) -> TcpPorts:
    """Return the TCP ports of --port and --rtu-port; 502 if --port names none.

    If --port is given but no link is an interface (net:), print that it has no effect. Raises
    UsageError for a text that is no port, and for a port that both options name.
    """
    from mbtool.cli.talk import say
    from mbtool.core import InterfaceLink
    from mbtool.core.link_spec import MODBUS_PORT

    given = options.tcp_ports()
    if (
        options.port
        and not given.any_port
        and not any(isinstance(one, InterfaceLink) for one in links)
    ):
        say("mbtool: --port has no effect: it is for interfaces (net:), and there is none")
    return given if given.ports else given._replace(ports=[MODBUS_PORT])


def allowed_networks(
    links: Sequence[LinkSpec],
    networks: Sequence[str] | None,
    connections: ConnectionOptions | None = None,
) -> AllowedPeers:
    """Return the networks whose masters a tap accepts, and the limits of their connections.

    `networks` are the texts of --allow; None and () admit only masters on this machine. Raises
    UsageError for a text that is no network, and if networks or limits are given without a tap.
    """
    from mbtool.core import TapLink, UsageError
    from mbtool.ports.tcp_listener import AllowedPeers, ConnectionLimits

    if networks and not any(isinstance(one, TapLink) for one in links):
        raise UsageError("--allow is for taps, and there is none; write tap:LISTEN=TARGET")
    limits = ConnectionLimits() if connections is None else connections.read()
    if limits != ConnectionLimits() and not any(isinstance(one, TapLink) for one in links):
        raise UsageError(
            "--max-connections, --max-rate and --idle are for taps, and there is none; "
            "write tap:LISTEN=TARGET"
        )
    return AllowedPeers.parse(networks or (), limits)


def read_only_taps(links: Sequence[LinkSpec], ports: TcpPorts) -> list[LinkSpec]:
    """Return the links, with each tap made read-only, so that it refuses requests that write.

    A tap whose target has one of the RTU ports carries RTU over TCP, else Modbus/TCP. Raises
    UsageError if no link is a tap.
    """
    from mbtool.core import TapLink, UsageError

    if not any(isinstance(one, TapLink) for one in links):
        raise UsageError("--read-only is for taps, and there is none; write tap:LISTEN=TARGET")
    return [
        replace(one, read_only=True, is_rtu=one.target.port in ports.rtu_ports)
        if isinstance(one, TapLink)
        else one
        for one in links
    ]


def sniffer_of(
    links: Sequence[LinkSpec],
    timing: LineTiming,
    ports: TcpPorts,
    allowed: AllowedPeers,
    begin: Callable[[], Log] | None = None,
    on_remark: Callable[[str], None] | None = None,
    *,
    reconnects: bool = False,
) -> Sniffer:
    """Make a sniffer, which listens on the links and decodes what it hears.

    `begin` creates its log; with None nothing is logged. `on_remark` gets each message about a
    problem, such as a lost link; with None it is printed. With `reconnects`, the sniffer opens a
    lost link again.
    """
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
        reconnects=reconnects,
        on_remark=on_remark or (lambda text: say(f"mbtool: {text}")),
    )
