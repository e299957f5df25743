"""Chooses the class that serves a slave on a link: a TCP or UDP endpoint, or a serial line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.core.link_spec import ANSWERED
from mbtool.ports.allowed_peers import THIS_MACHINE, AllowedPeers
from mbtool.slave.shells.serial_shell import SerialSlave
from mbtool.slave.shells.tcp_shell import TcpSlave
from mbtool.slave.shells.udp_shell import UdpSlave

if TYPE_CHECKING:
    from mbtool.modbus.response import Responder
    from mbtool.slave.device.connection_policy import ConnectionPolicy
    from mbtool.slave.shells.shell import OnExchange, Shell


def slave_link(link: LinkSpec) -> SerialLink | TcpLink:
    """Return `link` if a slave can answer on it; otherwise raise UsageError."""
    if isinstance(link, SerialLink):
        link.demand_one_port()
    if isinstance(link, SerialLink | TcpLink):
        return link
    raise UsageError(f"link {link}: a slave needs {ANSWERED}")


def open_shell(
    link: LinkSpec,
    responder: Responder,
    *,
    allowed: AllowedPeers = THIS_MACHINE,
    rules: ConnectionPolicy | None = None,
    on_exchange: OnExchange | None = None,
    strict_timing: bool = False,
) -> Shell:
    """Return a shell, not yet started, that will answer on a link with a responder's responses.

    `allowed` are the machines that may connect, and `rules` the device's rules for connections;
    neither has any use on a serial line. With `strict_timing`, a request on an RTU line gets no
    response if the silences around it are too short, or one inside it too long. Raises UsageError
    if no slave can answer on such a link, and for strict timing on a link that is no RTU line.
    """
    where = slave_link(link)
    if isinstance(where, SerialLink):
        return SerialSlave(where, responder, on_exchange=on_exchange, strict_timing=strict_timing)
    if strict_timing:
        raise UsageError(f"link {link}: strict timing is for RTU lines")
    if where.is_udp:
        return UdpSlave(where, responder, allowed=allowed, on_exchange=on_exchange)
    return TcpSlave(where, responder, allowed=allowed, rules=rules, on_exchange=on_exchange)
