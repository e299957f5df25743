"""What the reassembler tells of a connection beside its bytes, in order with them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from mbtool.core import Chunk, Connection, Direction, EventKind, WireEvent


class CloseReason(StrEnum):
    """Why nothing more comes of a connection."""

    FINISHED = "finished"
    """Both ends closed it."""
    RESET = "reset"
    REFUSED = "refused"
    """Reset in answer to the attempt to open it."""
    REPLACED = "replaced"
    """Its ends opened another with the same ports."""
    IDLE = "idle"
    """Silent for longer than the reassembler keeps its state."""
    DISCARDED = "discarded"
    """More connections than the reassembler keeps."""
    CAPTURE_END = "capture-end"


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """A connection's first sign. Its chunks and gaps follow."""

    ts_ns: int
    connection: Connection
    joined: bool
    """Its beginning is not in the capture, so its first byte may be the middle of an ADU."""
    note: str = ""
    """What else is known of it: of a tap's connection, who its ends are by their certificates."""


@dataclass(frozen=True, slots=True)
class StreamGap:
    """Bytes of one direction that are missing between the chunk before and the chunk after."""

    ts_ns: int
    """The time of what comes after the gap."""
    connection: Connection
    direction: Direction
    missing: int
    """How many; 0 where the sequence numbers took a leap that says nothing."""
    kind: EventKind = EventKind.GAP
    """GAP, or CUT where the capture kept only part of a packet."""


@dataclass(frozen=True, slots=True)
class StreamClosed:
    """A connection's end. No chunk of it follows."""

    ts_ns: int
    connection: Connection
    reason: CloseReason
    keep_alives: int = 0
    """How many keep-alive probes both ends have sent."""


@dataclass(frozen=True, slots=True)
class StreamEvent:
    """What is told of a connection's packets; of fragments also before or without its opening."""

    connection: Connection
    event: WireEvent

    @property
    def ts_ns(self) -> int:
        return self.event.ts_ns


StreamItem = Chunk | StreamOpened | StreamGap | StreamClosed | StreamEvent | WireEvent
