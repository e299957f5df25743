"""What a live master has written is read back until the recording itself writes there."""

# A recording is made of a simulated device: a master reads and writes, and some values change by
# themselves. A live master then sends the same kinds of requests. The oracle has the recorded
# requests as a list, and what the live master has written as a dictionary; it looks everything up
# by walking through the list.

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from mbtool.core import Direction
from mbtool.modbus import Table, encode_pdu, parse_pdu, register_access, response_to, values_after
from mbtool.replay.matching import MatchStrategy, OnEnd
from mbtool.replay.player import RecordedSlave
from mbtool.replay.recording import Recording
from tests.replay.recorded import MS, answered, to_all, unanswered

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

ALL, UNIT, SILENT_UNIT = 0, 1, 9
SIZE = 3
LATENCY_MS = 3
BEGIN_NS = 1_700_000_000_000_000_000

Where = tuple[Table, int]

starts = st.integers(0, SIZE - 1)
values = st.integers(0, 2)
bits = st.integers(0, 1)


def _read(is_coils: bool, start: int, quantity: int) -> bytes:
    code = 0x01 if is_coils else 0x03
    quantity = min(quantity, SIZE - start)
    return encode_pdu(code, Direction.REQUEST, address=start, quantity=quantity)


def _write_coils(start: int, written: list[int]) -> bytes:
    return _write_several(0x0F, start, written)


def _write_several(code: int, start: int, written: list[int]) -> bytes:
    few = tuple(written[: SIZE - start])
    return encode_pdu(code, Direction.REQUEST, address=start, quantity=len(few), values=few)


def _read_and_write(start: int, quantity: int, write_start: int, written: list[int]) -> bytes:
    few = tuple(written[: SIZE - write_start])
    return encode_pdu(
        0x17,
        Direction.REQUEST,
        address=start,
        quantity=min(quantity, SIZE - start),
        write_address=write_start,
        write_quantity=len(few),
        values=few,
    )


reads = st.builds(_read, st.booleans(), starts, st.integers(1, SIZE))
single_writes = st.builds(lambda at, value: bytes([6, 0, at, 0, value]), starts, values)
writes = st.one_of(
    st.builds(lambda at, is_on: bytes([5, 0, at, 0xFF * is_on, 0]), starts, st.booleans()),
    single_writes,
    st.builds(_write_coils, starts, st.lists(bits, min_size=1, max_size=3)),
    st.builds(_write_several, st.just(0x10), starts, st.lists(values, min_size=1, max_size=3)),
    st.builds(lambda at, a, o: bytes([0x16, 0, at, 0, a, 0, o]), starts, values, values),
    st.builds(_read_and_write, starts, st.integers(1, SIZE), starts, st.lists(values, min_size=1)),
)
changes = st.tuples(st.sampled_from([Table.COILS, Table.HOLDING_REGISTERS]), starts, bits)


class Step(NamedTuple):
    """A recorded request and its response."""

    at_ms: int
    unit: int
    pdu: bytes
    response: bytes | None
    """None for a broadcast, and of the unit that never answers."""

    @property
    def done_ms(self) -> int:
        return self.at_ms if self.response is None else self.at_ms + LATENCY_MS

    @property
    def transaction(self) -> Transaction:
        if self.unit == ALL:
            return to_all(self.at_ms, self.pdu.hex())
        if self.response is None:
            return unanswered(self.at_ms, self.pdu.hex(), unit=self.unit)
        latency_ns = LATENCY_MS * MS
        return answered(self.at_ms, self.pdu.hex(), self.response.hex(), latency_ns=latency_ns)


Recorded = list[tuple[int, int, bytes, list[tuple[Table, int, int]]]]
recordings: st.SearchStrategy[Recorded] = st.lists(
    st.tuples(st.integers(5, 40), st.just(UNIT), reads | writes, st.lists(changes, max_size=2))
    | st.tuples(st.integers(5, 40), st.just(ALL), single_writes, st.just([]))
    | st.tuples(st.integers(5, 40), st.just(SILENT_UNIT), reads | writes, st.just([])),
    min_size=1,
    max_size=14,
)
"""Of each request: the pause before it in ms, its unit, its PDU, and what the device changes by
itself before."""


def _steps(recorded: Recorded) -> list[Step]:
    device: dict[Where, int] = {}
    steps: list[Step] = []
    at_ms = 0
    for pause_ms, unit, pdu, changed in recorded:
        at_ms += pause_ms
        if unit == SILENT_UNIT:
            steps.append(Step(at_ms, unit, pdu, None))
            continue
        device.update({(table, address): value for table, address, value in changed})
        table, read, written = _access(pdu)
        for address, value in _after(pdu, [device.get((table, each), 0) for each in written]):
            device[table, address] = value
        shown = [device.get((table, each), 0) for each in read]
        response = response_to(parse_pdu(pdu, Direction.REQUEST), pdu, shown)
        steps.append(Step(at_ms, unit, pdu, None if unit == ALL else response))
    return steps


def _access(pdu: bytes) -> tuple[Table, range, range]:
    access = register_access(parse_pdu(pdu, Direction.REQUEST))
    assert access is not None
    return access.table, access.reads, access.writes


def _after(pdu: bytes, before: list[int]) -> list[tuple[int, int]]:
    """The addresses that a request writes, and their values after it."""
    written = _access(pdu)[2]
    if not written:
        return []
    return list(zip(written, values_after(parse_pdu(pdu, Direction.REQUEST), before), strict=True))


@dataclass
class Live:
    """A value that the live master has written."""

    value: int
    place: tuple[int, int]
    recorded_writes: int


@dataclass
class Oracle:
    """The recording and the live master's writes. A place is a lap and a time in ms."""

    steps: list[Step]
    match: MatchStrategy
    on_end: OnEnd
    place: tuple[int, int] = (0, 0)
    given: dict[tuple[int, bytes], int] = field(default_factory=dict)
    seen: dict[Where, list[tuple[int, int]]] = field(default_factory=dict)
    recorded_writes: dict[Where, list[tuple[int, int | None]]] = field(default_factory=dict)
    live: dict[Where, Live] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.place = 0, self.steps[0].at_ms
        for step in self.steps:
            if step.unit == SILENT_UNIT:
                continue
            table, read, written = _access(step.pdu)
            before = [self.seen.get((table, each), [(0, -1)])[-1][1] for each in written]
            is_known = step.pdu[0] != 0x16 or before != [-1]
            for address, value in _after(step.pdu, before):
                writes_there = self.recorded_writes.setdefault((table, address), [])
                writes_there.append((step.done_ms, value if is_known else None))
                if is_known:
                    self.seen.setdefault((table, address), []).append((step.done_ms, value))
            for address, value in zip(read, self.values_of(step), strict=False):
                self.seen.setdefault((table, address), []).append((step.done_ms, value))

    @staticmethod
    def values_of(step: Step) -> list[int]:
        _, read, _ = _access(step.pdu)
        if step.response is None or not read:
            return []
        return list(parse_pdu(step.response, Direction.RESPONSE).numbers() or ())[: len(read)]

    def recorded(self, where: Where) -> int:
        seen = self.seen[where]
        return [value for at_ms, value in seen if at_ms <= self.place[1] or at_ms == seen[0][0]][-1]

    def writes_until(self, where: Where, place: tuple[int, int]) -> int:
        times = [at_ms for at_ms, _ in self.recorded_writes.get(where, [])]
        return place[0] * len(times) + sum(at_ms <= place[1] for at_ms in times)

    def has_ended(self, where: Where, place: tuple[int, int]) -> bool:
        live = self.live[where]
        return place >= live.place and self.writes_until(where, place) > live.recorded_writes

    def shown(self, where: Where) -> int:
        if where in self.live and not self.has_ended(where, self.place):
            return self.live[where].value
        return self.recorded(where)

    def write(self, pdu: bytes) -> None:
        table, _, written = _access(pdu)
        known = [(table, each) for each in written if (table, each) in self.seen]
        before = [self.shown((table, each)) if (table, each) in known else 0 for each in written]
        for address, value in _after(pdu, before):
            where = table, address
            if where not in known:
                continue
            place = max([self.place, *(live.place for live in [self.live.get(where)] if live)])
            count = self.writes_until(where, place)
            past = [v for at, v in self.recorded_writes.get(where, []) if at <= place[1]]
            if past and past[-1] == value == self.recorded(where):
                count -= 1
            self.live[where] = Live(value, place, count)

    def ask(self, unit: int, pdu: bytes) -> bytes | None:
        table, read, written = _access(pdu)
        found = self.find(unit, pdu)
        if unit == SILENT_UNIT:
            return None
        if unit == ALL:
            self.write(pdu)
            self.go_to(found)
            return None
        if found is None:
            if any((table, each) not in self.seen for each in (*read, *written)):
                return bytes([pdu[0] | 0x80, 2])
            self.write(pdu)
            shown = [self.shown((table, each)) for each in read]
            return response_to(parse_pdu(pdu, Direction.REQUEST), pdu, shown)
        self.write(pdu)
        self.go_to(found)
        step, _ = found
        place = min(self.place, (self.place[0], step.done_ms))
        shown = []
        for address, value in zip(read, self.values_of(step), strict=True):
            live = self.live.get((table, address))
            if live and self.has_ended((table, address), place):
                live.value, live.place = value, place
            shown.append(live.value if live else value)
        return response_to(parse_pdu(pdu, Direction.REQUEST), pdu, shown)

    def go_to(self, found: tuple[Step, int] | None) -> None:
        if found is not None and not self.match.by_clock:
            step, lap = found
            self.place = lap, step.done_ms

    def find(self, unit: int, pdu: bytes) -> tuple[Step, int] | None:
        """The recorded request that is played, and the lap; None for the register image."""
        key = unit, pdu
        same = [one for one in self.steps if (one.unit, one.pdu) == key]
        if self.match is MatchStrategy.IMAGE:
            return None
        if self.match is MatchStrategy.TIME:
            nearest = sorted(same, key=lambda one: (abs(one.at_ms - self.place[1]), one.at_ms))
            return (nearest[0], 0) if nearest else None
        of_all = self.match is MatchStrategy.SEQUENCE
        order, counter = (self.steps, (-1, b"")) if of_all else (same, key)
        index = self.given.get(counter, 0)
        if not same:
            return None
        if index >= len(order) and self.on_end is not OnEnd.LOOP:
            return same[-1], 0
        lap, index = divmod(index, len(order))
        if (order[index].unit, order[index].pdu) != key:
            return None
        self.given[counter] = self.given.get(counter, 0) + 1
        return order[index], lap


class ReadBack(RuleBasedStateMachine):
    """A live master that reads and writes against a recording."""

    match = MatchStrategy.AUTO

    @initialize(recorded=recordings, on_end=st.sampled_from([OnEnd.LAST, OnEnd.LOOP]))
    def begin(self, recorded: Recorded, on_end: OnEnd) -> None:
        self.steps = _steps(recorded)
        recording = Recording.of([step.transaction for step in self.steps])
        self.slave = RecordedSlave(recording, match=self.match, on_end=on_end)
        self.oracle = Oracle(self.steps, self.match, on_end)
        self.begin_ms = self.steps[0].at_ms
        self.length_ms = max(step.done_ms for step in self.steps) - self.begin_ms
        self.has_unit = any(step.response is not None for step in self.steps)
        self.now_ms: int | None = None
        """The time since the first request, with which the clock starts."""
        self.held: dict[Where, int] = {}
        """The last live value of what the recording never writes."""

    @rule(ms=st.integers(1, 60))
    def time_passes(self, ms: int) -> None:
        if self.now_ms is not None:
            self.now_ms += ms

    @rule(pdu=reads)
    def the_master_reads(self, pdu: bytes) -> None:
        self._exchange(UNIT, pdu)

    @rule(pdu=writes)
    def the_master_writes(self, pdu: bytes) -> None:
        self._exchange(UNIT, pdu)

    @rule(data=st.data())
    def the_master_asks_what_was_recorded(self, data: st.DataObject) -> None:
        step = data.draw(st.sampled_from(self.steps))
        self._exchange(step.unit, step.pdu)

    @rule(pdu=single_writes)
    def the_master_writes_to_all(self, pdu: bytes) -> None:
        self._exchange(ALL, pdu)

    @rule(pdu=reads | writes)
    def the_silent_unit_is_asked(self, pdu: bytes) -> None:
        self._exchange(SILENT_UNIT, pdu)

    def _exchange(self, unit: int, pdu: bytes) -> None:
        self.now_ms = self.now_ms or 0
        if self.match.by_clock:
            lap, ms = 0, min(self.now_ms, self.length_ms)
            if self.oracle.on_end is OnEnd.LOOP:
                lap, ms = divmod(self.now_ms, self.length_ms or 1000)
            self.oracle.place = lap, self.begin_ms + min(ms, self.length_ms)
        response = self.slave.respond(unit, pdu, BEGIN_NS + self.now_ms * MS)
        answer = None if response is None else response.pdu
        if not self.has_unit:
            assert answer is None
            return
        assert answer == self.oracle.ask(unit, pdu)
        is_refused = answer is not None and answer[0] != pdu[0]
        if unit != SILENT_UNIT and not is_refused:
            self._demand_read_back(pdu, answer)

    def _demand_read_back(self, pdu: bytes, answer: bytes | None) -> None:
        """What the recording never writes has the last live value, whatever else happens."""
        table, read, written = _access(pdu)
        for address, value in _after(pdu, [self.held.get((table, each), 0) for each in written]):
            where = table, address
            if where in self.oracle.recorded_writes or where not in self.oracle.seen:
                continue
            if pdu[0] == 0x16 and where not in self.held:
                continue  # Its value depends on one that only the recording knows.
            self.held[where] = value
        if answer is not None and read:
            shown = parse_pdu(answer, Direction.RESPONSE).numbers() or ()
            for address, value in zip(read, shown, strict=False):
                assert self.held.get((table, address), value) == value


class ReadBackByKey(ReadBack):
    match = MatchStrategy.KEY


class ReadBackInSequence(ReadBack):
    match = MatchStrategy.SEQUENCE


class ReadBackByTime(ReadBack):
    match = MatchStrategy.TIME


class ReadBackFromImage(ReadBack):
    match = MatchStrategy.IMAGE


for _machine in (ReadBack, ReadBackByKey, ReadBackInSequence, ReadBackByTime, ReadBackFromImage):
    _machine.TestCase.settings = settings(
        max_examples=min(40, settings().max_examples), stateful_step_count=25
    )
TestReadBack = ReadBack.TestCase
TestReadBackByKey = ReadBackByKey.TestCase
TestReadBackInSequence = ReadBackInSequence.TestCase
TestReadBackByTime = ReadBackByTime.TestCase
TestReadBackFromImage = ReadBackFromImage.TestCase


@pytest.mark.parametrize(
    ("match", "laps"),
    [
        (MatchStrategy.AUTO, 2),
        (MatchStrategy.KEY, 2),
        (MatchStrategy.SEQUENCE, 2),
        (MatchStrategy.TIME, 1),
    ],
)
@given(recordings)
def test_who_asks_what_was_recorded_gets_what_was_answered(
    match: MatchStrategy, laps: int, recorded: Recorded
) -> None:
    """Also in a second lap, although each write of the live master was kept."""
    steps = _steps(recorded)
    recording = Recording.of([step.transaction for step in steps])
    slave = RecordedSlave(recording, match=match, on_end=OnEnd.LOOP if laps > 1 else OnEnd.LAST)
    for step in steps * laps:
        response = slave.respond(step.unit, step.pdu, BEGIN_NS + step.at_ms * MS)
        assert (None if response is None else response.pdu) == step.response
