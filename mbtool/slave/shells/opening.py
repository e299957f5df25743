"""Chooses the shell for a link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.core.link_spec import ANSWERED
from mbtool.ports.allowed_peers import THIS_MACHINE, AllowedPeers
from mbtool.slave.shells.serial_shell import SerialSlave
from mbtool.slave.shells.tcp_shell import TcpSlave

if TYPE_CHECKING:
    from mbtool.modbus.response import Responder
    from mbtool.slave.device.connection_policy import ConnectionPolicy
    from mbtool.slave.shells.shell import OnExchange, Shell


def slave_link(link: LinkSpec) -> SerialLink | TcpLink:
    """The same link, if a slave can answer on it. Raises UsageError."""
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
) -> Shell:
    """A shell that will play a responder on a link, not yet started. Raises UsageError.

    `allowed` and `rules`, those of a device for its connections, have no use on a serial line.
    """
    where = slave_link(link)
    if isinstance(where, SerialLink):
        return SerialSlave(where, responder, on_exchange=on_exchange)
    return TcpSlave(where, responder, allowed=allowed, rules=rules, on_exchange=on_exchange)
