"""Extracts the bytes of a serial line from the packets of a capture file."""

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
# burst. The header of link type 250 repeats this time. Its events 1 to 4 say if the capturing
# device sent or received the bytes. They do not say if it was the master, and a device that only
# listens receives from both. So the decoder finds out the direction from the bytes.

from __future__ import annotations

from mbtool.core import Chunk, EventKind, Origin, Packet, StreamPlace, WireEvent

RTAC_SERIAL = 250
SERIAL_LINK_TYPES = frozenset((147, RTAC_SERIAL))
"""Link types that are read as bytes of a serial line without being told: 147 (USER0),
RTAC_SERIAL."""
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
