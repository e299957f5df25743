from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.values.value_series import SeriesSample, ValueSeries, thin_samples


def test_only_changes_are_kept() -> None:
    series = ValueSeries("CH1")
    for at, value in enumerate((5, 5, 6, 6, 5)):
        series.add(at, value, f"{value} V")
    assert series.samples == [SeriesSample(0, 5), SeriesSample(2, 6), SeriesSample(4, 5)]
    assert series.changes == 2
    assert series.texts == {5: "5 V", 6: "6 V"}


@given(
    st.lists(st.lists(st.tuples(st.integers(1, 9), st.integers(0, 3)), max_size=60), max_size=5),
    st.integers(8, 40),
)
def test_values_added_together_give_what_they_give_one_by_one(
    several: list[list[tuple[int, int]]], limit: int
) -> None:
    one, together = ValueSeries("CH1", limit=limit), ValueSeries("CH1", limit=limit)
    at_ns = 0
    for steps in several:
        times = [at_ns := at_ns + step for step, _ in steps]
        values = [value for _, value in steps]
        together.add_all(times, values)
        for time_ns, value in zip(times, values, strict=True):
            one.add(time_ns, value)
    assert (together.samples, together.changes) == (one.samples, one.changes)


def test_a_text_that_is_no_number_has_its_last_text_and_its_changes() -> None:
    series = ValueSeries("name")
    for at, text in enumerate(("A", "A", "B")):
        series.add(at, None, text)
    assert (series.samples, series.changes, series.last_text) == ([], 1, "B")


@given(
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(-9, 9)), min_size=1, max_size=400),
    st.integers(4, 64),
)
def test_thinning_keeps_order_and_extremes_within_its_bound(
    pairs: list[tuple[int, int]], most: int
) -> None:
    samples = [SeriesSample(*pair) for pair in pairs]
    kept = thin_samples(samples, most)
    assert len(kept) <= most
    assert [one.ts_ns for one in kept] == sorted(one.ts_ns for one in kept)
    assert {*kept} <= {*samples}
    for extreme in (min, max):
        assert extreme(one.value for one in kept) == extreme(one.value for one in samples)


def test_memory_is_bounded() -> None:
    series = ValueSeries("CH1", limit=100)
    for at in range(10_000):
        series.add(at, at * 37 % 1009)
        assert len(series.samples) <= 101
    assert series.changes == 9999
