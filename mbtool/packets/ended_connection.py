"""The state of a TCP connection that the array decoder has read, from its SYN to both FINs."""

# An EndedConnection takes the place of a closed TcpConnection, and is made in a tenth of the time:
# it makes a Stream only if a later segment between the same ends must be compared with it.

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mbtool.core import Connection, Direction, Origin
from mbtool.packets.segment import ACK, RST, SYN, TcpSegment
from mbtool.packets.stream import Stream

if TYPE_CHECKING:
    from mbtool.packets.stream_events import CloseReason

WINDOW = 1024 * 1024
"""The largest distance, in bytes, between a segment's sequence number and the next expected one. A
segment further away belongs to another connection, or follows an unknown number of lost bytes."""


def begins_another(segment: TcpSegment, sender: Stream, *, is_closed: bool) -> bool:
    """True if a segment belongs to a new connection, not to the known one between the same ends.

    Called for a segment with SYN, or if the known connection has ended (`is_closed`). `sender` is
    the known connection's stream in the direction of the segment.
    """
    flags = segment.flags
    if flags & SYN:
        known = sender.origin is not None
        same = sender.begins_at(segment.sequence + 1 & 0xFFFFFFFF)
        return (known and not same) or (is_closed and not flags & ACK)
    if flags & RST or not (segment.payload or segment.missing):
        return False
    # The segment has bytes, though the known connection has ended. If these are no retransmission,
    # a new connection has begun: either the RST did not belong to the old connection, or the
    # capture lacks the SYN of the new one.
    size = len(segment.payload) + segment.missing
    return sender.is_new(segment.sequence, size, WINDOW)


class EndedConnection:
    """Stands for a closed `TcpConnection`: recognises late segments of it, ignores their bytes."""

    __slots__ = ("_begins", "_master_is_lower", "_sizes", "identity", "last_ns")

    closed: Literal[True] = True
    wants_bytes: Literal[False] = False

    def __init__(
        self,
        identity: Connection,
        last_ns: int,
        begins: tuple[int, int],
        sizes: tuple[int, int],
        master_is_lower: bool,
    ) -> None:
        """Keep the facts that later segments are compared with.

        `last_ns` is the time of the connection's last segment, in UTC ns. `begins` has the sequence
        numbers of the first request byte and of the first response byte, `sizes` the numbers of
        bytes of all requests and of all responses. `master_is_lower` is True if the master has the
        lower port (with equal ports, the lower address).
        """
        self.identity = identity
        self.last_ns = last_ns
        self._begins = begins
        self._sizes = sizes
        self._master_is_lower = master_is_lower

    def is_replaced_by(self, segment: TcpSegment, *, from_lower: bool) -> bool:
        """True if a segment belongs to a new connection between the same ends.

        `from_lower` is True if the segment's sender is the end with the lower port (with equal
        ports, the lower address).
        """
        is_answer = from_lower != self._master_is_lower
        sender = Stream((Direction.REQUEST, Direction.RESPONSE)[is_answer], self.identity)
        sender.begin(self._begins[is_answer])
        sender.position = self._sizes[is_answer]
        return begins_another(segment, sender, is_closed=True)

    def feed(
        self, segment: TcpSegment, ts_ns: int, *, from_lower: bool, origin: Origin | None = None
    ) -> bool:
        """Ignore a late segment but note its time; return False, as no bytes are held back."""
        self.last_ns = ts_ns
        return False

    def close(self, ts_ns: int, reason: CloseReason) -> None:
        """Do nothing: the connection has ended."""
