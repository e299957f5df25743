"""Packets of which the capture kept only the first bytes, whatever they carry."""

from __future__ import annotations

import pytest

from mbtool.core import EventKind, Packet
from mbtool.packets.stream_events import StreamGap
from tests.packets.building import (
    Talk,
    cut,
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

_SEGMENT = tcp(49152, 502, 1000, 5000, payload=b"abcdefgh")
_FRAME = ethernet(ipv4(_SEGMENT))
_PACKETS = {
    "IPv4": packet(_FRAME),
    "IPv4 with options": packet(ethernet(ipv4(_SEGMENT, options=bytes(8)))),
    "IPv6": packet(ethernet(ipv6(_SEGMENT), 0x86DD)),
    "first fragment": in_fragments(packet(_FRAME), 16)[0],
    "last fragment": in_fragments(packet(_FRAME), 16)[1],
    "GRE": packet(ethernet(gre(ipv4(_SEGMENT), 0x0800))),
    "ERSPAN": packet(erspan(_FRAME)),
    "VXLAN": packet(vxlan(_FRAME)),
    "IPv4 in IPv4": packet(ethernet(ipv4(ipv4(_SEGMENT), protocol=4))),
    "VLAN": packet(ethernet(ipv4(_SEGMENT), tags=bytes.fromhex("81000005"))),
}


@pytest.mark.parametrize("whole", _PACKETS.values(), ids=_PACKETS)
def test_a_packet_cut_at_any_byte_gives_a_prefix_of_its_bytes(whole: Packet) -> None:
    (expected,) = words_of(run_packets([whole])) or [">"]
    assert isinstance(expected, str)
    for length in range(len(whole.data)):
        for short in (cut(whole, length), packet(whole.data[:length])):
            kept = "".join(
                one.removeprefix(">")
                for one in words_of(run_packets([short]))
                if isinstance(one, str)
            )
            assert expected.startswith(f">{kept}"), length


@pytest.mark.parametrize("whole", _PACKETS.values(), ids=_PACKETS)
def test_a_packet_that_was_short_on_the_wire_is_not_told_as_cut(whole: Packet) -> None:
    for length in range(len(whole.data) + 1):
        events = wire_events(run_packets([packet(whole.data[:length])]))
        assert EventKind.CUT not in {one.kind for one in events}, length


@pytest.mark.parametrize(("kept", "is_read"), [(13, False), (14, True)])
def test_fourteen_bytes_of_the_tcp_header_are_enough_to_know_what_is_missing(
    kept: int, is_read: bool
) -> None:
    talk = Talk()
    opening = talk.handshake()
    header = 14 + 20 + kept

    items = run_packets([*opening, cut(talk.request(b"abcdefgh"), header), talk.request(b"ijkl")])

    cuts = [one for one in wire_events(items) if one.kind is EventKind.CUT]
    assert [one.missing for one in items if isinstance(one, StreamGap)] == [8]
    assert bool(cuts) is not is_read
