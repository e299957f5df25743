"""Chooses the shell for a link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.slave.serial_shell import SerialSlave
from mbtool.slave.tcp_shell import TcpSlave

if TYPE_CHECKING:
    from mbtool.modbus.answer import Responder
    from mbtool.slave.shell import OnExchange, Shell


def open_shell(
    link: LinkSpec,
    responder: Responder,
    *,
    allow_remote: bool = False,
    on_exchange: OnExchange | None = None,
) -> Shell:
    """A shell that will play a responder on a link, not yet started.

    Raises UsageError for a link that no slave can be on.
    """
    match link:
        case SerialLink():
            link.demand_one_port()
            return SerialSlave(link, responder, on_exchange=on_exchange)
        case TcpLink():
            return TcpSlave(link, responder, allow_remote=allow_remote, on_exchange=on_exchange)
        case _:
            raise UsageError(
                f"link {str(link)!r}: a slave is on rtu:PORT, ascii:PORT, tcp:HOST:PORT "
                "or rtu+tcp:HOST:PORT"
            )
