from __future__ import annotations

import random
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.replay.clock import FASTEST, SLOWEST, PlayClock

S = 1_000_000_000
HOUR = 3600 * S
BEGIN = 1_700_000_000 * S

RATES = st.fractions(Fraction(1, 64), Fraction(64), max_denominator=1000)


def _running(
    length_ns: int = HOUR, rate: Fraction | None = Fraction(1), **options: int
) -> PlayClock:
    clock = PlayClock(length_ns, rate=rate, is_loop=bool(options), **options)
    clock.run(BEGIN)
    return clock


def test_the_clock_stands_still_until_it_is_started() -> None:
    clock = PlayClock(HOUR)
    assert (clock.position(BEGIN), clock.time_of(5), clock.is_running) == (0, None, False)
    clock.run(BEGIN)
    assert clock.position(BEGIN + 7) == 7


@given(RATES, st.integers(0, 10 * HOUR))
def test_the_time_of_a_position_is_the_first_that_has_reached_it(
    rate: Fraction, place: int
) -> None:
    clock = _running(rate=rate)
    moment = clock.time_of(place)
    assert moment is not None
    assert clock.position(moment) >= place
    assert clock.position(moment - 1) < max(place, 1)


@given(st.integers(0), st.sampled_from([Fraction(1, 3), Fraction(1), Fraction(7, 3)]))
def test_an_hour_of_recorded_time_does_not_drift(seed: int, rate: Fraction) -> None:
    # As a player does: it waits until the next place, wakes up late, asks again, and goes on.
    chance = random.Random(seed)
    clock, now = _running(rate=rate), BEGIN
    for place in range(0, HOUR + 1, 60 * S):
        due = clock.time_of(place)
        assert due is not None
        now = max(now, due) + chance.randrange(2_000_000)
        assert abs(clock.position(due) - place) <= FASTEST
    assert due is not None
    assert abs((due - BEGIN) * rate - HOUR) < 1_000_000


def test_many_pauses_and_changes_of_rate_do_not_drift() -> None:
    clock, now = _running(), BEGIN
    for _ in range(1000):
        clock.pause(now)
        now += 12_345
        clock.run(now)
        clock.set_rate(Fraction(1, 3), now)
        now += 3_000_003
        clock.set_rate(Fraction(1), now)
        now += 1_000_000
    assert clock.position(now) == 1000 * (1_000_001 + 1_000_000)


def test_the_clock_stands_still_in_a_pause() -> None:
    clock = _running()
    clock.pause(BEGIN + 5)
    assert (clock.position(BEGIN + 99), clock.time_of(7)) == (5, None)
    clock.run(BEGIN + 100)
    assert (clock.position(BEGIN + 101), clock.time_of(7)) == (6, BEGIN + 102)


def test_the_clock_can_jump_while_it_runs_and_in_a_pause() -> None:
    clock = _running()
    clock.jump(50, BEGIN + 5)
    assert clock.position(BEGIN + 6) == 51
    clock.pause(BEGIN + 6)
    clock.jump(0, BEGIN + 9)
    assert clock.position(BEGIN + 20) == 0


def test_a_loop_has_a_gap_between_its_laps() -> None:
    clock = _running(length_ns=100, gap_ns=20)
    places = [clock.position(BEGIN + at) for at in (0, 100, 110, 120, 250)]
    assert [clock.in_recording(place) for place in places] == [0, 100, 100, 0, 10]
    assert [clock.lap(place) for place in places] == [0, 0, 0, 1, 2]
    assert not clock.is_over(BEGIN + 10**12)


def test_the_clock_is_over_at_the_end() -> None:
    clock = _running(length_ns=100, rate=Fraction(2))
    assert (clock.is_over(BEGIN + 49), clock.is_over(BEGIN + 50)) == (False, True)
    assert clock.in_recording(clock.position(BEGIN + 99)) == 100


def test_at_maximum_speed_everything_is_due_at_once() -> None:
    clock = _running(rate=None)
    assert clock.time_of(HOUR) == BEGIN
    assert clock.position(BEGIN + HOUR) == 0
    clock.jump(7, BEGIN + 1)
    assert clock.position(BEGIN + 5) == 7


def test_faster_and_slower_have_bounds() -> None:
    clock = _running()
    for _ in range(20):
        clock.faster(BEGIN)
    assert clock.rate == FASTEST
    for _ in range(20):
        clock.slower(BEGIN)
    assert clock.rate == SLOWEST


@pytest.mark.parametrize("rate", [Fraction(0), Fraction(-1)])
def test_a_rate_must_be_above_0(rate: Fraction) -> None:
    with pytest.raises(ValueError, match="rate must be more than 0"):
        PlayClock(HOUR, rate=rate)


def test_a_loop_must_have_a_length() -> None:
    with pytest.raises(ValueError, match="no length"):
        PlayClock(0, is_loop=True)
