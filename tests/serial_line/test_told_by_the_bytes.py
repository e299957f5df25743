"""Cases in which times mislead or habits fail, and the bytes on the line tell what happened."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, EventKind, SerialFormat, WireEvent
from mbtool.decode.connections import Bus
from mbtool.devices import Namer
from mbtool.devices.checking.checker import Checker
from mbtool.modbus import Adu, Outcome, Transaction, Verdict, rtu_adu
from mbtool.modbus.adu import crc
from tests.feeding import START_NS

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding

LINE = SerialFormat(9600)
MS = 1_000_000
READ = bytes.fromhex("03 0010 0002")
CLOCKED = pytest.mark.parametrize("timed", [True, False], ids=["with times", "without times"])


class Wire:
    """The bytes of a line, each as a read of its own."""

    def __init__(self) -> None:
        self.now_ns = START_NS
        self.reads: list[tuple[bytes, int]] = []
        self._random = Random(1)

    def say(self, adu: bytes, pause_ms: float, *, gap_at: int = -1, gap_ms: int = 0) -> Wire:
        """Send a frame after a pause, with a gap before the byte `gap_at`."""
        self.now_ns += int(pause_ms * MS)
        for at, byte in enumerate(adu):
            self.now_ns += LINE.character_ns + (gap_ms * MS if at == gap_at else 0)
            self.reads.append((bytes([byte]), self.now_ns))
        return self

    def read(self, data: bytes, pause_ms: float) -> Wire:
        """Deliver bytes as one read, so long after the last one."""
        self.now_ns += int(pause_ms * MS)
        self.reads.append((data, self.now_ns))
        return self

    def exchange(self, unit: int, request: bytes, response: bytes) -> Wire:
        self.say(rtu_adu(unit, request), self._random.uniform(45, 55))
        return self.say(rtu_adu(unit, response), self._random.uniform(9, 11))

    def poll(self, number: int = 10) -> Wire:
        """Let the master read two registers of units 1 and 2, so many times each."""
        for _ in range(number):
            for unit in (1, 2):
                self.exchange(unit, READ, bytes([3, 4]) + self._random.randbytes(4))
        return self

    def heard(self, *, timed: bool = True) -> list[Adu | Transaction | WireEvent]:
        bus = Bus("line", LINE, timed=timed)
        found = [one for data, ts_ns in self.reads for one in bus.feed(data, ts_ns)]
        return found + bus.close()


def transactions(found: list[Adu | Transaction | WireEvent]) -> list[Transaction]:
    return [one for one in found if isinstance(one, Transaction)]


def odd(found: list[Adu | Transaction | WireEvent]) -> list[tuple[int, Outcome]]:
    """Unit and outcome of all transactions that are not ok."""
    return [(one.unit, one.outcome) for one in transactions(found) if one.outcome is not Outcome.OK]


def errors(found: list[Adu | Transaction | WireEvent]) -> set[tuple[str, int | None]]:
    """Code and unit of each finding of `check` about a response or its absence."""
    checker, namer = Checker(), Namer()
    findings: list[Finding] = []
    for one in found:
        if not isinstance(one, Adu):
            findings += checker.feed(namer.name(one) if isinstance(one, Transaction) else one)
    findings += checker.close()
    return {(one.code, one.unit) for one in findings if one.code[:4] in {"MB-2", "MB-4"}}


@CLOCKED
@pytest.mark.parametrize("gap_ms", [50, 300, 500, 900])
def test_a_gap_inside_a_frame_tears_nothing(gap_ms: int, timed: bool) -> None:
    wire = Wire().poll()
    for gap_at in range(1, 8):
        wire.say(rtu_adu(1, READ), 50, gap_at=gap_at, gap_ms=gap_ms)
        wire.say(rtu_adu(1, bytes.fromhex("03 04 00010002")), 10, gap_at=gap_at, gap_ms=gap_ms)
    found = wire.heard(timed=timed)
    assert odd(found) == []
    assert len(transactions(found)) == 27


def test_times_that_go_back_a_little_cost_nothing_and_are_told_once() -> None:
    wire, random = Wire().poll(50), Random(2)
    wire.reads = [
        (data, ts_ns - random.randint(1, 3) * MS if random.random() < 0.05 else ts_ns)
        for data, ts_ns in wire.reads
    ]
    found = wire.heard()
    assert len(transactions(found)) == 100
    assert odd(found) == []
    (event,) = [one for one in found if isinstance(one, WireEvent)]
    assert event.kind is EventKind.DISORDER


def test_the_direction_of_writes_is_known_once_their_values_have_changed() -> None:
    wire = Wire()
    for value in range(50):
        request = bytes.fromhex("06 0001") + value.to_bytes(2, "big")
        wire.exchange(1 + value % 2, request, request)
    adus = [one for one in wire.heard() if isinstance(one, Adu)]
    assert [one.direction for one in adus] == [Direction.REQUEST, Direction.RESPONSE] * 50
    assert sum(Verdict.AMBIGUOUS in one.verdicts for one in adus) <= 6


def test_the_direction_of_equal_writes_stays_ambiguous() -> None:
    wire = Wire()
    request = bytes.fromhex("06 0001 0005")
    for _ in range(50):
        wire.exchange(1, request, request)
    adus = [one for one in wire.heard() if isinstance(one, Adu)]
    assert sum(Verdict.AMBIGUOUS in one.verdicts for one in adus) >= 90


@CLOCKED
@pytest.mark.parametrize(
    ("request_", "response"),
    [("06 0001 01F4", "06 0001 0064"), ("05 0001 FF00", "05 0001 0000")],
    ids=["a clamped value", "another coil state"],
)
def test_a_wrong_echo_of_a_unit_that_answers_is_a_wrong_answer(
    request_: str, response: str, timed: bool
) -> None:
    wire = Wire().poll()
    for _ in range(4):
        wire.exchange(1, bytes.fromhex(request_), bytes.fromhex(response)).poll(2)
    found = wire.heard(timed=timed)
    assert odd(found) == [(1, Outcome.MALFORMED)] * 4
    assert errors(found) == {("MB-201", 1)}


@CLOCKED
def test_a_write_that_is_answered_with_the_whole_request_is_answered_wrongly(timed: bool) -> None:
    wire, request = Wire().poll(), bytes.fromhex("10 0001 0002 04 00010002")
    for _ in range(12):
        wire.exchange(1, request, request).poll(1)
    found = wire.heard(timed=timed)
    assert odd(found)[-6:] == [(1, Outcome.MALFORMED)] * 6
    assert errors(found) == {("MB-203", 1)}


def test_a_line_on_which_every_frame_comes_twice_has_no_such_answers() -> None:
    wire = Wire()
    write, answer = bytes.fromhex("10 0001 0002 04 00010002"), bytes.fromhex("10 0001 0002")
    for _ in range(10):
        for request, response in ((READ, bytes.fromhex("03 04 00010002")), (write, answer)):
            for frame, pause_ms in ((request, 50), (request, 3), (response, 10), (response, 3)):
                wire.say(rtu_adu(1, frame), pause_ms)
    assert Outcome.MALFORMED not in {outcome for _, outcome in odd(wire.heard())}


@CLOCKED
def test_the_answer_to_a_damaged_request_blames_no_slave(timed: bool) -> None:
    damaged = bytearray(rtu_adu(1, bytes.fromhex("03 0020 0003")))
    damaged[3] ^= 4
    wire = Wire().poll().say(rtu_adu(1, READ), 50).say(bytes(damaged), 500)
    wire.say(rtu_adu(1, bytes.fromhex("03 06 0001 0002 0003")), 10).poll(3)
    found = wire.heard(timed=timed)
    assert sorted(odd(found)) == [(1, Outcome.NO_ANSWER), (1, Outcome.NOT_CAPTURED)]
    assert errors(found) == {("MB-402", 1)}


def test_a_late_answer_goes_to_the_request_whose_size_it_has() -> None:
    long = bytes.fromhex("03 0200 007D")
    wire = Wire().poll().say(rtu_adu(1, bytes.fromhex("03 0100 0001")), 50)
    wire.say(rtu_adu(1, long), 500).say(rtu_adu(1, bytes.fromhex("03 02 0000")), 10)
    wire.say(rtu_adu(1, bytes([3, 250]) + bytes(250)), 10)
    one, two = transactions(wire.heard())[-2:]
    assert (one.quantity, one.outcome, one.confidence) == (1, Outcome.LATE, 1.0)
    assert (two.quantity, two.outcome) == (125, Outcome.OK)


def test_a_known_poll_behind_a_stray_byte_is_found_though_a_tick_cuts_its_last_byte() -> None:
    wire = Wire()
    poll, values = bytes.fromhex("03 0000 0007"), bytes([3, 14]) + bytes(range(14))
    for _ in range(10):
        wire.exchange(2, poll, values)
    wire.read(bytes.fromhex("3f 02 03 00 00 00 07 04"), 50).read(bytes.fromhex("3b"), 16)
    wire.say(rtu_adu(2, values), 10).poll(3)
    found = wire.heard()
    assert odd(found) == []
    assert [one.raw for one in found if isinstance(one, WireEvent)] == [b"\x3f"]


@CLOCKED
@pytest.mark.parametrize("late_ms", [1, 16, 300])
def test_a_response_whose_last_byte_is_late_is_no_request(late_ms: int, timed: bool) -> None:
    wire = Wire().poll()
    response = bytes.fromhex("01 03 04 b2 d4 00 bb dd 00")
    for _ in range(3):
        wire.say(rtu_adu(1, READ), 50).say(response, 10, gap_at=8, gap_ms=late_ms)
    found = wire.heard(timed=timed)
    assert odd(found) == []
    assert [one for one in found if isinstance(one, WireEvent)] == []
    assert {one.quantity for one in transactions(found)} == {2}


@CLOCKED
def test_a_known_poll_wins_over_a_crc_by_chance_from_a_stray_ff_on(timed: bool) -> None:
    poll, values = bytes.fromhex("03 0061 0001"), bytes.fromhex("03 02 0007")
    assert crc(bytes.fromhex("ff 01 03 00 61")) == 0
    wire = Wire()
    for _ in range(10):
        wire.exchange(1, poll, values)
    wire.say(b"\xff" + rtu_adu(1, poll), 50).say(rtu_adu(1, values), 10).poll(3)
    found = wire.heard(timed=timed)
    assert odd(found) == []
    assert {one.unit for one in transactions(found)} == {1, 2}
    assert [one.raw for one in found if isinstance(one, WireEvent)] == [b"\xff"]


@CLOCKED
def test_where_only_the_slaves_are_heard_every_frame_is_a_response(timed: bool) -> None:
    wire = Wire()
    frames = ("03 04 0001 0002", "04 02 0007", "01 03 0F0F0F", "06 0001 0005", "05 0002 FF00")
    for number in range(10):
        for pdu in frames if number else frames[:2]:
            wire.say(rtu_adu(1, bytes.fromhex(pdu)), 60)
    found = wire.heard(timed=timed)
    adus = [one for one in found if isinstance(one, Adu)]
    assert {one.direction for one in adus} == {Direction.RESPONSE}
    assert {outcome for _, outcome in odd(found)} == {Outcome.NOT_CAPTURED}
    assert len(transactions(found)) == 47


def test_two_masters_of_one_slave_each_get_their_response() -> None:
    wire = Wire().poll()
    for _ in range(3):
        wire.say(rtu_adu(1, bytes.fromhex("03 0100 0001")), 50)
        wire.say(rtu_adu(1, bytes.fromhex("03 0200 0003")), 5)
        wire.say(rtu_adu(1, bytes.fromhex("03 02 0000")), 25)
        wire.say(rtu_adu(1, bytes.fromhex("03 06 0001 0002 0003")), 25)
    found = transactions(wire.heard())[20:]
    assert sorted((one.quantity, one.response_values) for one in found) == [
        *[(1, [0])] * 3, *[(3, [1, 2, 3])] * 3,
    ]  # fmt: skip
    assert {one.outcome for one in found} == {Outcome.OK}


@CLOCKED
def test_a_unit_that_is_off_for_minutes_leaves_its_set_points_unanswered(timed: bool) -> None:
    wire = Wire()
    for value in range(40):
        request = bytes.fromhex("06 0001") + value.to_bytes(2, "big")
        if value < 20:
            wire.exchange(1, request, request)
        else:
            wire.say(rtu_adu(1, request), 1000)
        wire.exchange(2, request, request)
    found = wire.heard(timed=timed)
    assert {one for one in odd(found) if one[0] == 1} == {(1, Outcome.NO_ANSWER)}
    assert 18 <= len([one for one in odd(found) if one[0] == 1]) <= 20
    assert errors(found) == {("MB-401", 1)}


@pytest.mark.parametrize("gap_ms", [2000, 20000])
def test_a_full_buffer_does_not_tear_the_response_that_is_due(gap_ms: int) -> None:
    wire = Wire().poll()
    for gap_at in range(2, 9):
        wire.say(rtu_adu(1, READ), 50)
        wire.say(rtu_adu(1, bytes.fromhex("03 04 00010002")), 10, gap_at=gap_at, gap_ms=gap_ms)
    found = wire.heard()
    assert odd(found) == []
    assert len(transactions(found)) == 27
