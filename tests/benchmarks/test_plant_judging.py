"""What is counted as found, as wrong and as unknowable."""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, SerialFormat
from mbtool.modbus import Outcome
from tests.benchmarks.plants import pdus
from tests.benchmarks.plants.catalog import PLANTS, record
from tests.benchmarks.plants.judging import (
    PlantFigures,
    Told,
    ToldFrame,
    ToldTransaction,
    judge,
)
from tests.benchmarks.plants.knowable import Unknowable, unknowable
from tests.benchmarks.plants.recording import MS, Bus, Recording, Role

if TYPE_CHECKING:
    from collections.abc import Iterable

LINE = SerialFormat.parse("9600-8E1")
READ = pdus.read(0x03, 100, 2)
VALUES = pdus.read_response(0x03, [7, 8])
WRITE = pdus.write_register(5, 1)
TIMEOUT = 500


@pytest.fixture
def bus() -> Bus:
    one = Bus(LINE, Random(1))
    one.recording.timeout_ns = TIMEOUT * MS
    one.recording.pause_ns = 20 * MS
    return one


def answered(bus: Bus, unit: int, request: bytes, response: bytes, latency_ms: float = 5) -> None:
    at = bus.ask(unit, request)
    bus.wait(latency_ms * MS)
    bus.reply(at, response)
    bus.wait(20 * MS)


def unanswered(bus: Bus, unit: int, request: bytes, tries: int = 1) -> None:
    for number in range(tries):
        bus.ask(unit, request, is_retry=number > 0)
        bus.wait(TIMEOUT * MS)
    bus.wait(20 * MS)


def truth(recording: Recording) -> Told:
    """What a decoder that knows everything tells."""
    sent = recording.sent
    told = Told(transactions=[])
    answers = {one.answers: one for one in sent if one.role is Role.RESPONSE}
    for at, one in enumerate(sent):
        if one.role is Role.ECHO:
            told.echoes.append(one.offset)
        elif one.role is not Role.NOISE:
            told.frames.append(ToldFrame(one.offset, one.raw, Direction(one.role), 1.0))
        is_alone = one.role is Role.RESPONSE and (
            one.answers is None or sent[one.answers].is_damaged
        )
        if is_alone:
            told_transactions(told).append(
                ToldTransaction(
                    None, (one.offset, one.raw), Outcome.NOT_CAPTURED, 1.0, is_ambiguous=False
                )
            )
        if one.role is Role.REQUEST:
            response = answers.get(at)
            outcome = Outcome.NO_ANSWER if one.unit else Outcome.BROADCAST
            if response is not None:
                outcome = Outcome.EXCEPTION if response.is_exception else Outcome.OK
            told_transactions(told).append(
                ToldTransaction(
                    (one.offset, one.raw),
                    None if response is None else (response.offset, response.raw),
                    outcome,
                    1.0,
                    is_ambiguous=False,
                )
            )
    return told


def told_transactions(told: Told) -> list[ToldTransaction]:
    assert told.transactions is not None
    return told.transactions


def transactions(told: Told, chosen: Iterable[ToldTransaction]) -> Told:
    return replace(told, transactions=list(chosen))


def judged(recording: Recording, told: Told, resolution_ns: int | None = None) -> PlantFigures:
    return judge(recording, unknowable(recording, resolution_ns), told)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("resolution_ns", [0, None])
def test_the_truth_itself_is_judged_as_right(plant: str, resolution_ns: int | None) -> None:
    recording = record(plant, 5, 150)
    one = judged(recording, truth(recording), resolution_ns)
    assert one.transactions + one.hidden == one.all
    assert one.found == one.transactions
    assert one.right == one.all
    assert one.frames_found == one.frames
    assert (one.wrong, one.sure_wrong, one.sure_amiss, one.frames_false) == (0, 0, 0, 0)


@pytest.mark.parametrize("plant", PLANTS)
def test_what_cannot_be_known_is_a_small_part_where_times_are_exact(plant: str) -> None:
    one = [
        judged(recording, truth(recording), 0)
        for recording in (record(plant, seed, 150) for seed in range(4))
    ]
    share = sum(each.doubtful + each.hidden for each in one) / sum(each.all for each in one)
    assert share < (0.9 if plant == "write loop" else 0.1)


def test_nothing_told_is_nothing_found(bus: Bus) -> None:
    answered(bus, 1, READ, VALUES)
    one = judged(bus.recording, Told())
    assert (one.transactions, one.found, one.told) == (1, 0, 0)


def test_a_response_joined_with_another_request_is_wrong(bus: Bus) -> None:
    answered(bus, 1, READ, VALUES)
    answered(bus, 2, READ, VALUES)
    told = truth(bus.recording)
    first, second = told_transactions(told)
    crossed = [replace(first, response=second.response), replace(second, response=first.response)]
    one = judged(bus.recording, transactions(told, crossed))
    assert (one.found, one.wrong, one.sure_wrong) == (0, 2, 2)


def test_a_frame_told_one_byte_short_is_none(bus: Bus) -> None:
    answered(bus, 1, READ, VALUES)
    told = truth(bus.recording)
    (only,) = told_transactions(told)
    assert only.request is not None
    short = only.request[0], only.request[1][:-1]
    one = judged(bus.recording, transactions(told, [replace(only, request=short)]))
    assert (one.found, one.sure_wrong) == (0, 1)


def test_which_of_two_equal_requests_a_response_belongs_to_may_be_told_either_way(
    bus: Bus,
) -> None:
    unanswered(bus, 1, READ)
    answered(bus, 1, READ, VALUES)
    told = truth(bus.recording)
    first, second = told_transactions(told)
    other = [
        replace(first, response=second.response, outcome=Outcome.OK),
        replace(second, response=None, outcome=Outcome.NO_ANSWER),
    ]
    assert judged(bus.recording, transactions(told, other)).found == 2
    both = [replace(first, outcome=Outcome.NO_ANSWER), replace(second, response=None)]
    both[1] = replace(both[1], outcome=Outcome.NO_ANSWER)
    one = judged(bus.recording, transactions(told, both))
    assert (one.found, one.wrong) == (1, 1)


def test_a_response_that_comes_late_may_be_told_as_unasked(bus: Bus) -> None:
    at = bus.ask(1, READ)
    bus.wait(TIMEOUT * MS)
    second = bus.ask(2, READ)
    bus.wait(5 * MS)
    bus.reply(at, VALUES, is_late=True)
    bus.wait(5 * MS)
    bus.reply(second, VALUES)
    told = truth(bus.recording)
    first, other = told_transactions(told)
    late = ToldTransaction(None, first.response, Outcome.UNSOLICITED, 1.0, is_ambiguous=False)
    alone = replace(first, response=None, outcome=Outcome.NO_ANSWER)
    one = judged(bus.recording, transactions(told, [alone, late, other]))
    assert (one.found, one.wrong) == (one.transactions, 0)


def test_two_equal_writes_to_a_dead_unit_cannot_be_known_without_times(bus: Bus) -> None:
    for _ in range(4):
        answered(bus, 1, READ, VALUES)
    unanswered(bus, 9, WRITE, tries=2)
    told = truth(bus.recording)
    *polls, first, second = told_transactions(told)
    pair = ToldTransaction(first.request, second.request, Outcome.OK, 0.95, is_ambiguous=False)
    sure = judged(bus.recording, transactions(told, [*polls, pair]))
    assert (sure.transactions, sure.doubtful, sure.found, sure.sure_wrong) == (6, 2, 4, 1)
    said = replace(pair, confidence=0.5, is_ambiguous=True)
    doubted = judged(bus.recording, transactions(told, [*polls, said]))
    assert (doubted.found, doubted.sure_wrong, doubted.wrong) == (6, 0, 1)


def test_with_exact_times_they_can(bus: Bus) -> None:
    for _ in range(4):
        answered(bus, 1, READ, VALUES)
    unanswered(bus, 9, WRITE, tries=2)
    unclear = unknowable(bus.recording, 0)
    assert unclear == Unknowable()


@pytest.mark.parametrize("resolution_ns", [0, None])
def test_one_write_to_a_dead_unit_is_known_to_get_no_response(
    bus: Bus, resolution_ns: int | None
) -> None:
    answered(bus, 1, READ, VALUES)
    unanswered(bus, 9, WRITE)
    assert unknowable(bus.recording, resolution_ns) == Unknowable()


def test_a_write_to_a_unit_that_responds_is_known_without_times(bus: Bus) -> None:
    answered(bus, 1, READ, VALUES)
    answered(bus, 1, WRITE, WRITE)
    assert unknowable(bus.recording, None) == Unknowable()


def test_three_equal_writes_to_a_unit_that_responds_are_in_doubt_without_times(bus: Bus) -> None:
    answered(bus, 1, READ, VALUES)
    unanswered(bus, 1, WRITE)
    answered(bus, 1, WRITE, WRITE)
    assert unknowable(bus.recording, None).doubtful == {2, 3, 4}


def test_two_lost_responses_in_a_row_leave_no_trace_without_times(bus: Bus) -> None:
    answered(bus, 1, READ, VALUES)
    unanswered(bus, 1, WRITE, tries=2)
    unclear = unknowable(bus.recording, None)
    assert (unclear.doubtful, unclear.hidden) == (set(), {2, 3})


def test_writes_of_several_registers_are_always_known(bus: Bus) -> None:
    """A request of 10H is longer than its response."""
    unanswered(bus, 9, pdus.write_registers(5, [1, 2]), tries=3)
    assert unknowable(bus.recording, None) == Unknowable()


def test_a_response_as_late_as_the_timeout_is_in_doubt(bus: Bus) -> None:
    for _ in range(4):
        unanswered(bus, 1, READ, tries=2)
        answered(bus, 1, READ, VALUES)
    known = len(bus.recording.sent)
    answered(bus, 1, WRITE, WRITE, latency_ms=TIMEOUT - 100)
    answered(bus, 1, pdus.write_register(5, 2), pdus.write_register(5, 2), TIMEOUT - 1)
    assert unknowable(bus.recording, 0).doubtful == {known + 2, known + 3}


def test_a_frame_of_an_unknown_function_that_ends_in_00_is_in_doubt_without_silences(
    bus: Bus,
) -> None:
    pdu = next(
        pdu
        for number in range(4096)
        if pdus.rtu_frame(1, pdu := bytes((0x41, number >> 8, number & 255)))[-1] == 0
    )
    unanswered(bus, 1, pdu)
    assert unknowable(bus.recording, None).doubtful == {0}
    assert unknowable(bus.recording, 0).doubtful == set()


def test_an_echo_told_as_a_request_is_wrong_once_it_is_known(bus: Bus) -> None:
    bus.echo_ns = MS // 2
    for _ in range(5):
        answered(bus, 1, READ, VALUES)
    told = truth(bus.recording)
    assert judged(bus.recording, told).found == 2
    echoes = [one for one in bus.recording.sent if one.role is Role.ECHO]
    extra = [
        ToldTransaction((one.offset, one.raw), None, Outcome.NO_ANSWER, 1.0, is_ambiguous=False)
        for one in echoes
    ]
    one = judged(bus.recording, transactions(told, [*told_transactions(told), *extra]))
    assert one.sure_wrong == 2


def test_a_response_called_an_echo_is_false(bus: Bus) -> None:
    answered(bus, 1, WRITE, WRITE)
    request, response = bus.recording.sent
    told = Told(
        [ToldFrame(request.offset, request.raw, Direction.REQUEST, 1.0)], [], [response.offset]
    )
    one = judged(bus.recording, told)
    assert (one.frames_found, one.frames_false) == (1, 1)


def test_a_direction_told_wrongly_counts_by_its_confidence(bus: Bus) -> None:
    answered(bus, 1, READ, VALUES)
    told = truth(bus.recording)
    first, second = told.frames
    told.frames = [
        replace(first, direction=Direction.RESPONSE, confidence=0.95),
        replace(second, direction=Direction.REQUEST, confidence=0.85),
    ]
    one = judged(bus.recording, told)
    assert (one.sure, one.sure_amiss, one.likely, one.likely_amiss) == (1, 1, 1, 1)
