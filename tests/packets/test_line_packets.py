"""Packets that show frames of serial lines, and the writers of pcap and pcapng."""

from __future__ import annotations

import io
import struct

import msgspec
import pytest

from mbtool.core import Chunk, Direction, Packet
from mbtool.packets import CaptureHead, LinePacket, read_capture, reads_of
from mbtool.packets.capture_writer import PcapngWriter, PcapWriter
from mbtool.packets.line_packets import (
    LOCAL_BLOCK,
    LOCAL_OPTION,
    RAW_IPV4,
    LineEnds,
    OpenReads,
    WireReads,
    line_datagram,
    rtac_packet,
    with_mbap,
)

# Compared with what tshark 4.0.17 shows as a query with transaction 1, unit 1, function 6.
REQUEST = bytes.fromhex(
    "45 00 00 2a 00 01 40 00 40 11 25 c1 0a 00 00 01 0a 00 01 01"  # IPv4
    "50 16 01 f6 00 16 00 00"  # UDP
    "00 01 00 00 00 06 01"  # MBAP
    "06 00 00 12 34"  # write single register
    "84 bd"  # CRC
)


def _packet(number: int, link: str = "eth0", link_type: int = 1) -> Packet:
    return Packet(
        ts_ns=1_700_000_000_123_456_789 + number,
        link=link,
        link_type=link_type,
        data=bytes(range(number)),
        original_length=number + 5,
    )


def _read(data: bytes) -> list[Packet]:
    return list(read_capture(io.BytesIO(data)))


def test_a_request_of_a_serial_line_is_a_datagram_to_port_502() -> None:
    payload = with_mbap(1, bytes.fromhex("01 06 00 00 12 34"), bytes.fromhex("84 bd"))
    assert line_datagram(LineEnds.of(1, 1), 1, payload, is_request=True) == REQUEST


def test_a_response_has_the_ends_of_its_request_swapped() -> None:
    payload = REQUEST[28:]
    response = line_datagram(LineEnds.of(1, 1), 1, payload, is_request=False)
    assert (response[12:16], response[16:20]) == (REQUEST[16:20], REQUEST[12:16])
    assert (response[20:22], response[22:24]) == (REQUEST[22:24], REQUEST[20:22])
    assert response[28:] == payload


@pytest.mark.parametrize("number", [1, 0xFFFF, 0x1_0000, 0x1_2345])
@pytest.mark.parametrize("size", [0, 1, 260])
def test_the_checksum_of_the_ip_header_holds(number: int, size: int) -> None:
    packet = line_datagram(LineEnds.of(255, 247), number, bytes(size), is_request=True)
    total = sum(struct.unpack(">10H", packet[:20]))
    assert (total & 0xFFFF) + (total >> 16) == 0xFFFF
    assert struct.unpack(">H", packet[2:4]) == (len(packet),)
    assert struct.unpack(">H", packet[4:6]) == (number & 0xFFFF,)


def test_packets_in_pcap_come_back_as_they_were() -> None:
    packets = [_packet(number, link="if0") for number in range(5)]
    stream = io.BytesIO()
    writer = PcapWriter(stream, 1)
    for packet in packets:
        writer.write(packet)
    assert _read(stream.getvalue()) == packets


def test_packets_in_pcapng_come_back_as_they_were() -> None:
    packets = [_packet(n, link, kind) for n in range(5) for link in ("a", "b") for kind in (1, 113)]
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    writer.write_names({bytes((10, 0, 0, 1)): "master.line"})
    for number, packet in enumerate(packets):
        writer.write(packet, comments=["one", "two"][:number], flags=number % 3)
    assert _read(stream.getvalue()) == packets


def _line_file(*packets: tuple[int, bytes, WireReads | bytes]) -> bytes:
    """A capture with a head and packets of a link type, with their marks."""
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    writer.write_block(LOCAL_BLOCK, msgspec.json.encode(CaptureHead(links={"line": {}})))
    for link_type, data, mark in packets:
        packet = Packet(
            ts_ns=9, link="line", link_type=link_type, data=data, original_length=len(data)
        )
        text = mark if isinstance(mark, bytes) else msgspec.json.encode(mark)
        writer.write(packet, local={LOCAL_OPTION: text})
    return stream.getvalue()


def _chunks(data: bytes) -> list[Chunk]:
    return [one for one in reads_of(_read(data)) if isinstance(one, Chunk)]


def test_the_reads_of_a_frame_come_back_with_their_times() -> None:
    data = _line_file((RAW_IPV4, REQUEST, WireReads(reads=[(3, 100), (5, 250)], skip=6)))
    assert _chunks(data) == [
        Chunk(ts_ns=100, link="line", data=bytes.fromhex("01 06 00")),
        Chunk(ts_ns=250, link="line", data=bytes.fromhex("00 12 34 84 bd")),
    ]


def test_a_read_that_brought_two_frames_is_one_read_again() -> None:
    data = _line_file(
        (RAW_IPV4, REQUEST, WireReads(reads=[(8, 100)], skip=6, is_open=True)),
        (250, rtac_packet(100, b"\xff", by_master=False), WireReads(reads=[(1, 100)])),
    )
    assert _chunks(data) == [
        Chunk(ts_ns=100, link="line", data=bytes.fromhex("01 06 00 00 12 34 84 bd ff"))
    ]


def test_a_read_whose_rest_is_missing_comes_at_the_end() -> None:
    data = _line_file((RAW_IPV4, REQUEST, WireReads(reads=[(8, 100)], skip=6, is_open=True)))
    assert [one.data for one in _chunks(data)] == [REQUEST[34:]]


def test_two_sides_of_a_tap_are_joined_apart() -> None:
    reads = OpenReads()
    request = Chunk(ts_ns=0, link="x", data=b"", direction=Direction.REQUEST)
    response = Chunk(ts_ns=0, link="x", data=b"", direction=Direction.RESPONSE)
    assert reads.take(request, b"ab", [(2, 5)], is_open=True) == []
    assert [one.data for one in reads.take(response, b"cd", [(2, 5)], is_open=False)] == [b"cd"]
    assert [one.data for one in reads.take(request, b"e", [(1, 5)], is_open=False)] == [b"abe"]
    assert reads.close() == []


@pytest.mark.parametrize(
    "mark",
    [
        b"",
        b"\xff",
        b"[]",
        b'{"reads":[["a",1]]}',
        b'{"reads":[[-5,-9],[9999,99999999999999999999]],"skip":-3}',
        b'{"reads":[[4,5]],"skip":99,"is_open":true}',
        b'{"reads":[[4,5]],"raw":"!"}',
        b'{"x":' + b"[" * 60_000,
    ],
)
def test_no_mark_makes_the_reader_raise(mark: bytes) -> None:
    (packet, *_) = _read(_line_file((RAW_IPV4, REQUEST, mark)))
    assert packet.data == REQUEST


@pytest.mark.parametrize(
    "head", [b"", b"\xff\xff", b"[1]", b'{"links":7}', b'{"x":' + b"[" * 60_000]
)
def test_a_block_that_is_no_head_is_skipped(head: bytes) -> None:
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    writer.write_block(LOCAL_BLOCK, head)
    writer.write(_packet(3))
    (packet,) = _read(stream.getvalue())
    assert not isinstance(packet, LinePacket)
    assert packet == _packet(3)


def test_open_reads_hold_no_more_than_a_packet() -> None:
    reads = OpenReads()
    like = Chunk(ts_ns=0, link="x", data=b"")
    given = 0
    for _ in range(20):
        data = bytes(64 * 1024)
        done = reads.take(like, data, [(len(data), 5)], is_open=True)
        given += sum(len(one.data) for one in done)
    assert given >= 16 * 64 * 1024
