"""What a source brings in: bytes with their time, before anyone has decoded them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Direction(StrEnum):
    """Who speaks. On a two-wire bus UNKNOWN is legal until the decoder has decided."""

    REQUEST = "request"
    RESPONSE = "response"
    UNKNOWN = "unknown"


class Stamp(StrEnum):
    """How the time of a chunk's bytes is known."""

    AT_ONCE = "at-once"
    """All bytes have the chunk's time: a TCP segment."""
    LAST_BYTE = "last-byte"
    """The time is the last byte's; the others precede it by the character time: a serial read."""
    UNKNOWN = "unknown"
    """The time of the bytes is not known: a raw file. They are in order, and that is all."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a TCP connection."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class Connection:
    """A TCP connection, with its ends in the roles they play for Modbus."""

    master: Endpoint
    slave: Endpoint
    number: int = 0
    """Tells apart two connections between the same ends, counted by whoever saw them open."""

    @property
    def link(self) -> str:
        """The link's name: the slave's address, with its port where that is not 502."""
        return self.slave.host if self.slave.port == 502 else str(self.slave)


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The bytes of one read of a port, or the payload of one TCP segment."""

    ts_ns: int
    """UTC nanoseconds, taken right after the read."""
    link: str
    """The bus or the slave's address; part of the log's topics, so without a slash."""
    data: bytes
    direction: Direction = Direction.UNKNOWN
    stamp: Stamp = Stamp.LAST_BYTE
    connection: Connection | None = None
    """Absent on a serial line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Packet:
    """A captured packet, whole, as the capture file or the interface gave it."""

    ts_ns: int
    """UTC nanoseconds."""
    link: str
    """The interface's name, or the capture's number for it."""
    link_type: int
    """A LINKTYPE_ value of the pcap registry (tcpdump.org/linktypes.html)."""
    data: bytes
    original_length: int
    """Bytes on the wire; more than len(data) where the capture cut the packet."""


@dataclass(frozen=True, slots=True)
class Quiet:
    """Nothing more has arrived on a link up to this moment: the time that silence needs."""

    ts_ns: int
    link: str
