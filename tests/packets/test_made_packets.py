"""Packets that are made of bytes of a network."""

from __future__ import annotations

from ipaddress import ip_address

import pytest

from mbtool.core import Connection, Direction, Endpoint
from mbtool.packets.made_packets import PacketMaker, internet_checksum
from mbtool.packets.segment import find_tcp, read_segment

ENDS = [("10.0.0.1", "10.0.0.2"), ("fd00::1", "fd00::2")]
EXAMPLE = bytes.fromhex("0001 f203 f4f5 f6f7")


def connection(master: str, slave: str, *, is_udp: bool = False) -> Connection:
    return Connection(Endpoint(master, 50000), Endpoint(slave, 502), is_udp=is_udp)


def test_the_checksum_is_that_of_the_example_of_the_standard() -> None:
    assert internet_checksum(EXAMPLE) == 0xFFFF - 0xDDF2  # RFC 1071, section 3


@pytest.mark.parametrize(("master", "slave"), ENDS)
def test_numbers_of_a_connection_go_on_in_both_directions(master: str, slave: str) -> None:
    maker, ends = PacketMaker(), connection(master, slave)
    found = []
    for direction, data in (
        (Direction.REQUEST, b"ask"), (Direction.RESPONSE, b"answer"), (Direction.REQUEST, b"more"),
    ):  # fmt: skip
        packet = maker.packet(ends, direction, data, 7)
        place = find_tcp(packet.data, 0, packet.original_length)
        assert place is not None
        segment = read_segment(packet.data, 0, place, packet.original_length)
        assert segment is not None
        assert (packet.ts_ns, bytes(segment.payload)) == (7, data)
        found.append((segment.source_port, segment.sequence, segment.acknowledgement))
        assert (
            segment.source
            == ip_address(slave if direction is Direction.RESPONSE else master).packed
        )
    assert found == [(50000, 1, 1), (502, 1, 4), (50000, 4, 7)]


@pytest.mark.parametrize(("master", "slave"), ENDS)
@pytest.mark.parametrize("is_udp", [False, True])
def test_checksums_are_right(master: str, slave: str, *, is_udp: bool) -> None:
    ends = connection(master, slave, is_udp=is_udp)
    data = PacketMaker().packet(ends, Direction.REQUEST, b"odd", 0).data
    begin = 20 if len(ip_address(master).packed) == 4 else 40
    if begin == 20:
        assert internet_checksum(data[:20]) == 0
    addresses = data[begin - 2 * len(ip_address(master).packed) : begin]
    pseudo = addresses + (len(data) - begin).to_bytes(4) + (17 if is_udp else 6).to_bytes(4)
    assert internet_checksum(pseudo + data[begin:]) == 0


@pytest.mark.parametrize(
    ("master", "slave", "size"),
    [
        ("10.0.0.1", "plc.example", 1),
        ("10.0.0.1", "fd00::2", 1),
        ("10.0.0.1", "10.0.0.2", 0xFFFF - 39),
        ("10.0.0.1", "10.0.0.2", 1 << 16),
    ],
)
@pytest.mark.parametrize("is_udp", [False, True])
def test_what_makes_no_packet_is_refused(
    master: str, slave: str, size: int, *, is_udp: bool
) -> None:
    ends = connection(master, slave, is_udp=is_udp)
    with pytest.raises(ValueError, match=r"plc\.example|IPv6|do not fit"):
        PacketMaker().packet(ends, Direction.REQUEST, bytes(size), 0)


@pytest.mark.parametrize("is_udp", [False, True])
def test_the_largest_packet_is_made(*, is_udp: bool) -> None:
    ends = connection("10.0.0.1", "10.0.0.2", is_udp=is_udp)
    made = PacketMaker().packet(ends, Direction.REQUEST, bytes(0xFFFF - 40), 0)
    assert len(made.data) <= 0xFFFF
