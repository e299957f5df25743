"""What holds for every splitter of a serial line."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mbtool.core import Direction, SerialFormat
from mbtool.modbus import Adu, Skipped, Verdict, ascii_adu, rtu_adu
from mbtool.modbus.adu import DirectionBy, crc
from mbtool.serial_line import AsciiSplitter, RtuSplitter
from mbtool.serial_line.bus_model import SURE, BusModel, Classification
from mbtool.serial_line.rtu import HOLD_NS, WINDOW
from tests.benchmarks.adapters import Column, Damage, damaged, delivered
from tests.benchmarks.bus_traffic import bus_traffic
from tests.feeding import START_NS, Line, Read, feed_all
from tests.modbus.reading import adus, raw
from tests.strategies import SIZES, UNIT, messages

if TYPE_CHECKING:
    from types import FrameType

FORMAT = SerialFormat(19200, 8, "E", 1)
Splitter = RtuSplitter | AsciiSplitter
Make = Callable[[SerialFormat], Splitter]
RTU_SPLITTERS = [
    pytest.param(RtuSplitter, id="rtu"),
    pytest.param(partial(RtuSplitter, timed=False), id="rtu-without-times"),
    pytest.param(partial(RtuSplitter, speaker=Direction.RESPONSE), id="rtu-of-slaves"),
]
every_rtu_splitter = pytest.mark.parametrize("make", RTU_SPLITTERS)
every_splitter = pytest.mark.parametrize(
    "make", [*RTU_SPLITTERS, pytest.param(AsciiSplitter, id="ascii")]
)
SILENCES = st.sampled_from((
    0, FORMAT.t1_5_ns, FORMAT.t1_5_ns + 1, FORMAT.t3_5_ns - 1, FORMAT.t3_5_ns, 5_000_000,
    16_000_000, HOLD_NS - 1, HOLD_NS, 2_000_000_000,
))  # fmt: skip
EXCHANGED = (
    rtu_adu(0x11, bytes.fromhex("03 006B 0003")),
    rtu_adu(0x11, bytes.fromhex("03 06 022B 0000 0064")),
    rtu_adu(5, bytes.fromhex("06 0001 0003")),
    rtu_adu(8, bytes.fromhex("01 03E8 0011")),
    bytes.fromhex("01 03 04 0000 0185 3A00"),
    rtu_adu(1, bytes.fromhex("41 0102 03")),
    b"\x00",
    b"\xff",
)
"""What is near to being something else, and what noise looks like."""


@st.composite
def lines(draw: st.DrawFn) -> Line:
    """Frames, torn frames and noise, with silences of every kind between and inside them."""
    line = Line(FORMAT)
    for _ in range(draw(st.integers(0, 8))):
        frame = draw(st.sampled_from((rtu_adu, ascii_adu)))
        sent = st.builds(frame, UNIT, messages().map(lambda each: each.pdu))
        part = draw(st.one_of(sent, st.sampled_from(EXCHANGED), st.binary(max_size=9)))
        cut = draw(st.integers(0, len(part)))
        line.frame(part[:cut], draw(SILENCES)).frame(part[cut:], draw(SILENCES))
    return line


@every_splitter
@given(line=lines(), sizes=SIZES)
def test_no_byte_is_lost_and_cutting_makes_no_difference(
    make: Make, line: Line, sizes: list[int]
) -> None:
    events = feed_all(make(FORMAT), line.reads())
    assert raw(events) == line.data
    assert feed_all(make(FORMAT), line.reads([1] * len(line.data))) == events
    assert feed_all(make(FORMAT), line.reads(sizes)) == events


@every_splitter
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


@every_splitter
@given(reads=st.lists(st.tuples(st.binary(max_size=40), st.integers(-(10**8), 10**8)), max_size=20))
def test_no_byte_is_lost_whatever_the_clock_says(
    make: Make, reads: list[tuple[bytes, int]]
) -> None:
    events = feed_all(make(FORMAT), reads)
    assert raw(events) == b"".join(data for data, _ in reads)


@given(line=lines(), timed=st.booleans())
def test_what_an_rtu_line_gives_says_what_it_is(line: Line, timed: bool) -> None:
    for event in feed_all(RtuSplitter(FORMAT, timed=timed), line.reads()):
        if isinstance(event, Skipped):
            assert event.checksum is None or not event.checksum.ok
            continue
        assert crc(event.raw) == 0
        assert event.checksum is not None
        assert event.checksum.ok
        assert event.direction in (Direction.REQUEST, Direction.RESPONSE)
        assert 0.5 <= event.confidence <= 1
        assert (Verdict.AMBIGUOUS in event.verdicts) == (event.confidence < SURE)
        assert len(set(event.verdicts)) == len(event.verdicts)


@given(line=lines(), speaker=st.sampled_from((Direction.REQUEST, Direction.RESPONSE)))
def test_direction_is_that_of_the_one_who_speaks(line: Line, speaker: Direction) -> None:
    for adu in adus(feed_all(RtuSplitter(FORMAT, speaker=speaker), line.reads())):
        assert (adu.direction, adu.direction_by) == (speaker, DirectionBy.PORT)


@st.composite
def exchanges(draw: st.DrawFn) -> tuple[bytes, bytes]:
    """A request and its right answer: those that may be as long as a request, and their kin."""
    code = draw(st.sampled_from((0x01, 0x02, 0x03, 0x04, 0x17)))
    is_bits = code in (0x01, 0x02)
    quantities = st.integers(1, 2000) | st.integers(17, 24) if is_bits else st.integers(1, 125)
    quantity = draw(quantities)
    address = draw(st.integers(0, 0x10000 - quantity) | st.integers(0x300, 0x3FF))
    request = bytes((code, *address.to_bytes(2), *quantity.to_bytes(2)))
    if is_bits:
        count = (quantity + 7) // 8
        bits = draw(st.integers(0, 2**quantity - 1) | st.just(0))
        values = bytearray(bits.to_bytes(count, "little"))
    else:
        count = 2 * quantity
        values = bytearray(draw(st.binary(min_size=count, max_size=count)))
    if code == 0x17:
        written = max(quantity - 4, 1)
        request += bytes((0, 0, 0, written, 2 * written)) + bytes(2 * written)
        if quantity > 4:
            values[7] = 2 * written  # Where a request of this length has its byte count.
    answer = bytes((code, count)) + values
    # The next request of the same list, by each of its bytes, is for the turn to tell.
    assume((request[1], request[3:5]) != (answer[1], answer[3:5]))
    return request, answer


LATENCIES = st.integers(1_000_000, 3_000_000_000)


@given(
    unit=UNIT,
    exchange=exchanges(),
    other=exchanges(),
    latency_ns=LATENCIES,
    polls=st.lists(st.none() | LATENCIES, max_size=4),
    pause_ns=st.integers(5_000_000, 2_000_000_000),
    timed=st.booleans(),
    sizes=SIZES,
)
def test_request_and_its_right_answer_are_a_pair_however_late(
    unit: int,
    exchange: tuple[bytes, bytes],
    other: tuple[bytes, bytes],
    latency_ns: int,
    polls: list[int | None],
    pause_ns: int,
    timed: bool,
    sizes: list[int],
) -> None:
    """Also behind polls of the same, answered or not (None), and of something else."""
    line, truth = Line(FORMAT), []

    def say(unit: int, pdu: bytes, direction: Direction, before_ns: int) -> None:
        line.frame(rtu_adu(unit, pdu), before_ns)
        truth.append((rtu_adu(unit, pdu), direction))

    assume(exchange[1] != other[0])  # A request of this list after all.
    assume(other[1] != exchange[0])
    say(unit % 247 + 1, other[0], Direction.REQUEST, pause_ns)
    say(unit % 247 + 1, other[1], Direction.RESPONSE, 5_000_000)
    for answered_ns in (*polls, latency_ns):
        say(unit, exchange[0], Direction.REQUEST, pause_ns)
        if answered_ns is not None:
            say(unit, exchange[1], Direction.RESPONSE, answered_ns)
    events = feed_all(RtuSplitter(FORMAT, timed=timed), line.reads(sizes))
    assert [(adu.raw, adu.direction) for adu in adus(events)] == truth


# What it holds and what it does are bounded, whatever comes.

NOISE = random.Random(17).randbytes(2000)
LONG = bytes.fromhex("01 10 0000 0078 F0")
"""Promises a frame of 249 bytes."""
TEARS = 18


def one_run(data: bytes) -> Line:
    return Line(FORMAT).send(data)


def a_silence_after_every_byte(data: bytes) -> Line:
    line = Line(FORMAT)
    for byte in data:
        line.frame(bytes([byte]))
    return line


def torn_at_its_end(head: bytes, size: int) -> Line:
    """Frames that are long in coming, and are searched again at each silence."""
    line = Line(FORMAT)
    for _ in range(3):
        line.frame((head * 128)[:230])
        for at in range(TEARS):
            line.frame((head * TEARS * size)[at * size : (at + 1) * size])
    return line


def frames_behind_a_promise() -> Line:
    line = Line(FORMAT)
    for _ in range(3):
        line.frame(LONG)
        for _ in range(14):
            line.frame(rtu_adu(1, b"\x07") * 4)
    return line


def nested() -> Line:
    """A write that holds a write that holds one, torn."""
    inner = EXCHANGED[0]
    while len(inner) < 230:
        count = (len(inner) + 1) // 2
        held = inner.ljust(2 * count, b"\x00")
        inner = rtu_adu(1, b"\x10\x00\x00\x00" + bytes((count, 2 * count)) + held)
    line = Line(FORMAT)
    for _ in range(3):
        for at in range(0, len(inner), 16):
            line.frame(inner[at : at + 16])
    return line


def exchange() -> Line:
    line = Line(FORMAT)
    for _ in range(40):
        line.frame(EXCHANGED[0]).frame(EXCHANGED[1])
    return line


ORDINARY = 100
"""Calls of functions for each byte, at most, where frames are told at a glance or are alike."""
NOISY = 500
"""The same where no frame is."""
ADVERSE = 2500
"""The same of what is made to be searched again and again: each byte in MAX_TEARS searches."""

WORK = [
    pytest.param(exchange(), ORDINARY, id="exchange"),
    pytest.param(one_run((EXCHANGED[0] + EXCHANGED[1]) * 40), ORDINARY, id="exchange-glued"),
    pytest.param(one_run(EXCHANGED[2] * 100), 4 * ORDINARY, id="echoes"),
    pytest.param(one_run(EXCHANGED[3] * 100), 4 * ORDINARY, id="requests-like-responses"),
    pytest.param(one_run(EXCHANGED[5] * 100), NOISY, id="vendor-functions"),
    pytest.param(one_run(NOISE), NOISY, id="noise"),
    pytest.param(one_run(bytes(1500)), NOISY, id="zeros"),
    pytest.param(one_run(b"\xff" * 1500), NOISY, id="ones"),
    pytest.param(one_run(rtu_adu(1, b"\x41") * 200), 2 * NOISY, id="shortest-frames"),
    pytest.param(a_silence_after_every_byte(NOISE[:500]), ADVERSE, id="noise-with-silences"),
    pytest.param(a_silence_after_every_byte(bytes(500)), ADVERSE, id="zeros-with-silences"),
    pytest.param(torn_at_its_end(LONG, 1), ADVERSE, id="torn-promises"),
    pytest.param(torn_at_its_end(b"\x01\x03\xf0", 4), ADVERSE, id="torn-responses"),
    pytest.param(torn_at_its_end(b"\x01\x41", 4), ADVERSE, id="torn-vendor-functions"),
    pytest.param(torn_at_its_end(b"\x05\x08\x00\x00", 1), ADVERSE, id="torn-diagnostics"),
    pytest.param(frames_behind_a_promise(), ADVERSE, id="frames-behind-a-promise"),
    pytest.param(nested(), ADVERSE, id="nested"),
]


@pytest.mark.parametrize(("line", "most"), WORK)
def test_work_for_each_byte_is_bounded(line: Line, most: int) -> None:
    byte_by_byte = line.reads([1] * len(line.data))
    assert calls(RtuSplitter(FORMAT), byte_by_byte) <= most * len(line.data)
    assert calls(RtuSplitter(FORMAT, timed=False), line.reads()) <= most * len(line.data)


@every_rtu_splitter
@pytest.mark.parametrize("line", [one_run, a_silence_after_every_byte])
def test_work_for_each_byte_does_not_grow(make: Make, line: Callable[[bytes], Line]) -> None:
    """Four times the bytes are four times the work."""
    little, much = (calls(make(FORMAT), line(NOISE[:size]).reads()) / size for size in (1000, 4000))
    assert much < 1.5 * little


def test_costs_are_computed_a_few_times_for_each_byte() -> None:
    for parameters in WORK:
        line = parameters.values[0]
        assert isinstance(line, Line)
        bus_model = CountingBusModel()
        feed_all(RtuSplitter(FORMAT, bus_model), line.reads())
        assert bus_model.classified <= 5 * len(line.data), parameters.id


@every_rtu_splitter
@pytest.mark.parametrize("line", [one.values[0] for one in WORK], ids=[one.id for one in WORK])
def test_less_than_a_window_is_held(make: Make, line: Line) -> None:
    held = 0
    splitter = make(FORMAT)
    for data, ts_ns in line.reads([50] * len(line.data)):
        held += len(data) - len(raw(splitter.feed(data, ts_ns)))
        assert held < WINDOW
    assert held == len(raw(splitter.close()))


@every_rtu_splitter
@given(data=st.binary(max_size=300))
def test_nothing_is_held_for_longer_than_an_adapter_needs(make: Make, data: bytes) -> None:
    splitter = make(FORMAT)
    splitter.feed(data, START_NS)
    splitter.advance(START_NS + HOLD_NS)
    assert splitter.is_idle


def test_learning_the_time_costs_nothing() -> None:
    fed = RtuSplitter(FORMAT)
    fed.feed(LONG, START_NS)
    fed.advance(START_NS + FORMAT.t3_5_ns)
    most = 10
    times = range(START_NS + FORMAT.t3_5_ns, START_NS + HOLD_NS - 1, 1_000_000)
    assert counted(lambda: [fed.advance(now_ns) for now_ns in times]) <= most * len(times)


# Against traffic whose truth is known.


@pytest.mark.parametrize("column", Column)
@pytest.mark.parametrize("seed", range(3))
def test_what_is_sure_of_an_undamaged_line_is_right(column: Column, seed: int) -> None:
    traffic = bus_traffic(seed, 120)
    wire = damaged(traffic, Damage.NONE, random.Random(seed))
    splitter = RtuSplitter(wire.line, timed=column is not Column.NO_TIMES)
    events = feed_all(splitter, delivered(wire, column))
    assert raw(events) == bytes(wire.data)
    truth = {frame.offset: frame for frame in traffic.frames}
    found = offset = 0
    for event in events:
        frame = truth.get(offset)
        if isinstance(event, Adu) and event.confidence >= SURE:
            assert frame is not None, (offset, event.raw.hex(" "))
            assert (event.raw, event.direction) == (frame.raw, frame.direction), offset
            found += 1
        offset += len(event.raw)
    assert found >= 0.98 * len(traffic.frames)


class CountingBusModel(BusModel):
    """Counts how often a frame is classified, or its cost computed."""

    classified = 0

    def cost(self, *arguments: Any) -> float:
        self.classified += 1
        return super().cost(*arguments)

    def classify(self, *arguments: Any) -> Classification:
        self.classified += 1
        return super().classify(*arguments)


def calls(fed: Splitter, reads: Iterable[Read]) -> int:
    return counted(lambda: feed_all(fed, reads))


def counted(work: Callable[[], object]) -> int:
    """How many functions are called, Python's own included: work that no clock measures."""
    count = 0

    def note(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count
