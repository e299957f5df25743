"""The bytes of a serial line in packets of link types 147 to 162 and 250."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Chunk, Direction, EventKind, Packet, WireEvent
from mbtool.packets.line_packets import SERIAL_LINK_TYPES, USER_LINK_TYPES, serial_pieces
from tests.packets.building import cut, packet

FRAME = bytes.fromhex("01 03 0063 0001 7414")  # unit 1, read holding register 99, CRC


def _rtac(event: int, payload: bytes = b"", lines: int = 0) -> bytes:
    """Seconds, microseconds, event, control lines, footer; then bytes of the line."""
    return struct.pack(">IIBBH", 1_561_939_200, 35_638, event, lines, 0) + payload


def test_a_packet_of_a_user_link_type_is_the_bytes_themselves() -> None:
    assert serial_pieces(packet(FRAME, 7, link_type=147, link="com1")) == [
        Chunk(ts_ns=7, link="com1", data=FRAME)
    ]


@pytest.mark.parametrize("event", [1, 2, 3, 4])
def test_the_bytes_of_rtac_serial_stand_behind_its_header(event: int) -> None:
    (piece,) = serial_pieces(packet(_rtac(event, FRAME), 7, link_type=250))
    assert isinstance(piece, Chunk)
    assert (piece.ts_ns, piece.data) == (7, FRAME)
    # The capturing device may have been the master, a slave or neither.
    assert piece.direction is Direction.UNKNOWN


@pytest.mark.parametrize("event", [0, 1, 4, 6, 0xFF])
def test_a_record_of_control_lines_gives_nothing(event: int) -> None:
    assert serial_pieces(packet(_rtac(event, lines=0x18), link_type=250)) == []


@pytest.mark.parametrize(
    ("event", "kind", "word"),
    [
        (5, EventKind.GAP, "lost data"),
        (7, EventKind.LINE_ERROR, "framing error"),
        (8, EventKind.LINE_ERROR, "parity error"),
        (9, EventKind.LINE_ERROR, "break"),
        (10, EventKind.GAP, "overrun"),
    ],
)
def test_errors_of_rtac_serial_come_before_the_bytes(
    event: int, kind: EventKind, word: str
) -> None:
    error, piece = serial_pieces(packet(_rtac(event, FRAME), link_type=250))
    assert isinstance(error, WireEvent)
    assert error.kind is kind
    assert word in error.message
    assert isinstance(piece, Chunk)


def test_a_header_that_is_cut_is_unreadable_and_keeps_its_bytes() -> None:
    (event,) = serial_pieces(packet(_rtac(1)[:11], link_type=250))
    assert isinstance(event, WireEvent)
    assert (event.kind, event.raw) == (EventKind.UNREADABLE, _rtac(1)[:11])


@pytest.mark.parametrize(
    "whole", [packet(FRAME, link_type=147), packet(_rtac(2, FRAME), link_type=250)]
)
def test_a_packet_that_the_capture_cut_says_how_much_is_missing(whole: Packet) -> None:
    piece, event = serial_pieces(cut(whole, len(whole.data) - 3))
    assert isinstance(piece, Chunk)
    assert piece.data == FRAME[:-3]
    assert isinstance(event, WireEvent)
    assert (event.kind, event.missing) == (EventKind.CUT, 3)


def test_the_link_types_are_those_of_the_registry() -> None:
    # tcpdump.org/linktypes.html: USER0 to USER15, and RTAC_SERIAL.
    assert sorted(USER_LINK_TYPES) == [*range(147, 163)]
    assert sorted(SERIAL_LINK_TYPES) == [147, 250]


@given(
    data=st.binary(max_size=40),
    link_type=st.sampled_from(sorted(SERIAL_LINK_TYPES | USER_LINK_TYPES)),
)
def test_no_byte_disappears_whatever_is_in_a_packet(data: bytes, link_type: int) -> None:
    pieces = serial_pieces(packet(data, link_type=link_type))
    held = b"".join(one.data if isinstance(one, Chunk) else one.raw for one in pieces)
    assert held == (data[12:] if link_type == 250 and len(data) >= 12 else data)
