"""The data that sources deliver: bytes and packets with their times, not decoded."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple


class Direction(StrEnum):
    """Who sent: REQUEST if it was the master, RESPONSE if it was a slave.

    What is heard on a two-wire bus is UNKNOWN until the decoder has decided.
    """

    REQUEST = "request"
    RESPONSE = "response"
    UNKNOWN = "unknown"


class Stamp(StrEnum):
    """Which bytes of a chunk the time of the chunk belongs to."""

    AT_ONCE = "at-once"
    """All bytes have the time of the chunk, as in a TCP segment."""
    LAST_BYTE = "last-byte"
    """The last byte has the time of the chunk, and each other byte ended one character time before
    the next, as in a read of a serial port."""
    UNKNOWN = "unknown"
    """No byte has the time of the chunk, as in a file of bytes without times: only the order of the
    bytes is known."""


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
    """The number of the connection among all of the same source, such as a capture file. It tells
    two connections between the same ends apart."""

    @property
    def link(self) -> str:
        """The link's name: the slave's address, with its port unless that is 502."""
        return self.slave.host if self.slave.port == 502 else str(self.slave)


class LinkAddresses(NamedTuple):
    """What the header of the link layer says of a packet."""

    source_mac: str | None
    """The sender's MAC address, as `00:0a:e4:01:02:03`; None on the loopback interface."""
    destination_mac: str | None
    """The receiver's MAC address; None also if the capture does not keep it."""
    vlan: int | None
    """The VLAN id, of several tags that of the innermost; None without a tag, or for id 0."""


class Origin(NamedTuple):
    """Where bytes come from: a packet, or a place in a file of serial bytes."""

    file: str
    """The capture file, as the user named it; empty if the bytes were heard live."""
    packet: int
    """The number of the packet in its file, counted from 1; 0 if it has none."""
    addresses: LinkAddresses | None = None
    """The addresses of the packet on the link layer, if it has any."""
    offset: int | None = None
    """The number of bytes of the line before these in a file of serial bytes; None for packets."""


class StreamPlace(NamedTuple):
    """The position of the bytes of a TCP segment in their connection, or of a serial line's bytes
    in their file. It counts bytes.
    """

    position: int
    """The position of the first byte in its direction."""
    acknowledged: int | None
    """The position in the other direction up to which the sender had received all bytes when it
    sent the segment; None if unknown."""
    origin: Origin | None = None
    """The packet or the file that the bytes come from; None if unknown."""

    def after(self, count: int) -> StreamPlace:
        """The place of the bytes after the first `count` bytes."""
        return self._replace(position=self.position + count)


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The bytes of one read of a port, or the payload of one TCP segment."""

    ts_ns: int
    """When the bytes were read or captured, in UTC ns. For a read of a port, the clock is read
    right after it."""
    link: str
    """The name of the serial line, or the slave's address. It contains no slash, because it is a
    part of the names of topics in a log."""
    data: bytes
    direction: Direction = Direction.UNKNOWN
    stamp: Stamp = Stamp.LAST_BYTE
    connection: Connection | None = None
    """The TCP connection that carried the bytes; None on a serial line."""
    place: StreamPlace | None = field(default=None, compare=False)
    """Its place in the TCP connection, or in the file of a serial line; None if unknown, as with
    bytes that were heard live on a serial line or by a tap."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Packet:
    """A packet with all headers, as the capture file or the interface gave it."""

    ts_ns: int
    """When the packet was captured, in UTC ns."""
    link: str
    """The name of the network interface, or `if` and the number that the capture file gives it."""
    link_type: int
    """A LINKTYPE_ value of the pcap registry (tcpdump.org/linktypes.html)."""
    data: bytes
    original_length: int
    """Bytes that the packet had on the wire; more than len(data) if the capture cut it."""
    file: str = field(default="", compare=False)
    """The capture file, as the user named it; empty for a packet that is heard live."""
    number: int = field(default=0, compare=False)
    """Its number in the file, counted from 1 over all interfaces; 0 for one heard live."""


@dataclass(frozen=True, slots=True)
class Quiet:
    """Tells a decoder that nothing more has arrived on a link up to `ts_ns`."""

    ts_ns: int
    link: str
