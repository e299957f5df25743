"""Values by time, against a plain dictionary."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.replay.timeline import Timeline


def test_holds_each_value_until_the_next() -> None:
    timeline = Timeline()
    timeline.note(10, 7, [1, 2])
    timeline.note(20, 8, [3])
    assert timeline.at(7, 15) == (1, 0)
    assert timeline.at(8, 19) == (2, 0)
    assert timeline.at(8, 20) == (3, 20)
    assert timeline.at(7, 99) == (1, 0)


def test_before_the_first_change_the_first_value_counts() -> None:
    timeline = Timeline()
    timeline.note(10, 7, [1])
    assert timeline.at(7, 0) == (1, 0)


def test_an_address_never_seen_has_no_value() -> None:
    timeline = Timeline()
    timeline.note(10, 7, [1])
    assert timeline.at(8, 10) is None
    assert timeline.last(range(7, 9)) is None


def test_an_equal_value_seen_again_is_no_change() -> None:
    timeline = Timeline()
    for at, value in ((10, 1), (20, 2), (30, 2)):
        timeline.note(at, 7, [value])
    assert timeline.at(7, 40) == (2, 20)


Notes = list[tuple[int, int, list[int]]]

_NOTES = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 9), st.lists(st.integers(0, 2), max_size=5)),
    max_size=20,
)


@given(_NOTES, st.integers(0, 13), st.integers(0, 99))
def test_lookups_agree_with_a_dictionary_of_all_observations(
    notes: Notes, address: int, moment: int
) -> None:
    timeline = Timeline()
    seen: dict[int, list[tuple[int, int]]] = {}
    now = 0
    for pause, first, values in notes:
        now += pause
        timeline.note(now, first, values)
        for place, value in enumerate(values, start=first):
            seen.setdefault(place, []).append((now, value))
    found = timeline.at(address, moment)
    history = seen.get(address)
    if history is None:
        assert found is None
        return
    value = history[0][1]
    for at, noted in history:
        if at <= moment:
            value = noted
    assert found is not None
    assert found[0] == value
    assert timeline.last(range(address, address + 1)) == [history[-1][1]]
