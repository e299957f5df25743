"""Packets that show frames of serial lines, and the writers of pcap and pcapng."""

from __future__ import annotations

import io
import struct

import msgspec
import pytest

from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    EventKind,
    Origin,
    Packet,
    Stamp,
    StreamPlace,
    WireEvent,
)
from mbtool.packets import CaptureHead, LinePacket, read_capture, reads_of
from mbtool.packets.capture_writer import PcapngWriter, PcapWriter
from mbtool.packets.line_packets import (
    LOCAL_BLOCK,
    LOCAL_OPTION,
    RAW_IPV4,
    LineEnds,
    OpenReads,
    WireReads,
    error_packet,
    line_datagram,
    rtac_packet,
    serial_pieces,
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


def test_the_checksum_holds_for_every_number_of_a_packet() -> None:
    for number in range(0x10000):
        header = line_datagram(LineEnds.of(255, 247), number, b"", is_request=True)[:20]
        assert int.from_bytes(header) % 0xFFFF == 0, number  # A sum of words with its carries.


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


def test_each_link_has_a_network_and_each_unit_an_address() -> None:
    ends = LineEnds.of(3, 17)
    assert (ends.master, ends.slave) == (bytes((10, 0, 0, 3)), bytes((10, 0, 3, 17)))
    assert ends.master_port == 20502
    assert LineEnds.of(255, 247, 20503) == LineEnds(b"\x0a\0\0\xff", b"\x0a\0\xff\xf7", 20503)
    packet = line_datagram(LineEnds.of(1, 1, 0x1234), 0, b"", is_request=True)
    assert struct.unpack(">HHHH", packet[20:]) == (0x1234, 502, 8, 0)


@pytest.mark.parametrize("number", [0, 0x1234, 0xFFFF, 0x1_2345])
def test_a_serial_frame_gets_the_header_of_modbus_tcp(number: int) -> None:
    header = (number & 0xFFFF).to_bytes(2) + b"\0\0\0\3"
    assert with_mbap(number, b"abc", b"de") == header + b"abcde"


def test_bytes_of_a_line_get_the_header_of_rtac_serial() -> None:
    # Seconds, microseconds, data sent or received, control lines, footer.
    assert rtac_packet(7_000_008_999, b"abc", by_master=True) == (
        bytes.fromhex("00000007 00000008 01 00 0000") + b"abc"
    )
    late = 0x1_FEDC_BA98 * 1_000_000_000 + 999_999_999
    assert rtac_packet(late, b"", by_master=False) == bytes.fromhex("fedcba98 000f423f 02 00 0000")


def _take(*takes: tuple[bytes, list[tuple[int, int]], bool]) -> list[list[tuple[int, bytes]]]:
    """The time and the bytes of the reads that each packet completes, and of those at the end."""
    reads = OpenReads()
    like = Chunk(ts_ns=0, link="x", data=b"")
    found = [reads.take(like, data, sizes, is_open=is_open) for data, sizes, is_open in takes]
    return [[(one.ts_ns, one.data) for one in chunks] for chunks in (*found, reads.close())]


def test_a_read_goes_on_in_the_next_packet_if_it_is_of_the_same_time() -> None:
    assert _take((b"abc", [(1, 5), (2, 6)], True), (b"de", [(1, 6), (1, 7)], False)) == [
        [(5, b"a")], [(6, b"bcd"), (7, b"e")], [],
    ]  # fmt: skip
    assert _take((b"ab", [(2, 6)], True), (b"c", [(1, 7)], False)) == [
        [], [(6, b"ab"), (7, b"c")], [],
    ]  # fmt: skip
    assert _take((b"ab", [(2, 6)], True), (b"c", [(1, 6)], True)) == [[], [], [(6, b"abc")]]
    assert _take((b"ab", [(2, 6)], False), (b"c", [(1, 6)], False)) == [
        [(6, b"ab")],
        [(6, b"c")],
        [],
    ]
    assert _take((b"ab", [], True), (b"c", [(1, 6)], False)) == [[], [(6, b"c")], []]


def test_numbers_of_a_read_out_of_their_range_are_moved_into_it() -> None:
    assert _take((b"abc", [(-1, 3), (0, 4), (1, -5), (9, 2**64)], False)) == [
        [(0, b"a"), (2**63 - 1, b"bc")], [],
    ]  # fmt: skip


def test_a_read_of_the_size_of_the_longest_packet_is_not_kept_open() -> None:
    most = 256 * 1024
    for size, is_kept in ((most - 1, True), (most, False)):
        (done, rest) = _take((bytes(size), [(size, 5)], True))
        assert (len(done), len(rest)) == ((0, 1) if is_kept else (1, 0))


def test_reads_of_different_links_directions_and_connections_are_joined_apart() -> None:
    connection = Connection(Endpoint("10.0.0.1", 5000), Endpoint("10.0.0.2", 502))
    likes = [
        Chunk(ts_ns=0, link="x", data=b""),
        Chunk(ts_ns=0, link="y", data=b""),
        Chunk(ts_ns=0, link="x", data=b"", direction=Direction.REQUEST),
        Chunk(ts_ns=0, link="x", data=b"", connection=connection),
    ]
    reads = OpenReads()
    for number, like in enumerate(likes):
        assert reads.take(like, b"%d" % number, [(1, 5)], is_open=True) == []
    assert [one.data for one in reads.close()] == [b"0", b"1", b"2", b"3"]
    assert reads.close() == []


def test_a_mark_says_all_that_the_packet_does_not() -> None:
    connection = Connection(Endpoint("10.0.0.1", 5000), Endpoint("10.0.0.2", 502))
    mark = WireReads(
        reads=[(3, 7)], raw=b":01", direction=Direction.RESPONSE, stamp=Stamp.AT_ONCE,
        connection=connection,
    )  # fmt: skip
    plain = WireReads(reads=[(99, 8)], skip=-1)
    first, second = _chunks(_line_file((RAW_IPV4, REQUEST, mark), (250, bytes(12) + b"ab", plain)))
    assert (first.data, first.ts_ns, first.link) == (b":01", 7, "line")
    assert (first.direction, first.stamp) == (Direction.RESPONSE, Stamp.AT_ONCE)
    assert (first.connection, first.place) == (connection, None)
    assert (second.data, second.direction, second.stamp) == (
        b"ab", Direction.UNKNOWN, Stamp.LAST_BYTE,
    )  # fmt: skip
    assert (second.connection, second.place) == (None, StreamPlace(0, None, Origin("capture", 2)))


def test_a_packet_with_a_mark_is_otherwise_as_others() -> None:
    mark = WireReads(reads=[(8, 100)], skip=6, is_open=True)
    (packet, rest) = _read(_line_file((RAW_IPV4, REQUEST, mark)))
    assert isinstance(packet, LinePacket)
    assert isinstance(rest, LinePacket)
    assert packet.chunks == ()
    assert [one.data for one in rest.chunks] == [REQUEST[34:]]
    assert packet == rest
    assert (packet.data, packet.ts_ns, packet.link, packet.link_type) == (REQUEST, 9, "line", 228)
    assert (packet.number, packet.file, packet.original_length) == (1, "capture", len(REQUEST))


def test_a_packet_without_a_mark_is_given_as_it_is() -> None:
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    writer.write_block(LOCAL_BLOCK, msgspec.json.encode(CaptureHead()))
    writer.write(_packet(3))
    assert [*reads_of(_read(stream.getvalue()))] == [_packet(3)]


def test_each_head_is_given_and_the_reads_stay_open_over_it() -> None:
    stream = io.BytesIO()
    writer = PcapngWriter(stream)
    given = [
        CaptureHead(links={"a": {"link": "rtu@19200-8E1"}}, devices={"a:1": "fa3"}),
        CaptureHead(capture={"tool": "x"}, profiles={"fa3": b"{}"}),
    ]
    marks = [WireReads(reads=[(2, 5)], is_open=True), WireReads(reads=[(1, 5)])]
    for head, mark in zip(given, marks, strict=True):
        writer.write_block(LOCAL_BLOCK, msgspec.json.encode(head))
        packet = Packet(
            ts_ns=0, link="a", link_type=250, data=bytes(12) + b"ab", original_length=14
        )
        writer.write(packet, local={LOCAL_OPTION: msgspec.json.encode(mark)})
    stream.seek(0)
    heads: list[CaptureHead] = []
    packets = [*read_capture(stream, "x", heads.append)]
    assert heads == given
    assert [one.data for one in reads_of(packets) if isinstance(one, Chunk)] == [b"aba"]


def test_reads_of_a_section_do_not_need_a_head_of_their_own() -> None:
    mark = WireReads(reads=[(1, 5)])
    file = _line_file((250, bytes(12) + b"a", mark))
    assert [one.data for one in _chunks(file + file)] == [b"a", b"a"]


@pytest.mark.parametrize(
    ("message", "read"),
    [
        ("a framing error", "a framing error"),
        ("12 bytes with a parity error", "a parity error"),
        ("parity or framing error at byte 41H", None),
        ("the driver counts 3 parity errors, 1 framing error", None),
        ("2 bytes lost", None),
    ],
)
def test_only_an_event_of_one_error_becomes_a_packet(message: str, read: str | None) -> None:
    event = WireEvent(ts_ns=5, link="a", kind=EventKind.LINE_ERROR, message=message)
    packet = error_packet(event)
    pieces = [] if packet is None else serial_pieces(packet)
    assert [one.message for one in pieces if isinstance(one, WireEvent)] == [read][
        : read is not None
    ]
