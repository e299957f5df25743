"""The ways to join requests and responses of a connection, and what each costs."""

from __future__ import annotations

from typing import Any

import pytest

from mbtool.decode.giving_up import give_up_late, give_up_lost, give_up_repeated
from mbtool.decode.master_habits import MasterHabits
from mbtool.decode.open_requests import OpenRequest
from mbtool.decode.pairing_readings import (
    LATE,
    MARGIN,
    MAX_READINGS,
    MISFIT,
    NOT_LIKELY,
    OTHER_ID,
    OUT_OF_ORDER,
    TOO_EARLY,
    TOO_SLOW,
    UNANSWERED,
    UNASKED,
    UNLIKELY,
    PairOption,
    PairReading,
    PairStep,
    likely_cost,
    lost_runs,
    may_be_among,
    options,
    without_costly,
)
from mbtool.decode.stream_progress import AduPlace
from tests.decode.test_pairing import MS, asked, told

ONE, TWO = "03 0000 0001", "03 0000 0002"
"""Reads of one and of two registers; their responses have 11 and 13 bytes."""
VALUE, VALUES = "03 02 0007", "03 04 0001 0002"


def request(number: int, pdu: str | None = ONE, id_: int = 3, **more: Any) -> OpenRequest:
    """A request at 10 ms times its number; None for one that the capture lacks."""
    adu = None if pdu is None else asked(pdu, 10 * number, id_)
    since_ns = 10 * number * MS if adu is None else adu.end_ns
    return OpenRequest(number=number, since_ns=since_ns, adu=adu, **more)


def reading(*waiting: OpenRequest, given_up: tuple[int, ...] = ()) -> PairReading:
    return PairReading([*waiting], [], given_up=frozenset(given_up))


def known(latency_ms: int = 5, *ids: int) -> MasterHabits:
    habits = MasterHabits()
    habits.note_latency(3, latency_ms * MS)
    for one in ids:
        habits.note_request(one, others_wait=False)
    return habits


def costs(
    of: PairReading, response: str = VALUE, at_ms: int = 100, habits: MasterHabits | None = None
) -> dict[int, float]:
    """By the number of each request that a response may answer: the cost."""
    found = options(of, told(response, at_ms, 3), None, habits or MasterHabits())
    return {option.request.number: option.cost for option in found if option.request is not None}


@pytest.mark.parametrize(
    ("of", "expected"),
    [
        (reading(request(1)), {1: 0.0}),
        (reading(request(1, id_=4)), {}),
        (reading(request(1, TWO)), {1: MISFIT}),
        (reading(request(1), request(2)), {1: 0.0, 2: UNANSWERED}),
        (reading(request(1), request(2), given_up=(1,)), {1: 0.0, 2: UNANSWERED - LATE}),
        (reading(request(1, may_be_lost=True), request(2)), {1: 0.0, 2: 0.0}),
        (reading(request(1, may_not_exist=True), request(2)), {1: 0.0, 2: 0.0}),
        (reading(request(1, None), request(2)), {1: OTHER_ID * 0, 2: UNANSWERED}),
        (reading(request(1, None, may_not_exist=True), request(2)), {1: NOT_LIKELY, 2: 0.0}),
        # Once it costs too much to pass the earlier ones, nobody asks for the later ones.
        (reading(request(1), request(2), request(3)), {1: 0.0, 2: UNANSWERED}),
    ],
)
def test_a_response_costs_what_speaks_against_its_request(
    of: PairReading, expected: dict[int, float]
) -> None:
    assert costs(of) == pytest.approx(expected)


def test_requests_behind_an_answered_one_cost_extra() -> None:
    of = reading()
    of.passed.append(request(1))
    assert costs(of) == {1: OUT_OF_ORDER}
    of.waiting.append(request(2))
    assert costs(of) == {2: 0.0}  # So much dearer ones are not looked at.


def test_a_request_that_the_capture_lacks_is_not_preferred_to_one_with_this_id() -> None:
    habits = known(5, 1, 2, 3)  # Ids count up.
    assert costs(reading(request(1, None), request(2)), habits=habits)[1] == OTHER_ID
    repeated = reading(request(1, None), request(2, repeats_lost_id=True))
    assert costs(repeated, habits=habits)[1] == 0.0
    earlier = reading(request(1), request(2, None), given_up=(1,))
    assert costs(earlier, habits=habits)[2] == pytest.approx(UNANSWERED - LATE)
    still = reading(request(1), request(2, None))
    assert costs(still, habits=habits)[2] == pytest.approx(UNANSWERED + OTHER_ID)


@pytest.mark.parametrize(
    ("at_ms", "cost"),
    [(13, TOO_EARLY), (14, 0.0), (41, 0.0), (42, TOO_SLOW)],
)
def test_a_response_that_is_too_early_or_too_slow_costs_extra(at_ms: int, cost: float) -> None:
    """The request ends at 11 ms; responses took 6 ms so far, and 30 ms are not slow."""
    assert costs(reading(request(1)), at_ms=at_ms, habits=known(6)) == {1: cost}
    late = reading(request(1), given_up=(1,))
    assert costs(late, at_ms=at_ms, habits=known(6)) == {1: cost if cost != TOO_SLOW else 0.0}


def test_a_response_is_slow_from_the_response_before_it_on() -> None:
    habits = known(6)
    habits.last_response_ns = 20 * MS
    assert costs(reading(request(1)), at_ms=50, habits=habits) == {1: 0.0}
    assert costs(reading(request(1)), at_ms=51, habits=habits) == {1: TOO_SLOW}


@pytest.mark.parametrize("late", [3, 4, 5, 7])
def test_so_many_given_up_requests_may_still_get_a_response(late: int) -> None:
    numbers = range(1, late + 2)
    of = reading(*(request(number) for number in numbers), given_up=tuple(numbers[:-1]))
    found = costs(of)
    assert [*found] == [*numbers][-5:]
    assert found[late + 1] == pytest.approx(min(late, 4) * (UNANSWERED - LATE))


def test_acknowledgements_rule_requests_out() -> None:
    one, two = request(1), request(2)
    one.place, two.place = AduPlace(12, 0), AduPlace(24, 0)
    response = told(VALUE, 100, 3)
    found = [*options(reading(one, two), response, AduPlace(11, 12), MasterHabits())]
    assert [option.request for option in found] == [one]


@pytest.mark.parametrize(
    ("lost", "runs"),
    [
        (11, [(0, 1), (2, 1)]),
        (9, [(0, 1), (1, 1), (2, 1)]),  # An exception.
        (13, [(1, 1)]),
        (24, [(0, 2), (1, 2)]),
        (35, [(0, 3)]),
        (10, []),
    ],
)
def test_lost_bytes_are_the_responses_of_some_requests_in_a_row(
    lost: int, runs: list[tuple[int, int]]
) -> None:
    found = [*lost_runs(reading(request(1), request(2, TWO), request(3)), lost)]
    assert [run[1:] for run in found] == runs
    # Each request before them stays without a response.
    assert [run[0] for run in found] == pytest.approx([start * UNANSWERED for start, _ in runs])


def test_the_response_of_a_request_that_the_capture_lacks_has_any_size_from_the_smallest_on() -> (
    None
):
    of = reading(request(1, None))
    assert [*lost_runs(of, 8)] == []
    for lost in (9, 200):
        assert [*lost_runs(of, lost)] == [(0.0, 0, 1)]
    of = reading(request(1, None), request(2))
    assert [*lost_runs(of, 19)] == [(0.0, 0, 1), (0.0, 0, 2)]


@pytest.mark.parametrize(("count", "found"), [(8, 1), (9, 0)])
def test_lost_bytes_are_at_most_so_many_responses(count: int, found: int) -> None:
    of = reading(*(request(number) for number in range(1, count + 1)))
    of.given_up = set(range(1, count + 1))
    assert [run[1:] for run in lost_runs(of, 11 * count)] == [(0, count)] * found


def test_lost_bytes_are_not_looked_for_behind_too_many_unanswered_requests() -> None:
    of = reading(*(request(number) for number in range(1, 20)))
    starts = [start for _, start, _ in lost_runs(of, 11)]
    assert starts == [*range(int(UNASKED / UNANSWERED) + 1)]


@pytest.mark.parametrize(
    ("lost", "may"), [(11, True), (24, True), (22, True), (13, False), (12, False)]
)
def test_a_response_may_be_among_lost_bytes(lost: int, may: bool) -> None:
    waiting = [request(1), request(2, TWO)]
    assert may_be_among(lost, waiting[0], waiting) is may
    assert may_be_among(lost, waiting[0], [*waiting, request(3, None)])
    many = [request(number) for number in range(1, 10)]
    assert may_be_among(lost, many[0], many)
    unknown = request(3, "41 00")
    assert may_be_among(lost, unknown, [unknown])


def costing(cost: float, *numbers: int, steps: tuple[PairStep, ...] = ()) -> PairReading:
    return PairReading([request(number) for number in numbers], [], steps=steps, cost=cost)


def test_costly_readings_are_dropped() -> None:
    cheap, edge, dear = costing(1.0, 1), costing(1.0 + MARGIN, 2), costing(1.01 + MARGIN, 3)
    assert without_costly([dear, edge, cheap]) == [cheap, edge]
    many = [costing(number / 100, number) for number in range(MAX_READINGS + 1)]
    assert without_costly(many) == many[:-1]


def test_of_readings_with_equal_requests_one_is_kept_and_in_doubt_where_they_differ() -> None:
    one, two = request(1), request(2)
    same, answer = (told(VALUE, at, 3) for at in (90, 95))
    first = costing(0.0, 7, steps=(PairStep(1, same, (one,)), PairStep(2, answer, (one,))))
    second = costing(0.5, 7, steps=(PairStep(1, same, (one,)), PairStep(2, answer, (two,))))
    (kept,) = without_costly([second, first])
    assert kept is first
    assert [step.is_sure for step in kept.steps] == [True, False]
    assert not one.may_be_lost
    lost = [costing(0.0, 7, steps=(PairStep(1, None, (each,)),)) for each in (one, two)]
    assert len(without_costly(lost)) == 1
    assert (one.may_be_lost, two.may_be_lost) == (True, True)


def test_late_responses_count_extra_between_good_readings() -> None:
    late = costing(1.0, 1, steps=(PairStep(1, None, (), is_late=True), PairStep(1, None, ())))
    assert likely_cost(late) == 1.0 + UNLIKELY


def test_a_response_is_taken_by_its_request_and_those_before_it_are_passed() -> None:
    one, two, three = (request(number) for number in (1, 2, 3))
    of = reading(one, two, three, given_up=(1,))
    of.take(PairOption(0.5, two), told(VALUE, 100, 3), MasterHabits(), 77)
    assert (of.waiting, of.passed, of.newest, of.cost) == ([three], [one], 2, 0.5)
    (step,) = of.steps
    assert (step.requests, step.since_ns, step.at_ns) == ((two,), 77, 101 * MS)
    assert (step.is_late, step.is_sure) == (False, True)
    of.take(PairOption(0.5, one), told(VALUE, 110, 3), MasterHabits(), 78)
    assert (of.passed, of.newest, of.cost, of.steps[-1].is_late) == ([], 2, 1.0, True)
    of.take(PairOption(UNASKED, None), told(VALUE, 120, 3), MasterHabits(), 79)
    assert (of.steps[-1].requests, of.steps[-1].since_ns) == ((), 79)


def test_requests_with_other_ids_are_not_passed_over_unless_the_master_is_sequential() -> None:
    for is_sequential in (False, True):
        habits = MasterHabits()
        habits.is_sequential = is_sequential
        one, two = request(1, id_=4), request(2)
        of = reading(one, two)
        of.take(PairOption(0.0, two), told(VALUE, 100, 3), habits, 0)
        assert (of.waiting, of.passed) == (([], [one]) if is_sequential else ([one], []))


def test_lost_responses_leave_the_requests_behind_them() -> None:
    one, two, three, four = (
        request(number, None if number == 1 else ONE) for number in range(1, 5)
    )
    of = reading(one, two, three, four)
    of.suppose_lost_responses(2, 1, 0.25, 99)
    assert (of.waiting, of.passed, of.cost) == ([four], [two], 0.25)
    assert of.steps == (PairStep(99, None, (three,)),)
    # Nobody knows how many responses are those of requests that the capture lacks.
    first, second = request(1, None), request(2, None, exists=False)
    of = reading(first, second, request(3))
    of.suppose_lost_responses(0, 1, 0.0, 99)
    assert [one.may_not_exist for one in of.waiting] == [True, False]
    of = reading(request(1), second := request(2, None, exists=False))
    of.suppose_lost_responses(0, 1, 0.0, 99)
    assert not second.may_not_exist


AFTER_NS = 50 * MS


def given_up(of: PairReading, now_ms: float, habits: MasterHabits | None = None) -> set[int]:
    give_up_late([of], habits or MasterHabits(), int(now_ms * MS), lambda _: AFTER_NS)
    return of.given_up


def test_a_request_is_given_up_after_it_has_waited_longer_than_the_slowest_response() -> None:
    of = reading(request(1))
    assert given_up(of, 61) == frozenset()
    for now_ms in (62, 90):
        assert given_up(of, now_ms) == {1}
        assert (of.cost, of.gave_up_ns) == (LATE, 62 * MS)
    assert not of.someone_waits


def test_a_request_waits_from_the_last_response_on_unless_a_later_one_was_answered() -> None:
    habits = MasterHabits()
    habits.last_response_ns = 100 * MS
    of = reading(request(2))
    assert given_up(of, 150, habits) == frozenset()
    assert given_up(of, 151, habits) == {2}
    of = reading(request(2))
    of.newest = 2
    assert given_up(of, 71, habits) == frozenset()
    assert given_up(of, 72, habits) == {2}


@pytest.mark.parametrize(("is_pipelined", "expected"), [(False, {1}), (True, {1})])
def test_only_the_first_late_request_is_given_up_of_those_behind_each_other(
    is_pipelined: bool, expected: set[int]
) -> None:
    of = reading(request(1), request(2, is_pipelined=is_pipelined))
    of.behind_others = {2}
    assert given_up(of, 200) == expected
    # One that was sent while others waited waits from then on when those were given up.
    assert given_up(of, 250) == expected
    assert given_up(of, 251) == (expected if is_pipelined else {1, 2})
    apart = reading(request(1), request(2))
    assert given_up(apart, 200) == {1, 2}


def test_requests_that_may_be_lost_or_may_not_exist_cost_nothing_when_they_are_given_up() -> None:
    of = reading(request(1, may_be_lost=True), request(2, may_not_exist=True))
    assert given_up(of, 200) == {1}
    assert (of.cost, of.gave_up_ns) == (0, 200 * MS)
    assert not of.someone_waits


@pytest.mark.parametrize(
    ("after_ms", "pdu", "is_given_up"),
    [(30, ONE, True), (29, ONE, False), (30, TWO, False)],
)
def test_a_request_that_is_sent_again_was_given_up(
    after_ms: int, pdu: str, is_given_up: bool
) -> None:
    of = reading(request(1))
    again = asked(pdu, 11 + after_ms, 3)
    give_up_repeated([of], MasterHabits(), again)
    assert (1 in of.given_up) is is_given_up
    for other in (reading(request(1), request(2)), reading(request(1, None)), reading()):
        give_up_repeated([other], MasterHabits(), again)
        assert not other.given_up
    behind = reading(request(1))
    behind.behind_others = {1}
    give_up_repeated([behind], MasterHabits(), again)
    assert not behind.given_up


@pytest.mark.parametrize("field", ["last_response_ns", "lost_response_ns"])
def test_a_master_that_has_a_response_does_not_give_up_what_it_asks_again(field: str) -> None:
    again, habits = asked(ONE, 60, 3), known()
    for at_ms, is_given_up in ((9, True), (30, False)):
        of = reading(request(1))
        setattr(habits, field, at_ms * MS)
        give_up_repeated([of], habits, again)
        assert (1 in of.given_up) is is_given_up


def test_a_wait_counts_from_a_response_that_the_capture_lacks() -> None:
    habits = known()
    assert costs(reading(request(1)), VALUE, 100, habits) == {1: TOO_SLOW}
    habits.lost_response_ns = 90 * MS
    assert costs(reading(request(1)), VALUE, 100, habits) == {1: 0.0}


@pytest.mark.parametrize("is_sequential", [False, True])
@pytest.mark.parametrize("exists", [False, True])
@pytest.mark.parametrize("place", [None, AduPlace(12, None)])
def test_the_next_request_gives_up_those_that_the_capture_lacks(
    is_sequential: bool, exists: bool, place: AduPlace | None
) -> None:
    lost = request(1, None, exists=exists)
    lost.place = place
    of = reading(lost, request(2))
    give_up_lost([of], is_sequential=is_sequential)
    assert lost.may_not_exist is (place is None or (is_sequential and not exists))
    assert of.given_up == ({1} if is_sequential and not lost.may_not_exist else frozenset())
