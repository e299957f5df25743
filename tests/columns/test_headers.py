from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.columns.headers import read_headers
from mbtool.columns.packet_block import _block_of
from tests.columns.both_ways import PORTS, as_arrays, differences
from tests.columns.test_equality import poll
from tests.packets.building import Talk, erspan, ethernet, in_fragments, ipv6, pcap, tcp, vxlan

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
    ],
    ids=["vlan", "two vlans", "three vlans", "cooked", "raw", "erspan", "vxlan", "padding", "loop"],
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


def test_a_segment_in_ipv6_is_apart_and_ends_no_stretch() -> None:
    packets = talk()
    segment = tcp(40_000, 502, 1, payload=b"\0")
    packets.insert(12, _with(packets[12], ethernet(ipv6(segment), kind=0x86DD)))
    headers = read_headers(_block_of(packets), PORTS)
    assert headers.apart.tolist() == [12]
    assert headers.hidden.tolist() == []
    assert differences(pcap(packets)) == []
    assert as_arrays(pcap(packets)).plain == 20


def test_a_packet_that_is_cut_anywhere_in_its_headers_gives_equal_results() -> None:
    for length in range(len(talk()[10].data)):
        packets = talk()
        packets[10] = replace(packets[10], data=packets[10].data[:length])
        assert differences(pcap(packets)) == [], length
