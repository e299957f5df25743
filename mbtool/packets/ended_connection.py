"""A TCP connection that was read elsewhere, from its SYN to both FINs."""

# It takes a tenth of the time of a TcpConnection to make. Its streams are made only if a later
# segment of the same ends must be compared with them.

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mbtool.core import Direction
from mbtool.packets.segment import ACK, RST, SYN
from mbtool.packets.stream import Stream

if TYPE_CHECKING:
    from mbtool.core import Connection, Origin
    from mbtool.packets.segment import TcpSegment
    from mbtool.packets.stream_events import CloseReason

WINDOW = 1024 * 1024
"""The largest distance of a segment in flight from the next expected byte, in bytes."""


def begins_another(segment: TcpSegment, sender: Stream, *, is_closed: bool) -> bool:
    """True if a segment belongs to a new connection between the ends of another one.

    The segment has a SYN, or the other connection `is_closed`. `sender` is the stream of the same
    direction in the other connection.
    """
    flags = segment.flags
    if flags & SYN:
        known = sender.origin is not None
        same = sender.begins_at(segment.sequence + 1 & 0xFFFFFFFF)
        return (known and not same) or (is_closed and not flags & ACK)
    if flags & RST or not (segment.payload or segment.missing):
        return False
    # These bytes come after the end of the connection. If they are not a second copy, either the
    # RST that ended it was a stray one, or the SYN of the next one is not in the capture.
    size = len(segment.payload) + segment.missing
    return sender.is_new(segment.sequence, size, WINDOW)


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
        is_answer = from_lower != self._master_is_lower
        sender = Stream((Direction.REQUEST, Direction.RESPONSE)[is_answer], self.identity)
        sender.begin(self._begins[is_answer])
        sender.position = self._sizes[is_answer]
        return begins_another(segment, sender, is_closed=True)

    def feed(
        self, segment: TcpSegment, ts_ns: int, *, from_lower: bool, origin: Origin | None = None
    ) -> bool:
        """Ignore a segment: the connection has ended."""
        self.last_ns = ts_ns
        return False

    def close(self, ts_ns: int, reason: CloseReason) -> None:
        """Do nothing: the connection has ended."""
