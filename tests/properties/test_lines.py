"""What holds for every splitter of a serial line."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import SerialFormat
from mbtool.modbus import Adu, AsciiSplitter, RtuSplitter, Skipped, ascii_adu, rtu_adu
from mbtool.modbus.rtu import HOLD_NS
from tests.feeding import Line, feed_all
from tests.modbus.reading import raw
from tests.strategies import SIZES, UNIT, messages

FORMAT = SerialFormat(19200, 8, "E", 1)
Splitter = RtuSplitter | AsciiSplitter
Make = Callable[[SerialFormat], Splitter]
SPLITTERS: list[Make] = [RtuSplitter, AsciiSplitter]
SILENCES = st.sampled_from((
    0, FORMAT.t1_5_ns, FORMAT.t1_5_ns + 1, FORMAT.t3_5_ns - 1, FORMAT.t3_5_ns, 5_000_000,
    16_000_000, HOLD_NS - 1, HOLD_NS, 2_000_000_000,
))  # fmt: skip


@st.composite
def lines(draw: st.DrawFn) -> Line:
    """Frames, torn frames and noise, with silences of every kind between and inside them."""
    line = Line(FORMAT)
    for _ in range(draw(st.integers(0, 8))):
        frame = draw(st.sampled_from((rtu_adu, ascii_adu)))
        sent = st.builds(frame, UNIT, messages().map(lambda each: each.pdu))
        part = draw(st.one_of(sent, st.binary(max_size=9)))
        cut = draw(st.integers(0, len(part)))
        line.frame(part[:cut], draw(SILENCES)).frame(part[cut:], draw(SILENCES))
    return line


@pytest.mark.parametrize("make", SPLITTERS)
@given(line=lines(), sizes=SIZES)
def test_no_byte_is_lost_and_cutting_makes_no_difference(
    make: Make, line: Line, sizes: list[int]
) -> None:
    events = feed_all(make(FORMAT), line.reads())
    assert raw(events) == line.data
    assert feed_all(make(FORMAT), line.reads([1] * len(line.data))) == events
    assert feed_all(make(FORMAT), line.reads(sizes)) == events


@pytest.mark.parametrize("make", SPLITTERS)
@given(line=lines(), data=st.data())
def test_learning_of_true_silences_makes_no_difference(
    make: Make, line: Line, data: st.DataObject
) -> None:
    events: list[Adu | Skipped] = []
    splitter = make(FORMAT)
    ends = dict(line.silences())
    for part, ts_ns in line.reads():
        events += splitter.feed(part, ts_ns)
        if ts_ns in ends:
            for now_ns in sorted(data.draw(st.lists(st.integers(ts_ns, ends[ts_ns]), max_size=3))):
                events += splitter.advance(now_ns)
    assert events + splitter.close() == feed_all(make(FORMAT), line.reads())


@pytest.mark.parametrize("make", SPLITTERS)
@given(reads=st.lists(st.tuples(st.binary(max_size=40), st.integers(-(10**8), 10**8)), max_size=20))
def test_no_byte_is_lost_whatever_the_clock_says(
    make: Make, reads: list[tuple[bytes, int]]
) -> None:
    events = feed_all(make(FORMAT), reads)
    assert raw(events) == b"".join(data for data, _ in reads)
