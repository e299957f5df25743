from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.packets.segment import (
    ACK,
    FIN,
    RST,
    SYN,
    TcpPlace,
    TcpSegment,
    find_tcp,
    read_segment,
)
from tests.packets.building import ethernet, ipv4, ipv6, tcp

if TYPE_CHECKING:
    from collections.abc import Callable

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


def test_a_claim_of_a_mebibyte_is_the_longest_that_is_read() -> None:
    longest = 40 + 1024 * 1024
    segment = _read(ipv4(_TCP, total=0), original_length=longest)
    assert segment is not None
    assert segment.missing == 1024 * 1024 - len(b"payload")
    assert _read(ipv4(_TCP, total=0), original_length=longest + 1) is None


_OPTIONS = "00 0104 00000000"
"""Behind the number of what follows: a length in units of 8 bytes beyond the first 8, options."""


@pytest.mark.parametrize(
    ("data", "start", "needed"),
    [
        (ipv4(_TCP), 20, 20),
        (ipv4(_TCP, options=bytes(40)), 60, 20),
        (ipv4(_TCP, fragment=0x4000), 20, 20),  # don't fragment
        (ipv4(_TCP, fragment=0x8000), 20, 20),  # the reserved flag
        (ipv6(_TCP), 40, 40),
        (ipv6(bytes.fromhex(f"06 {_OPTIONS}") + _TCP, following=0), 48, 48),
        (ipv6(bytes.fromhex(f"06 {_OPTIONS}") + _TCP, following=135), 48, 48),
        (ipv6(bytes.fromhex(f"06 {_OPTIONS}") + _TCP, following=139), 48, 48),
        (ipv6(bytes.fromhex(f"06 {_OPTIONS}") + _TCP, following=140), 48, 48),
        (ipv6(bytes.fromhex("06 02") + bytes(22) + _TCP, following=60), 64, 48),
        (ipv6(bytes.fromhex("06 00") + bytes(6) + _TCP, following=51), 48, 48),
        (ipv6(bytes.fromhex("06 01") + bytes(10) + _TCP, following=51), 52, 48),
        (ipv6(bytes.fromhex("06 00 0006 00000009") + _TCP, following=44), 48, 48),
        (ipv6(bytes.fromhex(f"2b {_OPTIONS} 06 {_OPTIONS}") + _TCP, following=60), 56, 56),
    ],
)
def test_tcp_is_found_as_soon_as_the_headers_before_it_are_there(
    data: bytes, start: int, needed: int
) -> None:
    for at in (0, 14):
        whole = bytes(at) + data
        for end in range(len(whole) + 1):
            place = find_tcp(whole[:end], at, len(whole))
            expected = TcpPlace(at + start, len(whole)) if end >= at + needed else None
            assert place == expected, end


def test_no_other_header_stands_before_tcp() -> None:
    data = bytes.fromhex(f"06 {_OPTIONS}") + _TCP
    read = [number for number in range(256) if _read(ipv6(data, following=number)) is not None]
    # RFC 8200 (0, 43, 44, 60), RFC 4302 (51), RFC 6275, RFC 7401 and RFC 5533 (135, 139, 140).
    assert read == [0, 43, 51, 60, 135, 139, 140]


def test_any_bit_of_a_place_makes_a_packet_of_ipv6_a_fragment() -> None:
    for bit in range(16):
        header = b"\x06\x00" + (1 << bit).to_bytes(2) + bytes(4)
        found = _read(ipv6(header + _TCP, following=44))
        assert (found is not None) == (bit in (1, 2)), bit  # The reserved bits.


def test_any_bit_of_a_place_makes_a_packet_of_ipv4_a_fragment() -> None:
    for bit in range(16):
        found = _read(ipv4(_TCP, fragment=1 << bit))
        assert (found is not None) == (bit >= 14), bit


@pytest.mark.parametrize("make", [ipv4, ipv6])
def test_a_packet_may_end_with_its_tcp_header_and_no_byte_sooner(
    make: Callable[[bytes], bytes],
) -> None:
    for words in range(16):
        header = _TCP[:12] + bytes([words << 4]) + _TCP[13:20] + bytes(40)
        for size in range(20, 61):
            segment = _read(make(header[:size]))
            is_whole = words >= 5 and size >= 4 * words
            assert (segment is not None) == is_whole, (words, size)
            if segment is not None:
                assert segment.payload == bytes(size - 4 * words)


def test_a_packet_that_ends_before_its_tcp_header_begins_holds_none() -> None:
    whole = ipv4(_TCP, total=20)
    assert find_tcp(whole, 0, len(whole)) == TcpPlace(20, 20)
    assert find_tcp(ipv4(_TCP, total=19), 0, len(whole)) is None
    # An extension header that is longer than its packet.
    options = bytes.fromhex("06 01 0104 00000000") + bytes(8)
    for claimed, found in ((16, TcpPlace(56, 56)), (15, None)):
        data = bytearray(ipv6(options + _TCP, following=0))
        data[4:6] = claimed.to_bytes(2)
        assert find_tcp(bytes(data), 0, len(data)) == found


def test_an_offloaded_packet_of_ipv6_reaches_to_the_end_of_the_frame() -> None:
    data = bytearray(ipv6(_TCP))
    data[4:6] = bytes(2)
    segment = _read(bytes(data))
    assert segment is not None
    assert segment.payload == b"payload"


def test_the_names_of_the_flags_are_their_bits_on_the_wire() -> None:
    # RFC 793, 3.1: from the right FIN, SYN, RST, PSH, ACK.
    assert (FIN, SYN, RST, ACK) == (0b00001, 0b00010, 0b00100, 0b10000)
