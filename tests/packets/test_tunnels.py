"""Packets inside packets, as mirror ports send them over a network."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind
from mbtool.packets.link_layer import NOT_IP
from mbtool.packets.stream_events import StreamOpened
from mbtool.packets.tunnels import MAX_TUNNELS, find_inner
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
