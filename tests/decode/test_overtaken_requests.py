"""Requests of a serial line that another request overtakes, and when they are given up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from mbtool.core import EventKind, WireEvent
from mbtool.decode.pairing import (
    BUS_TIMEOUT_NS,
    EVEN_ODDS,
    MAX_OF_UNIT,
    MAX_OPEN,
    Pairing,
    waits_before_any_retry,
)
from mbtool.decode.transactions import Ends
from mbtool.modbus.adu import Adu, Skipped, Verdict
from mbtool.modbus.transaction import Outcome, Transaction
from mbtool.serial_line.line_statistics import LatencyStatistics
from tests.decode.test_pairing import ANSWER, MS, READ, WRITE, asked, outcomes, told

if TYPE_CHECKING:
    from collections.abc import Callable

OK, NO_ANSWER, UNSOLICITED = Outcome.OK, Outcome.NO_ANSWER, Outcome.UNSOLICITED
LATE = Outcome.LATE
SURE: tuple[list[Verdict], float] = ([], 1.0)
IN_DOUBT = [Verdict.AMBIGUOUS], EVEN_ODDS
READ_OTHER, OTHER_ANSWER = "03 0007 0001", "03 02 0777"
READ_FOUR = "03 0000 0004"
FOUR_VALUES = "03 08 0001 0002 0003 0004"

Said = list[Transaction | WireEvent]


def line(waits: bool | None) -> Pairing:
    """A line on which a master certainly waits, does not wait any more, or may do either."""
    return Pairing(Ends("rs485"), lambda _: waits)


def overtake(pairing: Pairing, at_ms: int) -> Said:
    """A request to unit 1, one to unit 2, and then the responses of both in that order."""
    adus = (
        asked(READ, at_ms),
        asked(WRITE, at_ms + 5, unit=2),
        told(ANSWER, at_ms + 10),
        told(WRITE, at_ms + 15, unit=2),
    )
    return [each for one in adus for each in pairing.feed(one)]


def transactions(said: Said) -> list[Transaction]:
    return [one for one in said if isinstance(one, Transaction)]


def rows(said: Said) -> list[tuple[int, Outcome, tuple[list[Verdict], float]]]:
    return [(one.unit, one.outcome, (one.verdicts, one.confidence)) for one in transactions(said)]


@pytest.mark.parametrize(
    ("waits", "outcome", "doubt"), [(True, OK, SURE), (None, LATE, IN_DOUBT), (False, LATE, SURE)]
)
def test_a_response_behind_another_request_is_late_unless_its_master_surely_waits(
    waits: bool | None, outcome: Outcome, doubt: object
) -> None:
    assert rows(overtake(line(waits), 0)) == [(1, outcome, doubt), (2, OK, SURE)]


def test_responses_behind_equal_waits_are_surely_late() -> None:
    pairing = line(None)
    done: Said = []
    for at in range(4):
        at_ms = 2000 * at
        done += said(pairing, asked(READ, at_ms), asked(WRITE, at_ms + 500 + at, unit=2))
        done += said(pairing, told(ANSWER, at_ms + 700), told(WRITE, at_ms + 710, unit=2))
    assert [doubt for unit, _, doubt in rows(done) if unit == 1] == [IN_DOUBT, IN_DOUBT, SURE, SURE]
    assert {outcome for unit, outcome, _ in rows(done) if unit == 1} == {LATE}


def test_a_late_response_keeps_the_doubt_about_its_request() -> None:
    pairing = line(None)
    doubtful = replace(asked(READ, 0), confidence=0.25, verdicts=(Verdict.AMBIGUOUS,))
    said = [*pairing.feed(doubtful), *pairing.feed(asked(WRITE, 5, unit=2))]
    said += pairing.feed(told(ANSWER, 10))
    assert rows(said) == [(1, LATE, ([Verdict.AMBIGUOUS], 0.25))]


@pytest.mark.parametrize("waits", [True, None])
def test_two_masters_are_told_once_when_three_requests_were_overtaken(waits: bool | None) -> None:
    pairing = line(waits)
    before = [overtake(pairing, 100 * at) for at in range(2)]
    assert not any(isinstance(one, WireEvent) for said in before for one in said)
    said = overtake(pairing, 1000)
    (event,) = [one for one in said if isinstance(one, WireEvent)]
    assert (event.kind, event.link, event.ts_ns) == (EventKind.TWO_MASTERS, "rs485", 1010 * MS)
    # From now on it is sure that both masters wait.
    later = overtake(pairing, 1100)
    assert rows(said) == rows(later) == [(1, OK, SURE), (2, OK, SURE)]
    assert not any(isinstance(one, WireEvent) for one in later)


@pytest.mark.parametrize(("too_many", "events"), [(0, 1), (1, 0)])
def test_two_masters_are_told_if_three_of_the_last_hundred_requests_were_overtaken(
    too_many: int, events: int
) -> None:
    pairing = line(True)
    said = overtake(pairing, 0)
    said += overtake(pairing, 100)
    # From the first response to the last one: two requests overtaken with their overtakers.
    for at in range(100 - 1 - 4 + too_many):
        said += [
            *pairing.feed(asked(READ, 1000 + 100 * at)),
            *pairing.feed(told(ANSWER, 1005 + 100 * at)),
        ]
    said += overtake(pairing, 100_000)
    assert sum(isinstance(one, WireEvent) for one in said) == events


def test_overtaken_and_overtaking_request_are_given_up_each_in_its_time() -> None:
    pairing = line(True)
    assert not [*pairing.feed(asked(READ, 0)), *pairing.feed(asked(WRITE, 5, unit=2))]
    assert pairing.advance(MS + BUS_TIMEOUT_NS) == []
    assert rows([*pairing.advance(MS + BUS_TIMEOUT_NS + 1)]) == [(1, NO_ANSWER, SURE)]
    assert pairing.advance(6 * MS + BUS_TIMEOUT_NS) == []
    assert rows([*pairing.advance(6 * MS + BUS_TIMEOUT_NS + 1)]) == [(2, NO_ANSWER, SURE)]
    assert pairing.close() == []


def test_a_third_request_leaves_the_first_open_until_its_unit_answers_a_later_one() -> None:
    pairing = line(True)
    for unit in (1, 2):
        assert pairing.feed(asked(READ, 5 * unit, unit=unit)) == []
    assert pairing.feed(asked(READ, 15, unit=3)) == []
    assert rows(pairing.feed(told(ANSWER, 20, unit=2))) == [(2, OK, SURE)]
    assert rows(pairing.feed(told(ANSWER, 25, unit=2))) == [(2, UNSOLICITED, SURE)]
    assert rows([*pairing.close()]) == [(1, NO_ANSWER, SURE), (3, NO_ANSWER, SURE)]


def poll(pairing: Pairing, taken_ms: int, number: int = 4) -> None:
    """Let unit 1 answer `number` reads of one register, each after `taken_ms`."""
    for at in range(number):
        at_ms = 1000 * at - 1000 * number
        assert rows(said(pairing, asked(READ, at_ms), told(ANSWER, at_ms + 1 + taken_ms)))


def said(pairing: Pairing, *adus: Adu) -> Said:
    return [each for one in adus for each in pairing.feed(one)]


def latencies(said: Said) -> list[tuple[Outcome, int | None]]:
    """The outcome and the latency in ms of each transaction."""
    return [
        (one.outcome, None if one.latency_ns is None else one.latency_ns // MS)
        for one in transactions(said)
    ]


def test_a_late_response_goes_to_the_request_that_it_fits() -> None:
    done = said(line(False), asked(READ_FOUR, 0), asked(READ, 500), told(FOUR_VALUES, 701))
    assert latencies(done) == [(LATE, 700)]


def test_a_response_that_fits_no_open_request_is_the_pending_ones_and_malformed() -> None:
    done = said(line(False), asked(READ_FOUR, 0), asked(READ, 500), told("03 04 0001 0002", 701))
    assert [one[1] for one in rows(done)] == [NO_ANSWER, Outcome.MALFORMED]


def test_a_response_sooner_than_the_unit_can_answer_is_to_the_request_before() -> None:
    pairing = line(False)
    poll(pairing, 450)
    done = said(pairing, asked(READ, 0), asked(READ, 500), told(ANSWER, 601), told(ANSWER, 1051))
    assert latencies(done) == [(LATE, 600), (LATE, 550)]


def test_a_second_answer_shows_that_both_belong_to_the_request_before() -> None:
    pairing = line(False)
    poll(pairing, 450)
    done = said(pairing, asked(READ, 0), asked(READ, 500), told(ANSWER, 781))
    assert done == []  # 780 or 280 ms: both are possible.
    done += said(pairing, told(ANSWER, 1281))
    assert latencies(done) == [(LATE, 780), (LATE, 780)]


def test_the_answers_of_a_unit_that_is_always_late_are_moved_together() -> None:
    pairing = line(False)
    polls = [(asked(READ, 500 * at), told(ANSWER, 500 * at + 251)) for at in range(1, 4)]
    done = said(pairing, asked(READ, 0), *(one for each in polls for one in each))
    assert done == []
    done += said(pairing, told(ANSWER, 2251))
    assert latencies(done) == [(LATE, 750)] * 4


def untimed() -> Pairing:
    """A line whose times are not known: each frame begins where the one before ends."""
    return Pairing(Ends("rs485", timed=False), lambda _: None)


def hidden() -> Pairing:
    """A line of an adapter that hides all silences."""
    return line(None)


@pytest.mark.parametrize("kind", [untimed, hidden])
def test_without_silences_a_second_answer_shows_that_both_are_late(
    kind: Callable[[], Pairing],
) -> None:
    pairing = kind()
    done = said(pairing, asked(READ, 0), asked(READ_OTHER, 8), told(ANSWER, 16))
    assert done == []
    done += said(pairing, told(OTHER_ANSWER, 23))
    assert [(one.address, one.response_values, one.outcome) for one in transactions(done)] == [
        (0x6B, [0x022B], LATE), (7, [0x0777], LATE),
    ]  # fmt: skip


@pytest.mark.parametrize("kind", [untimed, hidden])
@pytest.mark.parametrize("unit", [1, 2])
def test_without_silences_the_next_request_shows_that_the_response_was_its_own(
    unit: int, kind: Callable[[], Pairing]
) -> None:
    pairing = kind()
    done = said(pairing, asked(READ, 0), asked(READ_OTHER, 8), told(ANSWER, 16))
    done += said(pairing, asked(READ, 23, unit=unit))
    assert [one[1] for one in rows(done)] == [NO_ANSWER, OK]


@pytest.mark.parametrize("kind", [untimed, hidden])
def test_without_silences_an_equal_response_may_be_a_copy_or_a_second_answer(
    kind: Callable[[], Pairing],
) -> None:
    frames = asked(READ, 0), asked(READ_OTHER, 8), told(ANSWER, 16), told(ANSWER, 23)
    done = said(kind(), *frames)
    assert [one[1] for one in rows(done)] == [NO_ANSWER, OK, UNSOLICITED]
    assert [one[2] for one in rows(done)[1:]] == [IN_DOUBT, IN_DOUBT]


@pytest.mark.parametrize("kind", [untimed, hidden, lambda: line(False)])
def test_a_response_behind_damaged_bytes_is_no_second_answer(kind: Callable[[], Pairing]) -> None:
    pairing = kind()
    done = said(pairing, asked(READ, 0), asked(READ_OTHER, 500), told(ANSWER, 781))
    done += pairing.note_skipped(Skipped(790 * MS, EventKind.BAD_CHECK, "a wrong CRC", bytes(8)))
    done += said(pairing, told(OTHER_ANSWER, 1281))
    assert [one[1] for one in rows(done)] == [NO_ANSWER, OK, UNSOLICITED]


def test_without_a_second_answer_each_response_stays_with_its_own_request() -> None:
    pairing = line(False)
    poll(pairing, 450)
    done = said(pairing, asked(READ, 0), asked(READ, 500), told(ANSWER, 781))
    done += pairing.advance(782 * MS + 2 * 781 * MS)
    assert latencies(done) == [(NO_ANSWER, None), (OK, 280)]


def test_a_repeated_frame_is_no_second_answer() -> None:
    pairing = line(False)
    poll(pairing, 450)
    done = said(pairing, asked(READ, 0), asked(READ, 500), told(ANSWER, 781), told(ANSWER, 785))
    assert latencies(done) == [(NO_ANSWER, None), (OK, 280), (UNSOLICITED, None)]


def test_a_unit_that_answers_at_once_is_not_late_when_it_answers_a_retry() -> None:
    pairing = line(False)
    poll(pairing, 10)
    done = said(pairing, asked(READ, 0), asked(READ, 500), told(ANSWER, 511))
    assert latencies(done) == [(NO_ANSWER, None), (OK, 10)]


def test_a_response_right_behind_damaged_bytes_goes_to_no_earlier_request() -> None:
    pairing = line(False)
    done = said(pairing, asked(READ, 0), asked(WRITE, 500, unit=2))
    done += pairing.note_skipped(Skipped(600 * MS, EventKind.BAD_CHECK, "a wrong CRC", bytes(8)))
    done += said(pairing, told(ANSWER, 610))
    assert latencies(done) == [(UNSOLICITED, None)]


def test_a_unit_that_is_off_is_told_at_once_after_a_few_requests() -> None:
    pairing = line(False)
    for at in range(MAX_OF_UNIT + 1):
        assert pairing.feed(asked(READ, 300 * at)) == []
    done = pairing.feed(asked(READ, 2000))
    assert latencies(done) == [(NO_ANSWER, None)] * (MAX_OF_UNIT + 1)
    assert latencies(pairing.feed(asked(READ, 2300))) == [(NO_ANSWER, None)]


def test_the_number_of_open_requests_is_bounded() -> None:
    pairing = line(False)
    done = [
        each for unit in range(1, 248) for each in pairing.feed(asked(READ, 10 * unit, unit=unit))
    ]
    assert len(done) == 247 - 1 - MAX_OPEN
    assert len(pairing.close()) == MAX_OPEN + 1


def test_a_master_waits_at_least_as_long_as_before_any_retry() -> None:
    shortest_ns = LatencyStatistics.MIN_RETRY_NS
    assert waits_before_any_retry(shortest_ns - 1) is True
    assert waits_before_any_retry(shortest_ns) is False


@pytest.mark.parametrize("lived_ms", [0, 1])
def test_a_line_asks_how_long_the_overtaken_request_has_waited(lived_ms: int) -> None:
    waited: list[int] = []

    def still_waits(waited_ns: int) -> bool:
        waited.append(waited_ns)
        return True

    pairing = Pairing(Ends("rs485"), still_waits)
    pairing.feed(asked(READ, 10))
    pairing.feed(asked(WRITE, 11 + lived_ms, unit=2))
    assert waited == [lived_ms * MS]


@pytest.mark.parametrize(
    ("latency_ms", "allowed_ns"),
    [([2000, 20], 6000 * MS), ([20], 1000 * MS), ([], 1000 * MS)],
)
def test_at_the_end_of_a_capture_a_line_has_three_times_as_long_as_its_slowest_response(
    latency_ms: list[int], allowed_ns: int
) -> None:
    for waited_ns, outcome in ((allowed_ns - 1, Outcome.NOT_CAPTURED), (allowed_ns, NO_ANSWER)):
        pairing = line(True)
        at_ms = 0
        for one_ms in latency_ms:
            pairing.feed(asked(READ, at_ms))
            pairing.feed(told(ANSWER, at_ms + 1 + one_ms))
            at_ms += 10_000
        pairing.feed(asked(READ, at_ms))
        assert outcomes(pairing.close((at_ms + 1) * MS + waited_ns)) == [outcome]


def test_at_the_end_of_a_line_without_times_nobody_knows_how_long_a_request_waited() -> None:
    pairing = Pairing(Ends("rs485", timed=False))
    pairing.feed(asked(READ, 0))
    assert outcomes(pairing.close(BUS_TIMEOUT_NS)) == [Outcome.NOT_CAPTURED]
