"""Takes the bytes of a serial line out of the packets of a capture file."""

# Link types (tcpdump.org/linktypes.html):
#
#     147..162   USER0 to USER15: whatever who captured wanted. A packet is a frame or a burst of
#                bytes, bare. 147 is what tools write RTU with; the others are read where the user
#                says what they hold.
#     250        RTAC_SERIAL: a header of 12 bytes, big-endian, then bytes of the line
#
#     seconds  microseconds  event  control lines  footer     the header of 250
#     4        4             1      1              2
#
# A packet's time is that of its last byte: a tool stamps a burst when it has read it. The time in
# the header of 250 is the same once more. Its events 1 to 4 say whether the device that captured
# sent or received the bytes, not whether it was the master, and one that only listens receives
# both sides: the direction is left for the decoder to find.

from __future__ import annotations

from mbtool.core import Chunk, EventKind, Packet, WireEvent

RTAC_SERIAL = 250
SERIAL_LINK_TYPES = frozenset((147, RTAC_SERIAL))
"""Link types whose packets are taken for bytes of a serial line."""
USER_LINK_TYPES = frozenset(range(147, 163))
"""Link types that hold serial bytes where the user says so."""

_HEADER = 12
_EVENT_AT = 8
_TOLD = {
    0x05: (EventKind.GAP, "the device that captured has lost data"),
    0x07: (EventKind.LINE_ERROR, "a framing error"),
    0x08: (EventKind.LINE_ERROR, "a parity error"),
    0x09: (EventKind.LINE_ERROR, "a break"),
    0x0A: (EventKind.GAP, "bytes are lost: the receiver was overrun"),
}
"""Events of 250 that are worth telling. The others begin and end data, or tell of control lines."""


def serial_pieces(packet: Packet) -> list[Chunk | WireEvent]:
    """The bytes of a packet of one of these link types, and what it tells beside them."""
    pieces: list[Chunk | WireEvent] = []
    data = packet.data
    if packet.link_type == RTAC_SERIAL:
        if len(data) < _HEADER:
            text = f"a record of {len(data)} bytes; the header of RTAC serial has {_HEADER}"
            return [_event(packet, EventKind.UNREADABLE, text, raw=data)]
        told = _TOLD.get(data[_EVENT_AT])
        data = data[_HEADER:]
        if told is not None:
            pieces.append(_event(packet, *told))
    if data:
        pieces.append(Chunk(ts_ns=packet.ts_ns, link=packet.link, data=data))
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
