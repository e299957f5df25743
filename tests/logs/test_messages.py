from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Chunk, Packet, WireEvent
from mbtool.logs.messages import ChunkMessage, EventMessage
from tests.logs.samples import EVENT, PACKET, chunk, chunks, events, packets


@given(st.one_of(chunks, packets))
def test_evidence_comes_back_from_json(item: Chunk | Packet) -> None:
    data = msgspec.json.encode(ChunkMessage.of(item))
    assert msgspec.json.decode(data, type=ChunkMessage).item() == item


@given(events)
def test_an_event_comes_back_from_json(event: WireEvent) -> None:
    data = msgspec.json.encode(EventMessage.of(event))
    assert msgspec.json.decode(data, type=EventMessage).item() == event


def test_what_does_not_apply_is_absent() -> None:
    assert msgspec.json.decode(msgspec.json.encode(ChunkMessage.of(chunk(data=b"\x01")))) == {
        "ts_ns": 1_700_000_000_000_000_000,
        "link": "rs485",
        "data": "AQ==",
        "direction": "unknown",
        "stamp": "last-byte",
    }
    packet = msgspec.json.decode(msgspec.json.encode(ChunkMessage.of(PACKET)))
    assert set(packet) == {"ts_ns", "link", "data", "link_type", "original_length"}
    event = msgspec.json.decode(msgspec.json.encode(EventMessage.of(EVENT)))
    assert "raw" not in event
    assert event["missing"] == 60


def test_a_packet_without_its_length_on_the_wire_is_whole() -> None:
    item = ChunkMessage(ts_ns=1, link="eth0", data=b"abc", link_type=1).item()
    assert isinstance(item, Packet)
    assert item.original_length == 3
