"""Signals, as functions of the time."""

from __future__ import annotations

import statistics
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.slave.device.image_file import MAX_STEPS, Ramp, Signal, Sine, Steps, Walk

if TYPE_CHECKING:
    from collections.abc import Callable

S = 1_000_000_000
MOMENTS = st.integers(0, 10**18)


def test_a_ramp_rises_and_begins_again() -> None:
    ramp = Ramp(0, 1000, 10 * S)
    assert [ramp.at(second * S) for second in (0, 1, 5, 9, 10, 25)] == [0, 100, 500, 900, 0, 500]


def test_a_ramp_falls_where_its_last_value_is_the_lower_one() -> None:
    ramp = Ramp(50, -50, 4 * S)
    assert [ramp.at(second * S) for second in range(5)] == [50, 25, 0, -25, 50]
    assert (ramp.lowest, ramp.highest) == (-50, 50)


def test_a_sine_swings_around_its_middle() -> None:
    sine = Sine(20, 40, 8 * S)
    assert [round(sine.at(second * S), 9) for second in (0, 2, 4, 6, 8)] == [30, 40, 30, 20, 30]


def test_a_walk_takes_a_step_each_time_and_stands_between() -> None:
    walk = Walk(0, 1000, 5, S, "1/a")
    assert walk.at(0) == 500
    assert walk.at(S - 1) == 500
    assert walk.at(S) == walk.at(2 * S - 1) != 500


def test_the_steps_of_a_walk_are_random_and_as_large_as_they_should_be() -> None:
    walk = Walk(-1e6, 1e6, 2.0, 1, "7/a")
    way = [walk.at(place) for place in range(4001)]
    steps = [after - before for before, after in pairwise(way)]
    assert abs(statistics.mean(steps)) < 0.15
    assert 1.9 < statistics.stdev(steps) < 2.1
    products = [one * other for one, other in pairwise(steps)]
    assert abs(statistics.mean(products)) < 0.4


def test_a_walk_of_the_same_seed_is_the_same_however_often_it_is_asked() -> None:
    often, seldom = (Walk(0, 10, 1, 1, "3/a") for _ in range(2))
    known = [often.at(place) for place in range(600)]
    assert [seldom.at(place) for place in range(0, 600, 7)] == known[::7]


def test_after_a_long_pause_a_walk_makes_a_bounded_number_of_steps() -> None:
    paused, all_steps = (Walk(0, 10, 1, 1, "3/a") for _ in range(2))
    assert paused.at(1 << 60) == all_steps.at(MAX_STEPS)
    assert paused.at((1 << 60) + 1) == all_steps.at(MAX_STEPS + 1)


def test_steps_show_each_value_for_the_same_time_and_begin_again() -> None:
    steps = Steps([5, -1, 3], 2 * S)
    assert [steps.at(second * S) for second in range(8)] == [5, 5, -1, -1, 3, 3, 5, 5]
    assert (steps.lowest, steps.highest) == (-1, 5)


def test_walks_of_other_seeds_are_others() -> None:
    ways = [[Walk(0, 10, 1, 1, seed).at(place) for place in range(50)] for seed in ("1/a", "2/a")]
    assert ways[0] != ways[1]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Ramp(-3, 7, 7),
        lambda: Ramp(7, -3, 7),
        lambda: Sine(-3, 7, 7),
        lambda: Steps([2, -3, 7], 7),
        lambda: Walk(-3, 7, 4, 10**14, "x"),
        lambda: Walk(5, 5, 1, 10**14, "x"),
        lambda: Walk(-3, 7, 50, 10**14, "x"),
    ],
)
@given(moment_ns=MOMENTS)
def test_a_signal_stays_within_its_ends(make: Callable[[], Signal], moment_ns: int) -> None:
    signal = make()
    assert signal.lowest <= signal.at(moment_ns) <= signal.highest
    assert signal.at(moment_ns) == signal.at(moment_ns)
