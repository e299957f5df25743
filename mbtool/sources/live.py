"""Opens the live source that a LINK names."""

# Each kind of source is imported when one is asked for: scapy and pyserial take their time.

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, Self, runtime_checkable

from mbtool.core import AutoLink, InterfaceLink, LinkSpec, SerialLink, TapLink, TcpLink, UsageError
from mbtool.core.link_spec import MODBUS_PORT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.sources.inbox import Inbox


class LiveSource(Protocol):
    """Puts what it hears into an inbox while its context is open, and Ended when it has ended.

    Entering raises LinkError. When the context is left, all that was heard is in the inbox.
    """

    @property
    def link(self) -> str:
        """The name that its items carry."""
        ...

    @property
    def place(self) -> str:
        """The link it listens to, as opened: with the port it was given, where it asked for 0."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


@runtime_checkable
class Accepting(Protocol):
    """A source that others call. It lets nobody in before `accept`."""

    def accept(self) -> None: ...


def live_source(
    link: LinkSpec, inbox: Inbox, *, ports: Sequence[int] = (MODBUS_PORT,)
) -> LiveSource:
    """The source for a link; `ports` says which TCP ports an interface captures, none for all.

    Raises UsageError for a link that cannot be listened to.
    """
    match link:
        case SerialLink(slave_port=str(), is_relay=False):
            from mbtool.sources.two_taps import TwoTapsSource

            return TwoTapsSource(link, inbox)
        case SerialLink():
            from mbtool.sources.serial_capture import SerialSource

            return SerialSource(link, inbox)
        case InterfaceLink():
            from mbtool.sources.interface import InterfaceSource

            return InterfaceSource(link, inbox, ports=ports)
        case TapLink():
            from mbtool.sources.tap import TapSource

            return TapSource(link, inbox, waits=True)
        case AutoLink():
            raise UsageError(f"link {link}: its settings are to be found first (guess_line)")
        case TcpLink():
            raise UsageError(
                f"link {link}: an endpoint cannot be listened to; put a tap before it "
                f"(tap:127.0.0.1:1502={link.endpoint}) or capture its interface (net:eth0)"
            )
