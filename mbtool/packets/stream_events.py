"""Items that the reassembler gives beside the bytes of a connection, in order with them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from mbtool.core import Chunk, Connection, Direction, EventKind, WireEvent


class CloseReason(StrEnum):
    """Why a connection ended."""

    FINISHED = "finished"
    """Both ends closed it with FIN."""
    RESET = "reset"
    REFUSED = "refused"
    """The slave reset it before it was open."""
    REPLACED = "replaced"
    """Its ends opened another connection with the same ports."""
    IDLE = "idle"
    """No packet for longer than the reassembler keeps a connection."""
    DISCARDED = "discarded"
    """The reassembler keeps no more connections."""
    CAPTURE_END = "capture-end"


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """The first packet of a connection. Its chunks and gaps follow."""

    ts_ns: int
    connection: Connection
    joined: bool
    """True if its beginning is not in the capture. Its first byte may be inside an ADU."""
    note: str = ""
    """More about it. For a connection of a tap: the names in the certificates of its ends."""


@dataclass(frozen=True, slots=True)
class StreamGap:
    """Bytes of one direction that are missing between two chunks."""

    ts_ns: int
    """The time of the bytes behind the gap."""
    connection: Connection
    direction: Direction
    missing: int
    """How many bytes; 0 if unknown, since the sequence numbers jumped too far."""
    kind: EventKind = EventKind.GAP
    """GAP, or CUT if the capture kept only part of a packet."""


@dataclass(frozen=True, slots=True)
class StreamClosed:
    """The end of a connection. None of its chunks follow."""

    ts_ns: int
    connection: Connection
    reason: CloseReason
    keep_alives: int = 0
    """How many keep-alive probes both ends sent."""


@dataclass(frozen=True, slots=True)
class StreamEvent:
    """An event about packets of a connection. One about fragments may precede its StreamOpened."""

    connection: Connection
    event: WireEvent

    @property
    def ts_ns(self) -> int:
        return self.event.ts_ns


StreamItem = Chunk | StreamOpened | StreamGap | StreamClosed | StreamEvent | WireEvent
