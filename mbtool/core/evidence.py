"""The data that sources deliver: bytes and packets with their times, not decoded."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple


class Direction(StrEnum):
    """From master or from slave. On a two-wire bus UNKNOWN until the decoder has decided."""

    REQUEST = "request"
    RESPONSE = "response"
    UNKNOWN = "unknown"


class Stamp(StrEnum):
    """Which bytes of a chunk the time of the chunk belongs to."""

    AT_ONCE = "at-once"
    """To all bytes: a TCP segment."""
    LAST_BYTE = "last-byte"
    """To the last byte; each other byte is one character time before the next: a serial read."""
    UNKNOWN = "unknown"
    """To none: a raw file. Only the order of the bytes is known."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a TCP connection."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class Connection:
    """A TCP connection: which end is the master and which the slave."""

    master: Endpoint
    slave: Endpoint
    number: int = 0
    """A count of the source's connections. It tells apart two connections between the same ends."""

    @property
    def link(self) -> str:
        """The link's name: the slave's address, with its port unless that is 502."""
        return self.slave.host if self.slave.port == 502 else str(self.slave)


class StreamPlace(NamedTuple):
    """Where the bytes of a TCP segment belong in their connection. Positions count bytes."""

    position: int
    """The position of the first byte in its direction."""
    acknowledged: int | None
    """The position in the other direction up to which the sender had received all bytes when it
    sent the segment; None if unknown."""

    def after(self, count: int) -> StreamPlace:
        """The place of the bytes after the first `count` bytes."""
        return self._replace(position=self.position + count)


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The bytes of one read of a port, or the payload of one TCP segment."""

    ts_ns: int
    """UTC nanoseconds, taken right after the read."""
    link: str
    """The name of the bus, or the slave's address. A part of log topics, so without a slash."""
    data: bytes
    direction: Direction = Direction.UNKNOWN
    stamp: Stamp = Stamp.LAST_BYTE
    connection: Connection | None = None
    """None on a serial line."""
    place: StreamPlace | None = field(default=None, compare=False)
    """Its place in the TCP connection; None if unknown, as with a tap or a serial line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Packet:
    """A packet with all headers, as the capture file or the interface gave it."""

    ts_ns: int
    """UTC nanoseconds."""
    link: str
    """The interface's name, or the capture's number for it."""
    link_type: int
    """A LINKTYPE_ value of the pcap registry (tcpdump.org/linktypes.html)."""
    data: bytes
    original_length: int
    """Bytes on the wire; more than len(data) if the capture cut the packet."""


@dataclass(frozen=True, slots=True)
class Quiet:
    """Says that nothing has arrived on a link until a time, so that a decoder knows of silence."""

    ts_ns: int
    link: str
