"""The items that the TCP reassembler returns beside chunks: begins and ends of connections, gaps,
events.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from mbtool.core import Chunk, Connection, Direction, EventKind, WireEvent


class CloseReason(StrEnum):
    """The reason why a connection ended."""

    FINISHED = "finished"
    """Both ends closed the connection with a FIN."""
    RESET = "reset"
    REFUSED = "refused"
    """The slave reset the connection before either end sent a byte."""
    UNANSWERED = "unanswered"
    """The master's SYN got no segment of the slave before the connection ended."""
    REPLACED = "replaced"
    """The two ends opened another connection with the same addresses and ports."""
    IDLE = "idle"
    """Nothing came for too long: no segment for IDLE_NS (2 h) in a capture, or no byte for the idle
    time after which a tap closes a connection."""
    DISCARDED = "discarded"
    """The reassembler had too many connections, and this was the least recently used one."""
    CROWDED_OUT = "unused, so it made room for another"
    """A tap had reached its limit of connections, and this one had been unused for the longest
    time."""
    CAPTURE_END = "capture-end"


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """A connection begins. Its chunks and gaps follow."""

    ts_ns: int
    connection: Connection
    joined: bool
    """True if the beginning of the connection is not in the capture. Then its first captured byte
    may lie inside an ADU."""
    note: str = ""
    """Text for the user. For a tap that uses TLS: the names in the certificates of both ends."""


@dataclass(frozen=True, slots=True)
class StreamGap:
    """Bytes of one direction that are missing between two chunks."""

    ts_ns: int
    """The time, in UTC ns, of the bytes behind the gap."""
    connection: Connection
    direction: Direction
    missing: int
    """The number of missing bytes; 0 if unknown, since the sequence numbers jumped too far."""
    kind: EventKind = EventKind.GAP
    """The kind of event to report: GAP, or CUT if the capture kept only part of a packet."""
    acknowledged_ns: int | None = None
    """The time, in UTC ns, at which the receiver first acknowledged all missing bytes; None if it
    had not done so when the gap was reported."""


@dataclass(frozen=True, slots=True)
class StreamClosed:
    """The end of a connection. No chunk of the connection follows."""

    ts_ns: int
    connection: Connection
    reason: CloseReason
    by: Direction | None = None
    """The direction of the end that sent the RST or the first FIN: REQUEST for the master, RESPONSE
    for the slave. None if neither ended the connection, or nobody knows who did."""
    keep_alives: int = 0
    """The number of keep-alive probes of both ends."""
    unanswered_probes: int = 0
    """The number of keep-alive probes of one end to which the other end never replied, at the end
    of the connection."""
    unseen_since_ns: int | None = None
    """The time, in UTC ns, of the last bytes, if no segment followed them; else None. Each segment
    with bytes is acknowledged or sent again, so the capture then lacks the rest of the
    connection."""


@dataclass(frozen=True, slots=True)
class StreamEvent:
    """An event about packets of a connection.

    An event about IP fragments may come before the StreamOpened of its connection.
    """

    connection: Connection
    event: WireEvent

    @property
    def ts_ns(self) -> int:
        return self.event.ts_ns


StreamItem = Chunk | StreamOpened | StreamGap | StreamClosed | StreamEvent | WireEvent
