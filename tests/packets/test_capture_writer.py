"""The bytes of pcap and pcapng files, as the drafts of their formats have them."""

from __future__ import annotations

import io
import struct
from unittest.mock import patch

import pytest

from mbtool.core import Packet
from mbtool.packets.capture_writer import (
    CRC_ERROR,
    RECEIVED,
    SENT,
    InterfaceSettings,
    PcapngWriter,
    PcapWriter,
)

# draft-ietf-opsawg-pcapng, little-endian: type, length, magic, version 1.0, a section of unknown
# length, length.
_SECTION = bytes.fromhex("0a0d0d0a 1c000000 4d3c2b1a 0100 0000 ffffffffffffffff 1c000000")


def _packet(data: bytes, ts_ns: int = 0, link: str = "if0", link_type: int = 1) -> Packet:
    return Packet(ts_ns=ts_ns, link=link, link_type=link_type, data=data, original_length=1500)


def _blocks(file: bytes) -> list[tuple[int, bytes]]:
    """The type and the body of each block behind the section header."""
    assert file.startswith(_SECTION)
    at, blocks = len(_SECTION), []
    while at < len(file):
        kind, length = struct.unpack_from("<II", file, at)
        assert struct.unpack_from("<I", file, at + length - 4) == (length,)
        assert length % 4 == 0
        blocks.append((kind, file[at + 8 : at + length - 4]))
        at += length
    return blocks


def _written(*packets: Packet) -> list[tuple[int, bytes]]:
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    for packet in packets:
        writer.write(packet)
    return _blocks(stream.getvalue())


def test_a_pcap_file_has_a_header_and_a_record_for_each_packet() -> None:
    stream = io.BytesIO()
    writer = PcapWriter(stream, 228)
    writer.write(_packet(b"abc", 3_000_000_007))
    writer.write(_packet(b"", 0x1_FEDC_BA98 * 1_000_000_000))
    # Times in ns, version 2.4, zone, accuracy, snaplen 256 KiB, link type 228.
    assert stream.getvalue() == bytes.fromhex(
        "4d3cb2a1 0200 0400 00000000 00000000 00000400 e4000000"
        "03000000 07000000 03000000 dc050000 616263"
        "98badcfe 00000000 00000000 dc050000"
    )


def test_an_interface_is_described_before_its_first_packet() -> None:
    blocks = _written(_packet(b"abc", (7 << 32) + 9), _packet(b"abcd", 1, "com1", 250))
    assert blocks == [
        # Interface: link type, reserved, snaplen 0; options name, resolution (9), end.
        (1, bytes.fromhex("0100 0000 00000000  0200 0300 69663000  0900 0100 09000000  00000000")),
        # Packet: interface, time high, low, captured, original length; data, padded; no options.
        (6, bytes.fromhex("00000000 07000000 09000000 03000000 dc050000") + b"abc\0"),
        (1, bytes.fromhex("fa00 0000 00000000  0200 0400 636f6d31  0900 0100 09000000  00000000")),
        (6, bytes.fromhex("01000000 00000000 01000000 04000000 dc050000") + b"abcd"),
    ]


def test_an_interface_has_a_description_and_a_speed_if_they_are_known() -> None:
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    assert not writer.knows("a", 1)
    writer.add_interface("a", 1, InterfaceSettings("bus", 19200))
    writer.add_interface("b\ud800", 1, InterfaceSettings("\ud800"))
    writer.add_interface("c", 1, InterfaceSettings(speed=1))
    assert (writer.knows("a", 1), writer.knows("a", 2), writer.knows("d", 1)) == (
        True,
        False,
        False,
    )
    end = bytes.fromhex("0900 0100 09000000  00000000")
    before = bytes.fromhex("0100 0000 00000000")
    assert [body for _, body in _blocks(stream.getvalue())] == [
        before + b"\2\0\1\0a\0\0\0" + b"\3\0\3\0bus\0"
        + bytes.fromhex("0800 0800 004b000000000000") + end,
        before + b"\2\0\2\0b?\0\0" + b"\3\0\1\0?\0\0\0" + end,
        before + b"\2\0\1\0c\0\0\0" + bytes.fromhex("0800 0800 0100000000000000") + end,
    ]  # fmt: skip


def test_there_is_room_for_as_many_interfaces_as_a_reader_takes() -> None:
    with patch("mbtool.packets.capture_writer.MAX_INTERFACES", 2):
        writer = PcapngWriter(io.BytesIO())
        room = []
        for link in ("a", "b", "b"):
            room.append(writer.has_room)
            writer.write(_packet(b"", link=link))
    assert room == [True, True, False]


def test_comments_flags_and_local_options_stand_behind_the_data() -> None:
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    writer.write(
        _packet(b"abcde"), comments=["one", "\ud800"], flags=SENT | CRC_ERROR, local={0x8D62: b"{}"}
    )
    writer.write(_packet(b""), flags=RECEIVED)
    _, (_, first), (_, second) = _blocks(stream.getvalue())
    assert first[20:] == b"abcde\0\0\0" + (
        b"\1\0\3\0one\0" + b"\1\0\1\0?\0\0\0"  # comments
        + bytes.fromhex("0200 0400 02000001")  # flags: outbound, a wrong CRC
        + bytes.fromhex("628d 0200 7b7d0000  00000000")
    )  # fmt: skip
    assert second[20:] == bytes.fromhex("0200 0400 01000000  00000000")


@pytest.mark.parametrize(("size", "kept"), [(3999, 3999), (4000, 4000), (4001, 4000)])
def test_a_comment_has_at_most_4000_bytes(size: int, kept: int) -> None:
    stream = io.BytesIO()
    PcapngWriter(stream).write(_packet(b""), comments=["x" * size])
    (_, (_, body)) = _blocks(stream.getvalue())
    assert struct.unpack_from("<HH", body, 20) == (1, kept)
    assert body[24:].rstrip(b"\0") == b"x" * kept


def test_names_of_addresses_are_a_block_of_their_own() -> None:
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    writer.write_names({})
    writer.write_names({b"\x0a\0\0\1": "master", b"\x0a\0\1\7": "x"})
    assert _blocks(stream.getvalue()) == [
        (
            4,
            bytes.fromhex("0100 0b00 0a000001") + b"master\0\0"
            + bytes.fromhex("0100 0600 0a000107") + b"x\0\0\0" + bytes(4),
        )
    ]  # fmt: skip


@pytest.mark.parametrize("size", range(5))
def test_a_block_is_padded_to_four_bytes(size: int) -> None:
    stream = io.BytesIO()
    PcapngWriter(stream).write_block(0x80008D62, b"x" * size)
    assert _blocks(stream.getvalue()) == [(0x80008D62, b"x" * size + bytes(-size % 4))]
