from __future__ import annotations

import pytest

from mbtool.packets.segment import SYN, TcpSegment, find_tcp, read_segment
from tests.packets.building import ethernet, ipv4, ipv6, tcp

_TCP = tcp(49152, 502, 1000, 5000, payload=b"payload")


def _read(data: bytes, at: int = 0, original_length: int | None = None) -> TcpSegment | None:
    length = len(data) if original_length is None else original_length
    place = find_tcp(data, at, length)
    return None if place is None else read_segment(data, at, place, length)


def test_reads_a_segment_from_ipv4() -> None:
    assert _read(ipv4(_TCP)) == TcpSegment(
        source=bytes([10, 0, 0, 1]),
        source_port=49152,
        destination=bytes([10, 0, 0, 2]),
        destination_port=502,
        sequence=1000,
        acknowledgement=5000,
        flags=0x10,
        payload=b"payload",
        missing=0,
    )


def test_reads_a_segment_from_ipv6() -> None:
    segment = _read(ipv6(_TCP))

    assert segment is not None
    assert segment.source == bytes.fromhex("fd00 0000 0000 0000 0000 0000 0000 0001")
    assert segment.destination == bytes.fromhex("fd00 0000 0000 0000 0000 0000 0000 0002")
    assert (segment.destination_port, segment.payload) == (502, b"payload")


def test_passes_over_options_of_both_headers() -> None:
    data = ipv4(tcp(1, 502, 0, flags=SYN, payload=b"abc", options=bytes(12)), options=bytes(8))

    segment = _read(data)

    assert segment is not None
    assert (segment.destination_port, segment.payload) == (502, b"abc")


def test_padding_of_the_frame_is_no_payload() -> None:
    segment = _read(ethernet(ipv4(tcp(1, 502, 0))), 14)

    assert segment is not None
    assert (segment.payload, segment.missing) == (b"", 0)


@pytest.mark.parametrize(
    ("kind", "header"),
    [
        (0, "06 00 0104 00000000"),  # hop-by-hop options
        (60, "06 01 0104 00000000 0000000000000000"),  # destination options, 16 bytes
        (43, "06 00 00 00 00000000"),  # routing
        (44, "06 00 0000 00000001"),  # an atomic fragment
        (51, "06 04 0000 00000001 00000001 000000000000000000000000"),  # authentication, 24 bytes
        (0, "3c 00 0104 00000000  06 00 0104 00000000"),  # two, one after another
    ],
)
def test_passes_over_extension_headers(kind: int, header: str) -> None:
    segment = _read(ipv6(bytes.fromhex(header) + _TCP, following=kind))

    assert segment is not None
    assert segment.payload == b"payload"


def test_an_offloaded_packet_reaches_to_the_end_of_the_frame() -> None:
    segment = _read(ipv4(_TCP, total=0))

    assert segment is not None
    assert segment.payload == b"payload"


def test_counts_the_bytes_that_the_capture_cut_off() -> None:
    whole = ipv4(_TCP)

    segment = _read(whole[:-3], original_length=len(whole))

    assert segment is not None
    assert (segment.payload, segment.missing) == (b"payl", 3)


def test_does_not_believe_a_packet_longer_than_its_frame() -> None:
    segment = _read(ipv4(_TCP, total=4000))

    assert segment is not None
    assert (segment.payload, segment.missing) == (b"payload", 0)


@pytest.mark.parametrize(
    "data",
    [
        ipv4(_TCP, protocol=17),
        ipv4(_TCP, fragment=0x00B9),  # not the first fragment
        ipv4(_TCP, fragment=0x2000),  # the first of several
        b"\x44" + ipv4(_TCP)[1:],  # a header of 16 bytes
        b"\x55" + ipv4(_TCP)[1:],  # version 5
        ipv4(_TCP, total=19),  # ends in its own header
        ipv4(_TCP, total=39),  # ends in the TCP header
        ipv4(_TCP[:12] + b"\x40" + _TCP[13:]),  # a TCP header of 16 bytes
        ipv4(_TCP[:12] + b"\xf0" + _TCP[13:]),  # a TCP header of 60 bytes
        ipv6(_TCP, following=17),
        ipv6(_TCP, following=59),  # no next header
        ipv6(bytes.fromhex("06 00 0008 00000001") + _TCP, following=44),
        ipv6(bytes.fromhex("06 00 0001 00000001") + _TCP, following=44),
        ipv6(bytes.fromhex("06 ff 0104 00000000") + _TCP, following=0),
    ],
)
def test_ignores_packets_without_a_tcp_segment(data: bytes) -> None:
    assert _read(data) is None


def test_a_claim_of_more_than_any_card_hands_over_is_malformed() -> None:
    assert _read(ipv4(_TCP, total=0), original_length=2**32 - 1) is None
