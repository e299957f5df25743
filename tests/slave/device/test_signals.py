"""Signals, as functions of the time."""

from __future__ import annotations

import random
import statistics
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.slave.device.signals import Ramp, Signal, Sine, Walk

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


def test_a_walk_is_the_same_in_whatever_order_it_is_asked() -> None:
    places = list(range(600))
    forward = Walk(0, 10, 1, 1, "3/a")
    known = {place: forward.at(place) for place in places}
    random.Random(5).shuffle(places)
    other = Walk(0, 10, 1, 1, "3/a")
    assert {place: other.at(place) for place in places} == known


def test_walks_of_other_seeds_are_others() -> None:
    ways = [[Walk(0, 10, 1, 1, seed).at(place) for place in range(50)] for seed in ("1/a", "2/a")]
    assert ways[0] != ways[1]


@pytest.mark.parametrize(
    "signal",
    [Ramp(-3, 7, 7), Ramp(7, -3, 7), Sine(-3, 7, 7), Walk(-3, 7, 4, 3, "x"), Walk(5, 5, 1, 1, "x")],
)
@given(moment_ns=MOMENTS)
def test_a_signal_stays_within_its_ends(signal: Signal, moment_ns: int) -> None:
    assert signal.lowest <= signal.at(moment_ns) <= signal.highest
    assert signal.at(moment_ns) == signal.at(moment_ns)
