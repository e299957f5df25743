"""A TCP connection that was read elsewhere, from its SYN to both FINs."""

# It takes less than a tenth of the time to make than a TcpConnection, which it becomes only if a
# later segment of the same ends must be compared with its bytes.

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mbtool.packets.connection import TcpConnection

if TYPE_CHECKING:
    from mbtool.core import Connection, Origin
    from mbtool.packets.segment import TcpSegment
    from mbtool.packets.stream_events import CloseReason


class EndedConnection:
    """Does what a closed `TcpConnection` does."""

    __slots__ = ("_begins", "_master_is_lower", "_sizes", "identity", "last_ns")

    closed: Literal[True] = True

    def __init__(
        self,
        identity: Connection,
        last_ns: int,
        begins: tuple[int, int],
        sizes: tuple[int, int],
        master_is_lower: bool,
    ) -> None:
        """`last_ns` is the time of its last segment, in UTC ns.

        `begins` and `sizes` are the sequence numbers of the first bytes and the numbers of bytes,
        of the requests and of the responses.
        """
        self.identity = identity
        self.last_ns = last_ns
        self._begins = begins
        self._sizes = sizes
        self._master_is_lower = master_is_lower

    def is_replaced_by(self, segment: TcpSegment, *, from_lower: bool) -> bool:
        """True if a segment belongs to a new connection between the same ends."""
        whole = TcpConnection(
            self.identity, self.last_ns, [], joined=False, master_is_lower=self._master_is_lower
        )
        whole.end_at(self._begins, self._sizes)
        return whole.is_replaced_by(segment, from_lower=from_lower)

    def feed(
        self, segment: TcpSegment, ts_ns: int, *, from_lower: bool, origin: Origin | None = None
    ) -> bool:
        """Ignore a segment: the connection has ended."""
        self.last_ns = ts_ns
        return False

    def close(self, ts_ns: int, reason: CloseReason) -> None:
        """Do nothing: the connection has ended."""
