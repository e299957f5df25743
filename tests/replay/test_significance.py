from __future__ import annotations

import random
from fractions import Fraction
from itertools import combinations
from math import comb

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.replay.comparing import MIN_VALUES, rank_sum, share_p_value

LATENCIES = st.lists(st.integers(0, 10**6), min_size=MIN_VALUES, max_size=60)


@given(LATENCIES)
def test_a_sample_does_not_differ_from_itself(sample: list[int]) -> None:
    shift = rank_sum(sample, sample)
    assert (shift.p, shift.exceeds, shift.is_medium) == (1.0, 0.5, False)


@given(LATENCIES, LATENCIES)
def test_exchanging_the_samples_changes_only_the_sign(a: list[int], b: list[int]) -> None:
    there, back = rank_sum(a, b), rank_sum(b, a)
    assert there.p == pytest.approx(back.p)
    assert there.exceeds == pytest.approx(1 - back.exceeds)


def test_separate_samples_differ() -> None:
    shift = rank_sum(range(20), range(100, 130))
    assert shift.p < 1e-7
    assert (shift.exceeds, shift.is_medium) == (1.0, True)


def test_the_normal_approximation_agrees_with_all_permutations() -> None:
    values = [78, 64, 75, 45, 82, 91, 60, 71, 110, 70, 53, 51, 80, 99, 72, 95]
    for b in ((8, 9, 10, 11, 12, 13, 14, 15), (0, 4, 5, 8, 12, 13, 14, 15)):
        a = [place for place in range(16) if place not in b]
        shift = rank_sum([values[place] for place in a], [values[place] for place in b])
        assert shift.p == pytest.approx(_exact_rank_sum(values, b), abs=0.02)


def test_few_values_prove_nothing() -> None:
    assert rank_sum([1] * (MIN_VALUES - 1), [9] * 100).p == 1.0


def test_equal_values_prove_nothing() -> None:
    assert rank_sum([5] * 100, [5] * 50).p == 1.0


def test_equal_distributions_differ_as_often_as_the_level_says() -> None:
    chance = random.Random(7)
    false = sum(
        rank_sum(
            [chance.expovariate(1) for _ in range(20)], [chance.expovariate(1) for _ in range(30)]
        ).p
        < 0.05
        for _ in range(1000)
    )
    assert 25 <= false <= 75


@given(st.data())
def test_shares_are_compared_exactly(data: st.DataObject) -> None:
    n, other_n = data.draw(st.integers(1, 40)), data.draw(st.integers(1, 40))
    k, other_k = data.draw(st.integers(0, n)), data.draw(st.integers(0, other_n))
    hits = k + other_k
    chances = {
        each: Fraction(comb(n, each) * comb(other_n, hits - each), comb(n + other_n, hits))
        for each in range(max(0, hits - other_n), min(hits, n) + 1)
    }
    exact = float(sum(one for one in chances.values() if one <= chances[k]))
    assert share_p_value(k, n, other_k, other_n) == pytest.approx(exact, rel=1e-6)


@given(st.data())
def test_a_probability_is_between_0_and_1(data: st.DataObject) -> None:
    n, other_n = data.draw(st.integers(1, 300)), data.draw(st.integers(1, 300))
    k, other_k = data.draw(st.integers(0, n)), data.draw(st.integers(0, other_n))
    assert 0 < share_p_value(k, n, other_k, other_n) <= 1


def _exact_rank_sum(values: list[int], b: tuple[int, ...]) -> float:
    """Of all ways to choose as many places as b has, how many are as far from the middle."""
    ranks = [sum(one < value for one in values) for value in values]
    middle = len(b) * (len(values) - 1) / 2
    far = abs(sum(ranks[place] for place in b) - middle)
    sums = [abs(sum(chosen) - middle) >= far for chosen in combinations(ranks, len(b))]
    return sum(sums) / len(sums)
