"""Creates the live source (serial port, interface or tap) that a LINK of the user names."""

# The module of a source is imported only when it is needed, as the imports of scapy and pyserial
# take long.

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from mbtool.core import AutoLink, InterfaceLink, LinkSpec, SerialLink, TapLink, TcpLink, UsageError
from mbtool.core.limits import MODBUS_PORT
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers

if TYPE_CHECKING:
    from mbtool.sources.inbox import Inbox, PatientSink
    from mbtool.sources.source import LiveSource


def live_source(
    link: LinkSpec,
    inbox: Inbox,
    *,
    ports: Sequence[int] = (MODBUS_PORT,),
    allowed: AllowedPeers = THIS_MACHINE,
    returns: bool = False,
) -> LiveSource[Any]:
    """Return the source for a link, not yet open.

    `ports` are the TCP ports whose packets are captured from an interface; an empty list means all
    ports. `allowed` are the machines that may connect to a tap. With `returns`, a serial port or an
    interface that is lost is opened again when it is back. Raises UsageError for a link that cannot
    be captured.
    """
    if returns and isinstance(link, SerialLink | InterfaceLink):
        from mbtool.sources.returning import ReturningSource

        return ReturningSource(link, inbox, partial(_source, link, ports))
    match link:
        case SerialLink() | InterfaceLink():
            return _source(link, ports, inbox, {})
        case TapLink():
            from mbtool.sources.tap import TapSource

            return TapSource(link, inbox, allowed=allowed, waits=True)
        case AutoLink():
            raise UsageError(f"link {link}: its settings are to be found first (guess_line)")
        case TcpLink():
            free = 1503 if link.endpoint.port == 1502 else 1502
            raise UsageError(
                f"link {link}: an endpoint cannot be listened to; put a tap before it "
                f"(tap:127.0.0.1:{free}={link.endpoint}) or capture its interface (net:eth0)"
            )


def _source(
    link: SerialLink | InterfaceLink,
    ports: Sequence[int],
    inbox: PatientSink,
    places: Mapping[str, str],
) -> LiveSource[Any]:
    match link:
        case SerialLink(slave_port=str(), is_relay=False):
            from mbtool.sources.two_taps import TwoTapsSource

            return TwoTapsSource(link, inbox, places=places)
        case SerialLink():
            from mbtool.sources.serial_capture import SerialSource

            return SerialSource(link, inbox, places=places)
        case InterfaceLink():
            from mbtool.sources.interface import InterfaceSource

            return InterfaceSource(link, inbox, ports=ports)
