from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.decode.master_habits import (
    FIRST_LATE_NS,
    FORGOTTEN,
    MIN_LATE_NS,
    MasterHabits,
)
from mbtool.decode.open_requests import OpenRequest
from tests.decode.test_pairing import asked

IDS = st.lists(st.one_of(st.integers(0, 3), st.integers(0, 0xFFFF)), min_size=1, max_size=12)
COUNTED = st.tuples(st.integers(0, 0xFFFF), st.integers(1, 12)).map(
    lambda one: [one[0] + step & 0xFFFF for step in range(one[1])]
)


def one_by_one(before: list[int], ids: list[int]) -> MasterHabits:
    habits = MasterHabits()
    for number, transaction_id in enumerate((*before, *ids), 1):
        habits.note_request(transaction_id, others_wait=False)
        habits.has_matching_ids |= habits.ids_vary
        habits.note_answered(number)
        habits.last_response_ns = number
    return habits


@given(before=st.one_of(st.just([]), IDS, COUNTED), ids=st.one_of(IDS, COUNTED))
def test_a_plain_stretch_is_noted_as_its_requests_one_by_one(
    before: list[int], ids: list[int]
) -> None:
    habits = one_by_one(before, [])
    number = len(before) + len(ids)
    habits.note_plain(ids, number, number)
    assert vars(habits) == vars(one_by_one(before, ids))


@given(
    before=st.lists(st.integers(0, 1 << 40), max_size=2),
    latencies=st.lists(st.one_of(st.integers(0, 50), st.integers(0, 1 << 62)), min_size=1),
    later=st.sampled_from([0, 1, FORGOTTEN - 1, FORGOTTEN, FORGOTTEN + 1]),
)
def test_latencies_are_noted_together_as_one_by_one(
    before: list[int], latencies: list[int], later: int
) -> None:
    habits, expected = MasterHabits(), MasterHabits()
    for one in before:
        habits.note_latency(3, one)
        expected.note_latency(3, one)
    for one in (*latencies, *[7] * later):
        expected.note_latency(3, one)
    habits.note_latencies(3, [*latencies, *[7] * later])
    assert vars(habits) == vars(expected)


MS = 1_000_000


def with_latencies(*latencies_ns: int, function: int = 3) -> MasterHabits:
    habits = MasterHabits()
    for one in latencies_ns:
        habits.note_latency(function, one)
    return habits


def sequential(habits: MasterHabits) -> MasterHabits:
    for _ in range(8):
        habits.note_request(None, others_wait=False)
    return habits


def waits(habits: MasterHabits, function: int | None) -> tuple[int, int, int]:
    """The three waits (ns): late, silence, slow."""
    return habits.late_ns(function), habits.silence_ns(function), habits.slow_ns(function)


@pytest.mark.parametrize(
    ("latencies_ns", "expected"),
    [
        ([], (FIRST_LATE_NS, FIRST_LATE_NS, FIRST_LATE_NS)),
        ([MS], (MIN_LATE_NS, MIN_LATE_NS, MIN_LATE_NS)),
        ([40 * MS], (60 * MS, 120 * MS, 60 * MS)),
        # Slower than usual: three times the mean of 20 ms and a bit, not 1.5 of the slowest.
        ([20 * MS] * 9 + [200 * MS], (300 * MS, 600 * MS, 67_500_000)),
    ],
)
def test_the_waits_follow_from_the_latencies(
    latencies_ns: list[int], expected: tuple[int, int, int]
) -> None:
    habits = with_latencies(*latencies_ns)
    assert waits(habits, 3) == expected
    # Of another function only the longest latency is known.
    late_ns, silence_ns, _ = expected
    assert waits(habits, 4) == waits(habits, None) == (late_ns, silence_ns, late_ns)


def test_an_unknown_function_takes_as_long_as_the_slowest_one() -> None:
    habits = with_latencies(40 * MS)
    habits.note_latency(4, 400 * MS)
    assert (habits.late_ns(3), habits.late_ns(4), habits.late_ns(6)) == (
        60 * MS,
        600 * MS,
        600 * MS,
    )
    assert habits.longest_ns == 400 * MS


def test_a_master_that_never_pipelines_gives_up_after_the_longest_latency() -> None:
    assert sequential(with_latencies(40 * MS)).late_ns(3) == 40 * MS
    assert sequential(with_latencies(MS)).late_ns(3) == MS
    assert sequential(with_latencies(40 * MS)).silence_ns(3) == 120 * MS
    assert sequential(MasterHabits()).late_ns(3) == FIRST_LATE_NS


@pytest.mark.parametrize(
    ("latencies_ns", "late_ns"),
    [
        ([100 * MS, 10 * MS], 95 * MS),
        ([100 * MS, 10 * MS, 10 * MS], 90_250_000),
        ([100 * MS, 96 * MS], 96 * MS),
        ([19, 1], 19),
    ],
)
def test_each_response_lowers_the_longest_latency_a_little(
    latencies_ns: list[int], late_ns: int
) -> None:
    assert sequential(with_latencies(*latencies_ns)).late_ns(3) == late_ns


@pytest.mark.parametrize(
    ("latency_ns", "is_early"), [(-1, False), (0, True), (19, True), (20, False), (40, False)]
)
def test_a_response_is_too_early_in_less_than_half_the_shortest_latency(
    latency_ns: int, is_early: bool
) -> None:
    assert with_latencies(90, 40, 50).is_too_early(3, latency_ns) is is_early
    assert not with_latencies(90, 40, 50).is_too_early(4, latency_ns)


def said_of(habits: MasterHabits) -> tuple[bool, bool]:
    return habits.is_sequential, habits.pipelines


def test_a_master_is_sequential_after_eight_requests_in_a_row() -> None:
    habits = MasterHabits()
    for others_wait in (*[False] * 7, True, *[False] * 7):
        habits.note_request(None, others_wait=others_wait)
        assert said_of(habits) == (False, False)
    habits.note_request(None, others_wait=False)
    assert said_of(habits) == (True, False)


def test_a_master_pipelines_after_three_overlaps_without_such_a_row_between_them() -> None:
    habits = sequential(MasterHabits())
    for overlaps in (2, 2):
        for _ in range(overlaps):
            habits.note_overlap()
        assert said_of(habits) == (True, False)
        sequential(habits)
    for _ in range(3):
        habits.note_overlap()
    assert said_of(habits) == (False, True)
    assert said_of(sequential(habits)) == (True, False)


@pytest.mark.parametrize(
    ("ids", "vary", "count_up"),
    [
        ([7], False, False),
        ([7, 7], False, False),
        ([7, 8], True, True),
        ([7, 8, 8, 9], True, True),
        ([7, 9], True, True),
        ([0xFFFF, 0, 1], True, True),
        ([0, 0x7FFF], True, True),
        ([0, 0x8000], True, False),
        ([8, 7], True, False),
        ([7, 8, 7], True, False),
        ([8, 7, 8, 9], True, False),
        ([0, 5, 0, 5], True, False),
    ],
)
def test_ids_vary_and_count_up(ids: list[int], vary: bool, count_up: bool) -> None:
    habits = MasterHabits()
    for one in ids:
        habits.note_request(one, others_wait=False)
        habits.note_request(None, others_wait=False)
    assert (habits.ids_vary, habits.ids_count_up) == (vary, count_up)
    last = ids[-1]
    for step in (-1, 0, 1, 2):
        assert habits.repeats_id((last + step) & 0xFFFF) is (count_up and step == 1)
    assert not habits.repeats_id(None)
    assert not MasterHabits().repeats_id(1)


def test_a_slave_reorders_if_it_answers_a_request_after_a_later_one() -> None:
    habits = MasterHabits()
    for number in (1, 1, 2, 5):
        habits.note_answered(number)
        assert not habits.reorders
    habits.note_answered(4)
    habits.note_answered(6)
    assert habits.reorders


def waiting(*ids: int | None) -> list[OpenRequest]:
    """Requests with these ids; None for one that the capture lacks."""
    return [
        OpenRequest(
            number=at, since_ns=0, adu=None if one is None else asked("03 0000 0001", at, one)
        )
        for at, one in enumerate(ids, 1)
    ]


@pytest.mark.parametrize(
    ("before", "ids", "own"),
    [
        ([], [1, 2, 3], [False, False, False]),
        ([1, 2], [3, 4, 4], [True, True, True]),  # Ids count up.
        ([2, 1], [3, 4, 3], [False, False, False]),
        ([2, 1], [3, 4, 5], [False, False, True]),  # Only the last one has an id that is new.
        ([2, 1], [3, None, 5], [False, False, True]),
    ],
)
def test_a_request_has_an_id_of_its_own(
    before: list[int], ids: list[int | None], own: list[bool]
) -> None:
    habits = MasterHabits()
    for one in before:
        habits.note_request(one, others_wait=False)
    requests = waiting(*ids)
    assert [habits.has_own_id(one, requests) for one in requests] == own
    if not habits.ids_count_up:
        assert not habits.has_own_id(requests[-1], [])
