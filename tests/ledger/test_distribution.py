from __future__ import annotations

import itertools
from math import ceil
from random import Random

import pytest

from mbtool.ledger.distribution import MAX_BUCKETS, Distribution

PERCENTS = (1, 5, 50, 95, 99, 100)


def of(durations: list[int], limit: int = MAX_BUCKETS) -> Distribution:
    distribution = Distribution(limit)
    for one in durations:
        distribution.add(one)
    return distribution


def truth(durations: list[int], percent: int) -> int:
    return sorted(durations)[ceil(percent * len(durations) / 100) - 1]


def test_percentiles_of_few_durations_are_exact() -> None:
    random = Random(1)
    durations = [random.randrange(10**9) for _ in range(MAX_BUCKETS)]
    distribution = of(durations)
    assert distribution.error == 0
    for percent in PERCENTS:
        assert distribution.percentile(percent) == truth(durations, percent)


@pytest.mark.parametrize("octaves", [1, 4, 16])
def test_percentiles_of_many_durations_are_as_near_as_stated(octaves: int) -> None:
    random = Random(octaves)
    durations = [round(1e6 * 2 ** random.uniform(0, octaves)) for _ in range(20_000)]
    distribution = of(durations)
    assert 0 < distribution.error < 0.05
    for percent in PERCENTS:
        right = truth(durations, percent)
        assert abs(distribution.percentile(percent) - right) <= distribution.error * right


def test_count_mean_least_and_greatest_are_exact_however_many_there_are() -> None:
    random = Random(2)
    durations = [random.randrange(10**12) for _ in range(20_000)]
    distribution = of(durations)
    assert distribution.count == len(durations)
    assert distribution.mean == sum(durations) / len(durations)
    assert (distribution.least, distribution.greatest) == (min(durations), max(durations))
    assert distribution.percentile(100) <= max(durations)


def test_memory_is_bounded() -> None:
    random = Random(3)
    distribution = of([round(10 ** random.uniform(0, 18)) for _ in range(50_000)], 64)
    assert len(distribution._buckets) <= 64


def test_two_distributions_become_one() -> None:
    random = Random(4)
    one = [random.randrange(10**6, 10**7) for _ in range(3000)]
    other = [random.randrange(10**8, 10**9) for _ in range(200)]
    both = of(one)
    both.merge(of(other))
    assert both.count == 3200
    assert (both.least, both.greatest) == (min(one), max(other))
    for percent in PERCENTS:
        right = truth(one + other, percent)
        assert abs(both.percentile(percent) - right) <= both.error * right


def test_merging_nothing_changes_nothing() -> None:
    one = of([5, 7])
    one.merge(Distribution())
    assert (one.count, one.least, one.greatest) == (2, 5, 7)
    none = Distribution()
    none.merge(of([5, 7]))
    assert (none.count, none.least, none.greatest) == (2, 5, 7)


def test_negative_durations_are_left_out() -> None:
    distribution = of([-1, 10, -(10**18)])
    assert (distribution.count, distribution.least, distribution.total) == (1, 10, 10)


def test_no_duration_has_no_percentile_and_no_histogram() -> None:
    empty = Distribution()
    assert (empty.percentile(50), empty.mean, empty.histogram()) == (0, 0.0, [])


def test_the_histogram_has_steps_of_1_2_and_5() -> None:
    histogram = of([500, 1000, 1999, 2000, 4_999, 5_000, 99_000]).histogram()
    assert [(one.low_ns, one.high_ns, one.number) for one in histogram] == [
        (0, 1000, 1),
        (1000, 2000, 2),
        (2000, 5000, 2),
        (5000, 10_000, 1),
        (10_000, 20_000, 0),
        (20_000, 50_000, 0),
        (50_000, 100_000, 1),
    ]


def test_the_histogram_counts_each_duration_once() -> None:
    random = Random(5)
    distribution = of([round(10 ** random.uniform(0, 11)) for _ in range(5000)])
    histogram = distribution.histogram()
    assert sum(one.number for one in histogram) == 5000
    assert all(one.high_ns == other.low_ns for one, other in itertools.pairwise(histogram))


def test_bars_end_at_the_99th_percentile_where_few_durations_are_far_longer() -> None:
    durations = of([*range(1_000_000, 2_000_000, 1000), 999_000_000])
    bars, beyond = durations.bars()
    assert beyond == 1
    assert len(bars) <= 41
    assert (bars[0].low_ns, bars[0].high_ns, bars[0].number) == (1_000_000, 1_050_000, 50)
    assert sum(bar.number for bar in bars) + beyond == durations.count


def test_bars_have_all_durations_if_none_is_far_away() -> None:
    bars, beyond = of([*range(5_000_000, 9_000_000, 1000)]).bars()
    assert (bars[-1].high_ns >= 8_999_000, beyond) == (True, 0)
    assert of([]).bars() == ([], 0)
    bars, beyond = of([5_000_000] * 200 + [3_000_000_000]).bars()
    assert ([bar.number for bar in bars], beyond) == ([200], 1)
    ((low, high, number),), beyond = of([7_000_000, 7_000_000]).bars()
    assert (low <= 7_000_000 < high, number, beyond) == (True, 2, 0)


def test_the_durations_from_one_on_are_counted() -> None:
    durations = of([10, 20, 30, 30])
    assert [durations.count_at_least(ns) for ns in (5, 20, 21, 31)] == [4, 3, 2, 0]
