"""What holds for every capture of a network that holds whole conversations."""

# Networks cut segments otherwise, fragment packets, and deliver them twice or swapped; mirror ports
# do the same. None of it changes what was said, as long as a packet is overtaken by no more than
# PATIENCE - 1 others, within PATIENCE_NS. So packets stand a millisecond apart here, and times are
# not compared.

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as replace_fields

from mbtool.core import Packet, WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import NamedTransaction, Namer
from mbtool.packets.connection import PATIENCE
from mbtool.packets.link_layer import IP_FINDERS
from mbtool.packets.segment import ACK, FIN, RST, TcpSegment, find_tcp, read_segment
from tests.captures import read_packets
from tests.packets.building import ethernet, in_fragments, ipv4, tcp
from tests.packets.reading import host
from tests.records import without_origins

_FOLDER = Path(__file__).resolve().parents[2] / "captures"
_OURS = ("fa3-at1m8x-setup.pcap", "fa3-at1m8x-setup.pcapng")
_OTHERS = (
    "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap",  # requests sixteen deep, no SYN
    "apache__plc4x/modbus__tcp__manual-test-capture.pcapng",  # no SYN
    "cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap",
    "ntop__nDPI/modbus.pcap",
    "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap",
    "yakuter__go-dpi-packet/modbus.pcap",
    "zeek__zeek/modbusSmall.pcap",  # sixteen connections
)
_PACKETS = 120
"""How many of each capture are taken."""
_FARTHEST = 6
"""A copy comes fewer places later."""
_MS = 1_000_000
_NOT_COMPARED: dict[str, Any] = dict.fromkeys(
    ("request_ns", "response_ns", "latency_ns", "source_mac", "destination_mac", "vlan")
)
"""Without times and Ethernet addresses: both are given anew here."""


@dataclass(frozen=True)
class Fate:
    """What happens to a packet on its way."""

    cuts: tuple[int, ...] = ()
    """Sizes of the segments that it becomes, in bytes of payload, the rest in one more."""
    fragments: tuple[int, ...] = ()
    """Sizes of the fragments that each becomes, likewise."""
    overtaken: int = 0
    """By how many packets."""
    again: int | None = None
    """How many places later a copy comes."""


_FATES = st.builds(
    Fate,
    cuts=st.lists(st.integers(1, 9), max_size=3).map(tuple),
    fragments=st.lists(st.sampled_from((8, 16, 24)), max_size=2).map(tuple),
    overtaken=st.integers(0, PATIENCE - 1),
    again=st.one_of(st.none(), st.integers(0, _FARTHEST - 1)),
)


@pytest.mark.parametrize("name", _OURS)
@given(fates=st.lists(_FATES, min_size=1, max_size=40))
@settings(max_examples=60)
def test_cuts_copies_and_order_change_nothing_that_was_said(name: str, fates: list[Fate]) -> None:
    packets = _packets(_FOLDER / name)

    assert _said(_changed(packets, fates)) == _said(packets)


@pytest.mark.public_captures
@pytest.mark.parametrize("name", _OTHERS)
@given(fates=st.lists(_FATES, min_size=1, max_size=40))
@settings(max_examples=20)
def test_cuts_copies_and_order_change_nothing_in_public_captures(
    public_captures: Path, name: str, fates: list[Fate]
) -> None:
    packets = _packets(public_captures / name)

    assert _said(_changed(packets, fates)) == _said(packets)


@cache
def _packets(path: Path) -> tuple[Packet, ...]:
    """The TCP packets of a capture's beginning, a millisecond apart."""
    kept = (each for each in read_packets(path) if _segment(each) is not None)
    return tuple(
        replace(each, ts_ns=number * _MS) for number, each in enumerate(islice(kept, _PACKETS))
    )


def _segment(packet: Packet) -> TcpSegment | None:
    at = IP_FINDERS[packet.link_type](packet.data)
    place = find_tcp(packet.data, at, packet.original_length) if at >= 0 else None
    if place is None:
        return None
    segment = read_segment(packet.data, at, place, packet.original_length)
    return segment if segment and 502 in (segment.source_port, segment.destination_port) else None


def _changed(packets: tuple[Packet, ...], fates: list[Fate]) -> list[Packet]:
    moved: list[tuple[float, Packet]] = []
    for number, each in enumerate(packets):
        fate = fates[number % len(fates)]
        for part in _cut(each, fate, number):
            place = len(moved)
            segment = _segment(each)
            if segment is not None and segment.flags & RST:
                # Nothing is overtaken by a reset: what comes behind it is another connection.
                moved.append((place + _FARTHEST, part))
                continue
            moved.append((place + fate.overtaken + 0.5, part))
            if fate.again is not None:
                moved.append((place + fate.again + 0.7, part))
    ordered = [part for _, part in sorted(moved, key=lambda one: one[0])]
    times = sorted(part.ts_ns for part in ordered)
    return [replace(part, ts_ns=ts_ns) for part, ts_ns in zip(ordered, times, strict=True)]


def _cut(packet: Packet, fate: Fate, number: int) -> list[Packet]:
    segment = _segment(packet)
    assert segment is not None
    parts: list[Packet] = []
    at, payload = 0, segment.payload
    if len(segment.source) != 4 or segment.missing:
        return [packet]
    for size in (*fate.cuts, len(payload)):
        part = payload[at : at + size]
        last = at + len(part) == len(payload)
        flags = segment.flags if last else ACK | (segment.flags & ~FIN & ~RST)
        data = ipv4(
            tcp(
                segment.source_port,
                segment.destination_port,
                segment.sequence + at,
                segment.acknowledgement,
                flags,
                part,
            ),
            host(segment.source),
            host(segment.destination),
        )
        frame = ethernet(data)
        again = replace(packet, data=frame, original_length=len(frame), link_type=1)
        identification = (number * 16 + len(parts)) & 0xFFFF
        parts += in_fragments(again, *fate.fragments, identification=identification)
        at += size
        if last:
            break
    return parts


def _said(packets: tuple[Packet, ...] | list[Packet]) -> dict[str | None, list[NamedTransaction]]:
    """The transactions of each connection in their order, without times."""
    decoder = Decoder(Namer(), ports=(502,))
    records = [record for each in packets for record in decoder.feed(each)]
    said: dict[str | None, list[NamedTransaction]] = defaultdict(list)
    for record in without_origins(records + decoder.close()):
        if not isinstance(record, WireEvent):
            said[record.source].append(replace_fields(record, **_NOT_COMPARED))
    return said
