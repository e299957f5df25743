"""Makes the Sniffer, which records and decodes, for the commands that listen on links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.cli.talk import say, shown_progress
from mbtool.core import AutoLink, InterfaceLink, LinkSpec, TapLink, UsageError
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.moments import SECOND_NS, parse_duration

if TYPE_CHECKING:
    from mbtool.cli.connection_options import ConnectionOptions
    from mbtool.cli.options import PortOptions, TcpPorts
    from mbtool.decode.line_timing import LineTiming
    from mbtool.ports.tcp_listener import AllowedPeers
    from mbtool.workflows.shared.recorder import Log
    from mbtool.workflows.sniff import Sniffer

_MOST_WAIT_S = 7 * 86_400
_TOLD_S = 30.0
"""The time in seconds between two lines about the search for settings, where standard error is no
terminal."""


def chosen_tcp_ports(links: Sequence[LinkSpec], options: PortOptions) -> TcpPorts:
    """Return the TCP ports of --port and --rtu-port; 502 if --port names none.

    If --port is given but no link is an interface (net:), print that it has no effect. Raises
    UsageError for a text that is no port, and for a port that both options name.
    """
    given = options.tcp_ports()
    if (
        options.port
        and not given.any_port
        and not any(isinstance(one, InterfaceLink) for one in links)
    ):
        say("mbtool: --port has no effect: it is for interfaces (net:), and there is none")
    return given if given.ports else given._replace(ports=[MODBUS_PORT])


def found_settings(links: Sequence[LinkSpec], wait: str | None) -> list[LinkSpec]:
    """Return the links; for one with @auto, find its settings by listening, and tell the user.

    `wait` is the text of --wait, the longest time to listen. Raises UsageError if it is no time, or
    if no link has @auto; LinkError if no settings are found.
    """
    from mbtool.workflows.sniff import with_settings

    most_ns = _MOST_WAIT_S * SECOND_NS
    wait_ns = None if wait is None else parse_duration(wait, "--wait", SECOND_NS, most_ns)
    if not any(isinstance(one, AutoLink) for one in links):
        if wait is not None:
            raise UsageError("--wait is for a link with @auto, and there is none")
        return list(links)
    with shown_progress(_TOLD_S) as show:
        return with_settings(links, say, show, None if wait_ns is None else wait_ns / SECOND_NS)


def allowed_networks(
    links: Sequence[LinkSpec],
    networks: Sequence[str] | None,
    connections: ConnectionOptions | None = None,
    *,
    serves: bool = False,
) -> AllowedPeers:
    """Return the networks whose machines a tap or the server of metrics accepts, and their limits.

    `networks` are the texts of --allow; None and () admit only this machine. `serves` says that
    there is a server of metrics. Raises UsageError for a text that is no network, and if networks
    are given without a tap or server, or limits without a tap.
    """
    from mbtool.ports.tcp_listener import AllowedPeers, ConnectionLimits

    if networks and not serves and not any(isinstance(one, TapLink) for one in links):
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
