"""Packets inside packets, as mirror ports send them over a network."""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import combinations, product
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind
from mbtool.packets.link_layer import NOT_IP
from mbtool.packets.segment import BEFORE_TCP
from mbtool.packets.stream_events import StreamOpened
from mbtool.packets.tunnels import GRE_IN_FRAGMENTS, MAX_TUNNELS, find_inner
from tests.packets.building import (
    ERSPAN_II,
    Talk,
    erspan,
    ethernet,
    gre,
    in_fragments,
    ipv4,
    ipv6,
    packet,
    tcp,
    vxlan,
)
from tests.packets.reading import run_packets, wire_events, words_of

if TYPE_CHECKING:
    from collections.abc import Callable

INNER = ipv4(tcp(50000, 502, 1, payload=b"inner"), "192.168.3.1", "192.168.3.250")
FRAME = ethernet(INNER)
TAGGED = ethernet(INNER, tags=bytes.fromhex("8100 0001"))
ERSPAN_III = bytes.fromhex("0000002a  2001 0001 12345678 0000 0000")
AS_IP = bytes.fromhex("2001 0001 12345678 0000 0800")  # frame type 2
WITH_SUBHEADER = bytes.fromhex("2001 0001 12345678 0000 0001  a1a2a3a4a5a6a7a8")


@pytest.mark.parametrize(
    "outer",
    [
        gre(FRAME, 0x88BE, ERSPAN_II, flags=0x1000),
        gre(TAGGED, 0x88BE, ERSPAN_II, flags=0x1000),
        gre(FRAME, 0x88BE),  # type I
        gre(FRAME, 0x22EB, ERSPAN_III, flags=0x1000),
        gre(INNER, 0x22EB, AS_IP),
        gre(FRAME, 0x22EB, WITH_SUBHEADER),
        gre(FRAME, 0x6558, bytes(12), flags=0xB000),
        gre(INNER, 0x0800),
        gre(FRAME, 0x6558, bytes(4), flags=0x2000),
        ipv4(INNER, protocol=4),
        ipv4(INNER, protocol=4, options=bytes(8)),
        ipv6(INNER, following=4),
        vxlan(FRAME)[14:],
    ],
    ids=[
        *("ERSPAN II", "ERSPAN II of a VLAN", "ERSPAN I", "ERSPAN III", "ERSPAN III of IP"),
        *("ERSPAN III with a subheader", "GRE with all fields", "GRE of IP", "GRE with a key"),
        *("IP in IP", "IP in IP with options", "IP in IPv6", "VXLAN"),
    ],
)
def test_finds_the_packet_inside(outer: bytes) -> None:
    at = find_inner(outer, 0, len(outer))
    assert outer[at : at + len(INNER)] == INNER


@pytest.mark.parametrize(
    "outer",
    [
        INNER,
        gre(FRAME, 0x880B),  # PPP
        gre(INNER, 0x0800, flags=0x4000),  # routing
        gre(INNER, 0x0800, flags=1),  # version 1
        gre(b"", 0x88BE),
        gre(bytes(11), 0x22EB),
        ipv4(INNER, protocol=4, fragment=0x2000),
        b"\x44" + ipv4(INNER, protocol=4)[1:],
        ipv4(b"\0" * 8 + bytes(8) + FRAME, protocol=17),
        ipv4(b"", protocol=47),
        b"\x45",
        b"",
    ],
    ids=[
        *("none", "PPP", "routing", "version", "cut", "cut in ERSPAN III", "a fragment"),
        *("a header that is too short", "other UDP", "no GRE", "a byte", "nothing"),
    ],
)
def test_other_packets_have_no_inner_packet(outer: bytes) -> None:
    assert find_inner(outer, 0, len(outer)) == NOT_IP


@pytest.mark.parametrize("wrap", [erspan, vxlan])
def test_a_mirrored_connection_is_followed_even_if_it_was_fragmented(
    wrap: Callable[[bytes], bytes],
) -> None:
    talk = Talk()
    said = [
        *talk.handshake(),
        talk.request(b"request"),
        *in_fragments(talk.response(b"the whole response"), 24, 8),
    ]
    mirrored = [replace(each, data=wrap(each.data)) for each in said]
    mirrored = [replace(each, original_length=len(each.data)) for each in mirrored]
    items = run_packets(mirrored)
    assert words_of(items) == [">request", "<the whole response"]
    (opened,) = [item for item in items if isinstance(item, StreamOpened)]
    assert not opened.joined


def test_fragments_of_a_tunnel_are_one_event_for_each_interface() -> None:
    talk = Talk()
    whole = [*talk.handshake(), talk.request(b"request")]
    mirrored = [replace(each, data=erspan(each.data)) for each in whole]
    parts = [part for each in mirrored for part in in_fragments(each, 48)]
    items = run_packets([*parts, *(replace(part, link="if1") for part in parts)])
    assert [(event.kind, event.link) for event in wire_events(items)] == [
        (EventKind.UNREADABLE, "if0"),
        (EventKind.UNREADABLE, "if1"),
    ]


def test_tunnels_in_tunnels_are_read_up_to_a_limit() -> None:
    data = tcp(50000, 502, 1, payload=b"deep")
    for _ in range(MAX_TUNNELS):
        data = ipv4(data, protocol=4 if data[0] >> 4 == 4 else 6)
    assert words_of(run_packets([packet(ethernet(data))])) == [">deep"]
    data = ipv4(ipv4(data, protocol=4), protocol=4)
    assert words_of(run_packets([packet(ethernet(data))])) == []


_FIELDS = {0x8000: 4, 0x2000: 4, 0x1000: 4}
"""The flags of GRE that announce a field, a checksum, a key and a sequence number, and its size."""
_FLAGS = [sum(some) for count in range(4) for some in combinations(_FIELDS, count)]
_RESERVED = 0x0FF8


@pytest.mark.parametrize("protocol", [0x0800, 0x86DD, 0x6558, 0x88BE, 0x22EB], ids="{:04X}".format)
@pytest.mark.parametrize("flags", _FLAGS, ids="{:04X}".format)
def test_every_field_of_gre_is_passed_over_and_every_cut_is_noticed(
    flags: int, protocol: int
) -> None:
    fields = b"\xff" * (4 * flags.bit_count())
    has_erspan_ii = protocol == 0x88BE and flags & 0x1000
    header = bytes({0x88BE: 8 if has_erspan_ii else 0, 0x22EB: 12}.get(protocol, 0))
    is_ip = protocol in (0x0800, 0x86DD)
    packed = gre(INNER if is_ip else FRAME, protocol, fields + header, flags=flags | _RESERVED)
    for at in (0, 14):
        outer = bytes(at) + packed
        inner = outer.index(INNER)
        # The headers of IP and GRE tell where an IP packet begins, the Ethernet header that it is.
        needed = at + 24 if is_ip else inner
        for end in range(len(outer) + 1):
            found = find_inner(outer[:end], at, len(outer))
            assert found == (inner if end >= needed else NOT_IP), end


def test_erspan_iii_carries_an_ethernet_frame_or_an_ip_packet() -> None:
    for frame_type, subheader in product(range(32), (0, 1)):
        last = bytes([frame_type << 2 | 0x80, 0xFE | subheader])
        header = bytes(10) + last + b"\xff" * (8 * subheader)
        outer = gre(INNER if frame_type == 2 else FRAME, 0x22EB, header)
        expected = {0: 24 + len(header) + 14, 2: 24 + len(header)}.get(frame_type, NOT_IP)

        assert find_inner(outer, 0, len(outer)) == expected
        if frame_type == 2:
            assert find_inner(outer[:36], 0, len(outer)) == expected
            assert find_inner(outer[:35], 0, len(outer)) == NOT_IP


def test_only_some_protocols_carry_another_packet() -> None:
    inside = bytes.fromhex("0000 0800") + INNER  # GRE, or the bytes of another protocol.
    for protocol in range(256):
        packets = [
            (ipv4(inside, protocol=protocol), 20),
            (ipv4(inside, protocol=protocol, options=bytes(40)), 60),
        ]
        if protocol not in BEFORE_TCP:
            packets.append((ipv6(inside, following=protocol), 40))
        for outer, start in packets:
            expected = {4: start, 41: start, 47: start + 4}.get(protocol, NOT_IP)
            assert find_inner(outer, 0, len(outer)) == expected, protocol


@pytest.mark.parametrize(
    ("outer", "start", "needed"),
    [
        (ipv4(INNER, protocol=4), 20, 20),
        (ipv4(INNER, protocol=4, options=bytes(40)), 60, 20),
        (ipv6(INNER, following=4), 40, 40),
        (ipv6(bytes.fromhex("04 00 0104 00000000") + INNER, following=60), 48, 48),
    ],
    ids=["IPv4", "IPv4 with options", "IPv6", "IPv6 with options"],
)
def test_the_outer_header_must_be_whole_and_the_inner_one_need_not(
    outer: bytes, start: int, needed: int
) -> None:
    for at in (0, 14):
        for end in range(at + len(outer)):
            found = find_inner((bytes(at) + outer)[:end], at, at + len(outer))
            assert found == (at + start if end >= at + needed else NOT_IP), end


def test_fragments_of_gre_are_told_apart_from_whole_packets() -> None:
    for bit, (protocol, found) in product(range(16), ((47, 24), (4, 20))):
        is_fragment = bit <= 13
        outer = ipv4(bytes.fromhex("0000 0800") + INNER, protocol=protocol, fragment=1 << bit)
        instead = GRE_IN_FRAGMENTS if protocol == 47 else NOT_IP
        assert find_inner(outer, 0, len(outer)) == (instead if is_fragment else found)


@pytest.mark.parametrize(
    ("port", "flags", "is_read"),
    [
        (4789, 0x08, True),
        (4789, 0xFF, True),
        (4789, 0xF7, False),
        (4788, 0x08, False),
        (4790, 0x08, False),
    ],
)
def test_vxlan_has_a_port_and_a_flag(port: int, flags: int, is_read: bool) -> None:
    header = struct.pack(">HHHH", 4789, port, 0, 0) + bytes([flags]) + bytes(7)
    outer = bytes(3) + ipv4(header + TAGGED, protocol=17)
    for end in range(len(outer) + 1):
        found = find_inner(outer[:end], 3, len(outer))
        assert found == (3 + 20 + 16 + 18 if is_read and end >= 3 + 20 + 16 + 18 else NOT_IP), end
