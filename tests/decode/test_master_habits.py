from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.decode.master_habits import FORGOTTEN, MasterHabits

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
