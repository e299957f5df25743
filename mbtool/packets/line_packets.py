"""Writes the frames of a serial line or a tap as IP packets that Wireshark decodes, and reads them
back.
"""

# A frame becomes a raw IPv4 packet (link type 228) with a UDP datagram to or from port 502:
#
#     IPv4 header, 20 bytes   UDP header, 8 bytes   MBAP header, 6 bytes   unit, PDU   CRC or LRC
#
# The length in the MBAP header counts unit and PDU only, so Wireshark shows the CRC or LRC behind
# them as padding. A frame from a tap on TCP is its ADU, without CRC. The master of link number L is
# 10.0.0.L, port 20502; its slave UNIT is 10.0.L.UNIT, port 502. The UDP checksum is 0 (RFC 768:
# none).
#
# Bytes that are no frame become packets of link type 250 (RTAC_SERIAL) on another interface.
#
# These packets cannot hold everything, such as the times of single reads. The rest is written as
# JSON into an option and a block for local use (pcapng: codes with the highest bit set, which other
# programs skip):
#
#     LOCAL_OPTION of a packet    WireReads: which reads of a port brought the bytes, and when
#     LOCAL_BLOCK                 CaptureHead: links, devices and profiles, as a log has them
#
# So the bytes and times of the line are read back exactly. A read whose bytes are spread over
# several packets is joined again: `is_open` says that a packet's last read continues in the next
# packet.
#
# Memory: for each link and direction the bytes of one unfinished read, at most MAX_CAPTURED.

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import msgspec

from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    EventKind,
    Origin,
    Packet,
    Stamp,
    StreamPlace,
    WireEvent,
)
from mbtool.core.limits import MODBUS_PORT
from mbtool.packets.made_packets import internet_checksum
from mbtool.packets.pcap import MAX_CAPTURED

# The code below extracts the bytes of a serial line from the packets of a capture file.
#
# Link types (tcpdump.org/linktypes.html):
#
#     147..162   USER0 to USER15: their use is free. Here a packet is a frame or a burst of bytes
#                without a header. Tools write RTU with 147; the others are read if the user says
#                what they contain.
#     250        RTAC_SERIAL: a header of 12 bytes, big-endian, then bytes of the line
#
#     seconds  microseconds  event  control lines  footer     the header of 250
#     4        4             1      1              2
#
# The time of a packet is that of its last byte, since a tool takes the time after it has read a
# burst. The header of link type 250 repeats this time. Its events 1 to 4 say whether the capturing
# device sent or received the bytes. They do not say whether it was the master, and a device that
# only listens receives from both. So the decoder finds out the direction from the bytes.

RTAC_SERIAL = 250
SERIAL_LINK_TYPES = frozenset((147, RTAC_SERIAL))
"""Link types that are always read as bytes of a serial line: 147 (USER0), RTAC_SERIAL."""
USER_LINK_TYPES = frozenset(range(147, 163))
"""Link types (USER0 to USER15) that are free for any use. Those other than 147 are read as bytes of
a serial line only if the user says so with --link."""

RTAC_HEADER = 12
"""The length of the header of link type 250, in bytes."""
_EVENT_AT = 8
_REPORTED = {
    0x05: (EventKind.GAP, "the device that captured has lost data"),
    0x07: (EventKind.LINE_ERROR, "a framing error"),
    0x08: (EventKind.LINE_ERROR, "a parity error"),
    0x09: (EventKind.LINE_ERROR, "a break"),
    0x0A: (EventKind.GAP, "bytes are lost: the receiver was overrun"),
}
"""The event types of RTAC_SERIAL packets (link type 250) that are reported. The others mark the
begin and the end of data, or control lines."""


def serial_pieces(packet: Packet) -> list[Chunk | WireEvent]:
    """Return the bytes of a serial line in a packet as a Chunk, and events for errors.

    An event reports an error that the capturing device recorded, or bytes that are missing. The
    packet's link type is RTAC_SERIAL or one of USER_LINK_TYPES.
    """
    pieces: list[Chunk | WireEvent] = []
    data = packet.data
    if packet.link_type == RTAC_SERIAL:
        if len(data) < RTAC_HEADER:
            text = f"a record of {len(data)} bytes; the header of RTAC serial has {RTAC_HEADER}"
            return [_event(packet, EventKind.UNREADABLE, text, raw=data)]
        report = _REPORTED.get(data[_EVENT_AT])
        data = data[RTAC_HEADER:]
        if report is not None:
            pieces.append(_event(packet, *report))
    if data:
        place = StreamPlace(0, None, Origin(packet.file, packet.number))
        pieces.append(Chunk(ts_ns=packet.ts_ns, link=packet.link, data=data, place=place))
    missing = packet.original_length - len(packet.data)
    if missing > 0:
        text = f"a packet without its last {missing} bytes; capture longer ones"
        pieces.append(_event(packet, EventKind.CUT, text, missing=missing))
    return pieces


def _event(
    packet: Packet, kind: EventKind, message: str, *, raw: bytes = b"", missing: int = 0
) -> WireEvent:
    return WireEvent(
        ts_ns=packet.ts_ns,
        link=packet.link,
        kind=kind,
        message=message,
        raw=raw,
        missing=missing,
    )


RAW_IPV4 = 228
LOCAL_OPTION = 0x8D62
LOCAL_BLOCK = 0x80008D62
MASTER_PORT = 20502
MAX_LINK_NUMBER = 255

_IPV4 = struct.Struct(">BBHHHBBH4s4s")
_UDP = struct.Struct(">HHHH")
_DONT_FRAGMENT = 0x4000
_TIME_TO_LIVE = 64
_UDP_PROTOCOL = 17
_MAX_NS = 2**63 - 1
_PAYLOAD_AT = _IPV4.size + _UDP.size


# Another program may have written the LOCAL_BLOCK from which this class is read, so it may hold
# anything. Its size is at most MAX_BLOCK, as that of all pcapng blocks.
class CaptureHead(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Describes the serial lines and taps whose bytes a pcapng file holds.

    The fields are the same as in the metadata of a log.
    """

    capture: dict[str, str] = {}
    links: dict[str, dict[str, str]] = {}
    """The settings of each link, such as its LINK as text, by the link's name."""
    devices: dict[str, str] = {}
    """The name of each device's profile; the key names the device as `--device` does."""
    profiles: dict[str, bytes] = {}
    """The device profiles as JSON, by the profile's name."""


class WireReads(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Describes the reads of a port or socket whose bytes a packet holds."""

    reads: list[tuple[int, int]]
    """For each read, the number of its bytes that are in this packet, and the time of the read in
    UTC ns."""
    is_open: bool = False
    """True if the last read continues with the first bytes of the next packet."""
    skip: int = 0
    """The number of bytes at the start of the payload (such as an MBAP header) that `convert` has
    added; the bytes that were on the link begin behind them."""
    raw: bytes | None = None
    """The bytes as they were on the link, if the payload shows them in another form, as it does for
    an ASCII frame; None if the payload has them unchanged."""
    direction: Direction = Direction.UNKNOWN
    stamp: Stamp = Stamp.LAST_BYTE
    connection: Connection | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LinePacket(Packet):
    """A packet that `convert` made from bytes of a serial line or a tap.

    The decoder takes `chunks`, the original reads, instead of the packet.
    """

    chunks: tuple[Chunk, ...] = field(default=(), compare=False)
    """The reads of the port that end in this packet; empty if they continue in the next one."""


class LineEnds(NamedTuple):
    """The made-up IP addresses that stand for a master and a slave in a packet."""

    master: bytes
    """The master's IPv4 address, 4 bytes."""
    slave: bytes
    master_port: int = MASTER_PORT

    @classmethod
    def of(cls, link_number: int, unit: int, master_port: int = MASTER_PORT) -> LineEnds:
        """Return the addresses for link number `link_number` (1 to 255) and a unit.

        `master_port` is the master's made-up UDP port.
        """
        return cls(bytes((10, 0, 0, link_number)), bytes((10, 0, link_number, unit)), master_port)


def line_datagram(ends: LineEnds, number: int, payload: bytes, *, is_request: bool) -> bytes:
    """Return an IPv4 packet with a UDP datagram that carries `payload`.

    The master sends it if `is_request` is True, else the slave. The lower 16 bits of `number`
    become the identification in the IPv4 header.
    """
    source, destination = ends.master, ends.slave
    ports = [ends.master_port, MODBUS_PORT]
    if not is_request:
        source, destination = destination, source
        ports.reverse()
    size = _UDP.size + len(payload)
    header = [0x45, 0, _IPV4.size + size, number & 0xFFFF, _DONT_FRAGMENT, _TIME_TO_LIVE]
    checksum = internet_checksum(_IPV4.pack(*header, _UDP_PROTOCOL, 0, source, destination))
    packet = _IPV4.pack(*header, _UDP_PROTOCOL, checksum, source, destination)
    return packet + _UDP.pack(*ports, size, 0) + payload


def with_mbap(number: int, body: bytes, check: bytes) -> bytes:
    """Return the UDP payload for a serial frame: MBAP header, `body`, `check`.

    `body` is unit and PDU, `check` the CRC or LRC. The lower 16 bits of `number` become the
    transaction id.
    """
    return struct.pack(">HHH", number & 0xFFFF, 0, len(body)) + body + check


def rtac_packet(ts_ns: int, data: bytes, *, by_master: bool) -> bytes:
    """Return a packet of link type 250 (RTAC_SERIAL) with bytes of a serial line.

    `ts_ns` is their time in UTC ns; `by_master` is True if the master sent them.
    """
    seconds, ns = divmod(ts_ns, 1_000_000_000)
    sent = 1 if by_master else 2
    return struct.pack(">IIBBH", seconds & 0xFFFFFFFF, ns // 1000, sent, 0, 0) + data


def error_packet(event: WireEvent) -> Packet | None:
    """Return a packet of link type 250 (RTAC_SERIAL) without bytes that reports a framing error, a
    parity error or a break of a serial line.

    Returns None for another event, and for one that may be several of them.
    """
    codes = [
        code
        for code, (kind, message) in _REPORTED.items()
        if kind is EventKind.LINE_ERROR and message.split()[1] in event.message
    ]
    if event.kind is not EventKind.LINE_ERROR or len(codes) != 1:
        return None
    data = bytearray(rtac_packet(event.ts_ns, b"", by_master=False))
    data[_EVENT_AT] = codes[0]
    return Packet(
        ts_ns=max(event.ts_ns, 0),
        link=event.link,
        link_type=RTAC_SERIAL,
        data=bytes(data),
        original_length=len(data),
    )


class OpenReads:
    """Joins the bytes of reads of a port that are spread over several packets."""

    def __init__(self) -> None:
        self._open: dict[tuple[object, ...], Chunk] = {}
        """The bytes that have come of each read that continues in the next packet. The key is the
        read's link, direction and connection."""

    def take(
        self, like: Chunk, data: bytes, reads: Iterable[tuple[int, int]], *, is_open: bool
    ) -> list[Chunk]:
        """Take the bytes of the next packet; return the reads that end in it.

        `like` is a Chunk with the link, direction, stamp, connection and place of the reads. `data`
        are the bytes of the reads that the packet has. `reads` has the number of bytes and the time
        (UTC ns) of each read; `is_open` is True if the last one continues in a later packet.
        """
        key = (like.link, like.direction, like.connection)
        done: list[Chunk] = []
        for size, ts_ns in reads:
            piece, data = data[: max(size, 0)], data[max(size, 0) :]
            before = self._open.pop(key, None)
            if before is not None and before.ts_ns != ts_ns:
                done.append(before)
                before = None
            ts_ns = min(max(ts_ns, 0), _MAX_NS)
            whole = (before.data if before else b"") + piece
            done.append(replace(like, ts_ns=ts_ns, data=whole))
        if is_open and done and len(done[-1].data) < MAX_CAPTURED:
            self._open[key] = done.pop()
        return [chunk for chunk in done if chunk.data]

    def close(self) -> list[Chunk]:
        """Return the incomplete reads at the end of the file, with the bytes that have come."""
        held, self._open = [*self._open.values()], {}
        return held


class LineReader:
    """Restores the reads of a port from the packets that `convert` has made of them."""

    def __init__(self) -> None:
        self._reads = OpenReads()

    def read(self, packet: Packet, mark: bytes) -> Packet:
        """Return the packet as LinePacket, with the reads whose last bytes it has.

        `mark` is the packet's LOCAL_OPTION: a WireReads as JSON. A packet whose option cannot be
        parsed is returned unchanged.
        """
        try:
            wire = msgspec.json.decode(mark, type=WireReads)
        except (msgspec.DecodeError, ValueError, RecursionError):
            return packet  # ValueError: not UTF-8.
        header = _PAYLOAD_AT if packet.link_type == RAW_IPV4 else RTAC_HEADER
        data = packet.data[header + max(wire.skip, 0) :] if wire.raw is None else wire.raw
        place = None
        if wire.connection is None:
            place = StreamPlace(0, None, Origin(packet.file, packet.number))
        like = Chunk(
            ts_ns=0,
            link=packet.link,
            data=b"",
            direction=wire.direction,
            stamp=wire.stamp,
            connection=wire.connection,
            place=place,
        )
        return _line_packet(packet, self._reads.take(like, data, wire.reads, is_open=wire.is_open))

    def close(self, packet: Packet) -> LinePacket | None:
        """At the end of the file, return the incomplete reads; None if there are none.

        They are returned as the chunks of a LinePacket; `packet`, the last of the file, gives its
        other fields.
        """
        held = self._reads.close()
        return _line_packet(packet, held) if held else None


def _line_packet(packet: Packet, chunks: Iterable[Chunk]) -> LinePacket:
    return LinePacket(
        ts_ns=packet.ts_ns,
        link=packet.link,
        link_type=packet.link_type,
        data=packet.data,
        original_length=packet.original_length,
        file=packet.file,
        number=packet.number,
        chunks=tuple(chunks),
    )


def reads_of(packets: Iterable[Packet]) -> Iterator[Chunk | Packet]:
    """Yield the packets of a capture; for a LinePacket, yield its original reads instead."""
    for packet in packets:
        if isinstance(packet, LinePacket):
            yield from packet.chunks
        else:
            yield packet
