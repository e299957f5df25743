"""Averaging and scaling."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.slave.families.fa3 import (
    FULL_SCALE,
    MAX_STEPS,
    MovingMean,
    PeriodMean,
    Sampling,
    divide_towards_zero,
    scaled,
)

MS = 1_000_000


@pytest.mark.parametrize(
    ("value", "lower", "upper", "gives"),
    [
        (6000, 0, 100, 37),  # Chapter 10.5, CH8: 2.5 V of 1 to 5 V, 37.5 without its fraction.
        (11200, 0, 4000, 2800),  # CH6: 280 of 400 degrees, by the text.
        (0, 0, 100, 0),
        (FULL_SCALE, 0, 100, 100),
        (FULL_SCALE, -100, 100, 100),
        (8000, -100, 100, 0),
        (7999, -100, 100, 0),
        (7919, -100, 100, -1),
        (16000, 100, 0, 0),
        (1234, 0, 0, 1234),  # Limits that no one has set.
        (1234, 7, 7, 1234),
        (0x7FFF, -32768, 32767, 32767),  # Beyond what a register can hold.
        (-0x8000, -32768, 32767, -32768),
    ],
)
def test_scaling_cuts_the_fraction_off(value: int, lower: int, upper: int, gives: int) -> None:
    assert scaled(value, lower, upper) == gives


@given(st.integers(-(10**12), 10**12), st.integers(1, 10**9))
def test_a_fraction_is_cut_off_towards_zero(dividend: int, divisor: int) -> None:
    assert divide_towards_zero(dividend, divisor) == int(Fraction(dividend, divisor))


def test_sampling_gives_each_value_at_once() -> None:
    sampling = Sampling()
    assert sampling.result(0) is None
    for value in (5, -3):
        sampling.feed(value, 0)
        assert sampling.result(0) == value


def test_a_period_gives_its_mean_when_it_is_over() -> None:
    mean = PeriodMean(10 * MS, 100, 0)
    mean.feed(200, 5 * MS)
    assert mean.result(10 * MS - 1) is None
    assert mean.result(10 * MS) == 150
    assert mean.result(20 * MS - 1) == 150
    assert mean.result(20 * MS) == 200


def test_periods_in_which_nobody_looked_count_too() -> None:
    mean = PeriodMean(10 * MS, 0, 0)
    mean.feed(100, 4 * MS)
    mean.feed(300, 55 * MS)
    assert mean.result(55 * MS) == 100
    assert mean.result(60 * MS) == 200


def test_a_moving_mean_needs_a_full_window_and_then_moves() -> None:
    mean = MovingMean(10 * MS, 100, 0)
    assert mean.result(10 * MS - 1) is None
    assert mean.result(10 * MS) == 100
    mean.feed(200, 12 * MS)
    assert mean.result(12 * MS) == 100
    assert mean.result(17 * MS) == 150
    assert mean.result(22 * MS) == 200
    assert mean.result(1000 * MS) == 200


_Inputs = st.lists(st.tuples(st.integers(1, 50), st.integers(-100, 100)), min_size=1, max_size=40)


def _held(inputs: list[tuple[int, int]], first: int) -> list[int]:
    """What the input holds in each ms: `first`, then each value after its time has passed."""
    held, value = [], first
    for after, next_value in inputs:
        held += [value] * after
        value = next_value
    return held


@given(_Inputs, st.integers(1, 60))
def test_a_moving_mean_is_the_mean_of_its_window(
    inputs: list[tuple[int, int]], window: int
) -> None:
    held = _held(inputs, first=7)
    mean, now = MovingMean(window * MS, 7, 0), 0
    for after, value in inputs:
        now += after
        expected = int(Fraction(sum(held[now - window : now]), window)) if now >= window else None
        assert mean.result(now * MS) == expected
        mean.feed(value, now * MS)


@given(_Inputs, st.integers(1, 60))
def test_a_period_mean_is_the_mean_of_the_last_whole_period(
    inputs: list[tuple[int, int]], period: int
) -> None:
    held = _held(inputs, first=7)
    mean, now = PeriodMean(period * MS, 7, 0), 0
    for after, value in inputs:
        now += after
        end = now // period * period
        expected = int(Fraction(sum(held[end - period : end]), period)) if end else None
        assert mean.result(now * MS) == expected
        mean.feed(value, now * MS)


def test_the_changes_that_a_moving_mean_holds_are_bounded() -> None:
    window = 10 * MAX_STEPS
    mean = MovingMean(window, 0, 0)
    for now in range(1, window + 1):
        mean.feed(now % 2, now)
    assert len(mean._steps) == MAX_STEPS
    # The last MAX_STEPS count, and before them the oldest that is left.
    oldest = mean._steps[0][1]
    assert mean.result(window) == int((MAX_STEPS / 2 + oldest * (window - MAX_STEPS)) / window)
