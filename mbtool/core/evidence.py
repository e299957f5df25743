"""The data that sources deliver: bytes and packets with their times, not yet decoded."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple, Self

from mbtool.core.limits import MODBUS_PORT


class Direction(StrEnum):
    """Says who sent bytes: REQUEST is the master, RESPONSE is a slave.

    Bytes from a two-wire bus are UNKNOWN until the decoder has found out who sent them.
    """

    REQUEST = "request"
    RESPONSE = "response"
    UNKNOWN = "unknown"


class Stamp(StrEnum):
    """Says to which bytes of a chunk the chunk's time (`ts_ns`) belongs."""

    AT_ONCE = "at-once"
    """The time of the chunk is that of all its bytes, as in a TCP segment."""
    LAST_BYTE = "last-byte"
    """The time of the chunk is that of its last byte, and each other byte ended one character time
    before the next, as in a read of a serial port."""
    UNKNOWN = "unknown"
    """The time of the chunk is that of no byte, as in a file of bytes without times: only the order
    of the bytes is known."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a connection: a host (an IP address or a name) and a TCP or UDP port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class Connection:
    """A TCP connection, or all datagrams of UDP between two ends: the master's and the slave's."""

    master: Endpoint
    slave: Endpoint
    number: int = 0
    """The number of the connection among all connections of the same source, such as a capture
    file. It tells two connections between the same endpoints apart."""
    is_udp: bool = False
    """True for datagrams of UDP, which may be lost, doubled or out of order."""

    def __hash__(self) -> int:
        # These three fields tell most connections apart. The decoder looks a connection up for
        # each segment, and a hash of all fields would take three times as long.
        return hash((self.number, self.master.port, self.slave.host))

    @property
    def link(self) -> str:
        """The link's name: the slave's address, with its port unless that is 502."""
        return self.slave.host if self.slave.port == MODBUS_PORT else str(self.slave)


class LinkAddresses(NamedTuple):
    """The MAC addresses and the VLAN in the link-layer header of a packet."""

    source_mac: str | None
    """The sender's MAC address, as `00:0a:e4:01:02:03`; None on the loopback interface."""
    destination_mac: str | None
    """The receiver's MAC address; None on the loopback, and if the capture does not keep it."""
    vlan: int | None
    """The VLAN id of the innermost tag; None without a tag, or if the id is 0."""


class Origin(NamedTuple):
    """The origin of captured bytes: a packet, or a position in a file of serial bytes."""

    file: str
    """The capture file, as the user named it; empty in a live capture."""
    packet: int
    """The number of the packet in its file, counted from 1; 0 if it has none."""
    addresses: LinkAddresses | None = None
    """The addresses of the packet on the link layer, if it has any."""
    offset: int | None = None
    """The number of bytes of the serial line that precede these bytes in their file; None for a
    packet."""


class StreamPlace(NamedTuple):
    """The position of a TCP segment's bytes in its connection, or of serial bytes in their file."""

    position: int
    """The number of bytes that precede these in the same direction of the connection, or in the
    file."""
    acknowledged: int | None
    """The number of bytes of the other direction that the sender had acknowledged when it sent the
    segment; None if unknown."""
    origin: Origin | None = None
    """The packet or the file that the bytes come from; None if unknown."""

    def after(self, count: int) -> StreamPlace:
        """Return the place of the bytes that follow the first `count` bytes."""
        return self._replace(position=self.position + count)


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The bytes of one read of a port, or the payload of one TCP segment."""

    ts_ns: int
    """The time, in UTC ns, at which the bytes were read or captured. For a port this is the time
    right after the read."""
    link: str
    """The name of the serial line, or the slave's address. It contains no slash, because it is a
    part of the names of topics in a log."""
    data: bytes
    direction: Direction = Direction.UNKNOWN
    stamp: Stamp = Stamp.LAST_BYTE
    connection: Connection | None = None
    """The TCP connection that carried the bytes; None on a serial line."""
    place: StreamPlace | None = field(default=None, compare=False)
    """The position of the bytes in the TCP connection, or in the file of a serial line. None if
    unknown, as in a live capture of a serial line or a tap."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Packet:
    """A packet with all headers, as the capture file or the interface gave it."""

    ts_ns: int
    """The time of the packet's capture, in UTC ns."""
    link: str
    """The name of the network interface, or `if` with its number in the capture file: `if0`."""
    link_type: int
    """A LINKTYPE_ value of the pcap registry (tcpdump.org/linktypes.html)."""
    data: bytes
    original_length: int
    """The number of bytes that the packet had on the wire; more than len(data) if the capture cut
    it."""
    file: str = field(default="", compare=False)
    """The capture file, as the user named it; empty in a live capture."""
    number: int = field(default=0, compare=False)
    """The packet's number in the file, from 1, counted over all interfaces; 0 in a live capture."""


@dataclass(frozen=True, slots=True)
class Quiet:
    """Says that all bytes that arrived on a link up to `ts_ns` (UTC ns) have been delivered."""

    ts_ns: int
    link: str


# The code below defines the events of a link: everything that is reported besides transactions,
# such as a gap or skipped bytes.


class EventKind(StrEnum):
    """The kind of an event. Logs and filters contain these values, so they never change."""

    SKIPPED = "skipped"
    """Captured bytes that could not be read as Modbus."""
    BAD_CHECK = "bad-check"
    """A frame whose CRC or LRC is wrong."""
    FOREIGN = "foreign"
    """Well-formed bytes of another protocol, such as an MBAP header whose protocol id is not 0."""
    LINE_ERROR = "line-error"
    """Errors that a port's driver reports: parity, framing, break, overrun. The time of the event
    may be up to 1 s after the error."""
    GAP = "gap"
    """Bytes that are known to be missing from the capture."""
    OVERLAP = "overlap"
    """A retransmission whose bytes differ from the first copy."""
    SENT_AGAIN = "sent-again"
    """A TCP segment that its sender repeated after a while, as after a loss. A copy that comes at
    once, as from a mirror port, does not count as one."""
    DISCARDED = "discarded"
    """Data that was dropped because a limit of this program was exceeded."""
    REFUSED = "refused"
    """A tap could not make a connection: the master is not allowed, the slave cannot be reached, or
    TLS failed."""
    BLOCKED = "blocked"
    """A read-only tap did not pass a request on to the slave, and answered it itself."""
    OPENED = "opened"
    CLOSED = "closed"
    UNREADABLE = "unreadable"
    """A packet or link type that this program cannot read."""
    MISPLACED = "misplaced"
    """The two ports of a link are in the wrong order: the one for the master receives responses."""
    ECHO = "echo"
    """The second copy of a request, from an adapter that also receives its own bytes."""
    REPEATED = "repeated"
    """The second copy of a response, from a repeater that sends each frame again, or from two taps
    of one line."""
    TWO_MASTERS = "two-masters"
    """Several masters seem to be on a serial line: requests come while other requests still wait
    for their response. Reported once for each line."""
    SPOILT = "spoilt"
    """This program, playing the slave, distorted a response on purpose, as the user asked."""
    UNRECORDED = "unrecorded"
    """This program, playing a recording, was asked what the recording has no request for."""
    CLOCK_STEP = "clock-step"
    """Somebody set the system's clock during the recording. The times in the log do not jump."""
    DISORDER = "disorder"
    """Reads of a serial line have times a little before those of the reads before, so that its
    silences are uncertain. Reported once for each line."""
    CUT = "cut"
    """The file ends in the middle of a record, or the capture kept only part of a packet."""


CONNECTION_CLOSED = "connection closed: "
"""The beginning of the message of CLOSED events; ConnectionEnd reads the rest."""
CONNECTION_OPENED, CONNECTION_JOINED = "connection opened", "connection joined"
"""The messages of OPENED events. The first is for a connection whose beginning is in the capture,
the second for one that had begun before the capture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WireEvent:
    """Something that happened on a link and is no transaction, such as a gap."""

    ts_ns: int
    link: str
    kind: EventKind
    message: str
    """A sentence for the user that says what happened."""
    source: str = ""
    destination: str = ""
    raw: bytes = b""
    """The bytes that the event is about, such as the skipped ones; empty if there are none."""
    missing: int = 0
    """Number of bytes that the capture lacks; 0 if unknown."""
    packets: int = 0
    """Number of packets of a network interface that the capture lacks; 0 if none or unknown."""


@dataclass(frozen=True, slots=True)
class ConnectionEnd:
    """The way in which a TCP connection ended, read from the message of its CLOSED event.

    A log stores no more than this message.
    """

    reason: str
    """A value of CloseReason (packets/stream_events.py), such as `reset`; a text of another version
    of mbtool is kept as it is."""
    by: str = ""
    """`master` or `slave`: who sent the RST or the first FIN; empty if nobody did or it is
    unknown."""
    keep_alives: int = 0
    """The number of keep-alive probes of both ends."""
    unanswered: int = 0
    """The number of keep-alive probes of one end to which the other end never replied, at the end
    of the connection."""

    @classmethod
    def of(cls, event: WireEvent) -> Self | None:
        """Read the message of a CLOSED event; None for an event of another kind."""
        match = _CLOSED.match(event.message) if event.kind is EventKind.CLOSED else None
        if match is None:
            return None
        probes, unanswered = (int(number or 0) for number in match.group("probes", "unanswered"))
        return cls(match["reason"], match["by"] or "", probes, unanswered)


_CLOSED = re.compile(
    rf"{CONNECTION_CLOSED}(?P<reason>.+?)(?: by the (?P<by>master|slave))?"
    r"(?:, (?P<probes>\d+) keep-alive probes)?(?:, the last (?P<unanswered>\d+) unanswered)?$"
)
