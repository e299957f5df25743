from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from tests.columns.both_ways import as_arrays, differences
from tests.columns.test_equality import poll
from tests.packets.building import Talk, erspan, in_fragments, pcap, vxlan

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import Packet

VLAN = bytes.fromhex("8100 0005")
Change = "Callable[[Packet], Packet]"


def talk() -> list[Packet]:
    one = Talk()
    return [*one.handshake(), *poll(one, 20), *one.goodbye()]


def tagged(packet: Packet, tags: bytes = VLAN) -> Packet:
    return _with(packet, packet.data[:12] + tags + packet.data[12:])


def cooked(packet: Packet) -> Packet:
    header = bytes.fromhex("0000 0001 0006 0a0b0c0d0e0f 0000 0800")
    return replace(_with(packet, header + packet.data[14:]), link_type=113)


def raw(packet: Packet) -> Packet:
    return replace(_with(packet, packet.data[14:]), link_type=101)


def in_ipv6(packet: Packet) -> Packet:
    """The same segment between two addresses of IPv6."""
    source, target = (bytes(12) + packet.data[at : at + 4] for at in (26, 30))
    end = 14 + int.from_bytes(packet.data[16:18], "big")
    header = struct.pack(">IHBB", 6 << 28, end - 34, 6, 64) + source + target
    return _with(packet, packet.data[:12] + b"\x86\xdd" + header + packet.data[34:end])


def in_family(packet: Packet, family: bytes) -> Packet:
    return _with(packet, family + packet.data[14:])


def _with(packet: Packet, data: bytes) -> Packet:
    return replace(packet, data=data, original_length=len(data))


@pytest.mark.parametrize(
    ("change", "plain"),
    [
        (tagged, 20),
        (lambda one: tagged(one, VLAN * 2), 20),
        (lambda one: tagged(one, VLAN * 3), 0),
        (cooked, 20),
        (raw, 20),
        (lambda one: _with(one, erspan(one.data)), 0),
        (lambda one: _with(one, vxlan(one.data)), 0),
        (lambda one: _with(one, one.data + b"padding"), 20),
        (lambda one: replace(one, link_type=108), 0),
        (lambda one: replace(in_family(one, b"\0\0\0\2"), link_type=108), 20),
        (lambda one: replace(in_family(one, b"\2\0\0\0"), link_type=0), 20),
        (lambda one: replace(in_family(one, b"\0\0\0\3"), link_type=108), 0),
        (lambda one: in_ipv6(one), 20),
        (lambda one: tagged(in_ipv6(one)), 20),
        (
            lambda one: replace(_with(one, b"\0\0\0\x1e" + in_ipv6(one).data[14:]), link_type=108),
            20,
        ),
    ],
    ids=[
        *("vlan", "two vlans", "three vlans", "cooked", "raw", "erspan", "vxlan", "padding"),
        *("no family", "loop", "null", "other family", "ipv6", "ipv6 vlan", "ipv6 loop"),
    ],
)
def test_headers_are_read_as_arrays_or_left_to_the_decoder(
    change: Callable[[Packet], Packet], plain: int
) -> None:
    capture = pcap([change(one) for one in talk()])
    assert differences(capture) == []
    assert as_arrays(capture).plain == plain


def test_no_stretch_goes_over_a_fragment() -> None:
    packets = talk()
    packets[12:13] = in_fragments(packets[12], 24)
    assert differences(pcap(packets)) == []
    assert 10 < as_arrays(pcap(packets)).plain < 19


def test_connections_of_ipv4_and_ipv6_are_told_apart() -> None:
    one = Talk()
    other = Talk()
    packets = [*one.handshake(), *poll(one, 20)]
    sixes = [in_ipv6(each) for each in [*other.handshake(), *poll(other, 20)]]
    both = [each for pair in zip(packets, sixes, strict=True) for each in pair]
    assert differences(pcap(both)) == []
    assert as_arrays(pcap(both)).plain == 38


def test_masters_with_the_port_of_the_slave_give_equal_results_in_ipv6() -> None:
    one = Talk()
    one.master.port = 502
    packets = [in_ipv6(each) for each in [*one.handshake(), *poll(one, 20)]]
    other = Talk(ts_ns=1_000_000_000)
    packets += [in_ipv6(each) for each in [*other.handshake(), *poll(other, 20)]]
    assert differences(pcap(packets)) == []
    assert as_arrays(pcap(packets)).plain == 19


@pytest.mark.parametrize("place", [4, 5, 6])
@pytest.mark.parametrize("value", [0, 1, 6, 17, 44, 58, 255])
def test_an_ipv6_header_with_another_length_or_protocol_gives_equal_results(
    place: int, value: int
) -> None:
    packets = [in_ipv6(each) for each in talk()]
    data = bytearray(packets[12].data)
    data[14 + place] = value
    packets[12] = replace(packets[12], data=bytes(data))
    assert differences(pcap(packets)) == []


@pytest.mark.parametrize("change", [lambda one: one, in_ipv6], ids=["ipv4", "ipv6"])
def test_a_packet_that_is_cut_anywhere_in_its_headers_gives_equal_results(
    change: Callable[[Packet], Packet],
) -> None:
    for length in range(len(change(talk()[10]).data)):
        packets = [change(one) for one in talk()]
        packets[10] = replace(packets[10], data=packets[10].data[:length])
        assert differences(pcap(packets)) == [], length
