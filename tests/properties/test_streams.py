"""What holds for every splitter of a stream."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.framing import MbapSplitter, RtuStreamSplitter
from mbtool.modbus import mbap_adu, rtu_adu
from tests.feeding import byte_by_byte, in_cuts, whole
from tests.modbus.reading import adus, raw, skipped
from tests.strategies import SIZES, UNIT, WORD, Message, messages

REQUEST = Direction.REQUEST
Splitter = MbapSplitter | RtuStreamSplitter
Make = Callable[[Direction], Splitter]
SPLITTERS: list[Make] = [MbapSplitter, RtuStreamSplitter]

DIRECTIONS = st.sampled_from((REQUEST, Direction.RESPONSE))


@st.composite
def adu_bytes(draw: st.DrawFn) -> bytes:
    """A frame of either kind, whole or damaged."""
    pdu = draw(messages()).pdu
    unit, transaction_id = draw(UNIT), draw(WORD)
    frame = draw(st.sampled_from((mbap_adu(transaction_id, unit, pdu), rtu_adu(unit, pdu))))
    cut = draw(st.integers(0, 5))
    return frame[cut:] if draw(st.booleans()) and cut else frame


PARTS = st.one_of(adu_bytes(), st.binary(max_size=20), st.just(bytes(9)))
STREAMS = st.lists(PARTS, max_size=8).map(b"".join)


@pytest.mark.parametrize("make", SPLITTERS)
@given(data=STREAMS, sizes=SIZES, direction=DIRECTIONS)
def test_no_byte_is_lost_and_cutting_makes_no_difference(
    make: Make, data: bytes, sizes: list[int], direction: Direction
) -> None:
    events = whole(make(direction), data)
    assert raw(events) == data
    assert byte_by_byte(make(direction), data) == events
    assert in_cuts(make(direction), data, sizes) == events


@pytest.mark.parametrize("make", SPLITTERS)
@given(
    parts=st.lists(st.tuples(st.binary(min_size=1, max_size=30), st.integers(0, 9)), max_size=20),
    gaps=st.sets(st.integers(0, 19)),
)
def test_no_byte_is_lost_at_gaps_and_times_run_on(
    make: Make, parts: list[tuple[bytes, int]], gaps: Iterable[int]
) -> None:
    splitter, now_ns = make(REQUEST), 0
    events = []
    for index, (data, later_ns) in enumerate(parts):
        now_ns += later_ns
        events += splitter.feed(data, now_ns)
        if index in gaps:
            events += splitter.gap()
    events += splitter.close()
    assert raw(events) == b"".join(data for data, _ in parts)
    times = [adu.end_ns for adu in adus(events)] + [now_ns]
    assert times == sorted(times)
    assert all(adu.start_ns <= adu.end_ns for adu in adus(events))


@given(st.lists(st.tuples(WORD, UNIT, messages(REQUEST)), max_size=8), SIZES)
def test_every_modbus_tcp_adu_is_found(
    sent: list[tuple[int, int, Message]], sizes: list[int]
) -> None:
    frames = [mbap_adu(number, unit, message.pdu) for number, unit, message in sent]
    events = in_cuts(MbapSplitter(REQUEST), b"".join(frames), sizes)
    assert [adu.raw for adu in adus(events)] == frames
    assert skipped(events) == []
