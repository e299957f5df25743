from __future__ import annotations

from fractions import Fraction

from mbtool.replay.clock import PlayClock
from mbtool.replay.steering import Control, Progress, Steering

S = 1_000_000_000


class Steered:
    """A clock of ten seconds, and the moments at which a step was wanted."""

    def __init__(self) -> None:
        self.clock = PlayClock(10 * S)
        self.steps: list[int] = []
        self.steering = Steering(self.clock, self.steps.append)


def test_the_clock_starts_with_the_first_sign_of_life() -> None:
    steered = Steered()
    assert steered.clock.position(5 * S) == 0
    steered.steering.begin(5 * S)
    steered.steering.begin(6 * S)
    assert steered.clock.position(7 * S) == 2 * S


def test_a_pause_ends_with_the_same_key() -> None:
    steered = Steered()
    steered.steering.begin(0)
    steered.steering.apply(Control.PAUSE, 2 * S)
    assert steered.steering.is_paused
    steered.steering.apply(Control.PAUSE, 5 * S)
    assert steered.clock.position(6 * S) == 3 * S


def test_what_is_paused_before_it_begins_stands_until_it_is_let_go() -> None:
    steered = Steered()
    steered.steering.apply(Control.PAUSE, 0)
    steered.steering.begin(1 * S)
    assert steered.clock.position(2 * S) == 0
    steered.steering.apply(Control.PAUSE, 2 * S)
    assert steered.clock.position(3 * S) == 1 * S


def test_a_pause_that_ends_before_the_beginning_starts_nothing() -> None:
    steered = Steered()
    for _ in range(2):
        steered.steering.apply(Control.PAUSE, 0)
    assert not steered.clock.is_running


def test_a_step_stands_still_and_is_the_players_matter() -> None:
    steered = Steered()
    steered.steering.begin(0)
    steered.steering.apply(Control.STEP, 2 * S)
    steered.steering.apply(Control.STEP, 3 * S)
    assert (steered.steps, steered.clock.position(9 * S)) == ([2 * S, 3 * S], 2 * S)


def test_faster_and_slower_turn_the_clock() -> None:
    steered = Steered()
    steered.steering.begin(0)
    steered.steering.apply(Control.FASTER, S)
    assert steered.clock.rate == 2
    steered.steering.apply(Control.SLOWER, S)
    steered.steering.apply(Control.SLOWER, S)
    assert steered.clock.rate == Fraction(1, 2)


def test_progress_says_where_it_is() -> None:
    steered = Steered()
    before = steered.steering.progress(0, "nothing")
    assert (before.is_waiting, before.is_paused, before.done) == (True, False, "nothing")
    steered.steering.begin(0)
    after = steered.steering.progress(3 * S, "")
    assert (after.position_ns, after.length_ns, after.lap) == (3 * S, 10 * S, 0)
    assert after.rate == 1
    assert not after.is_waiting


class _Desk:
    def __init__(self, *wanted: Control) -> None:
        self._wanted = wanted
        self.shown: list[Progress] = []

    def controls(self) -> tuple[Control, ...]:
        return self._wanted

    def show(self, progress: Progress) -> None:
        self.shown.append(progress)


def test_a_desk_is_obeyed_and_then_shown_where_it_is() -> None:
    steered = Steered()
    steered.steering.begin(0)
    desk = _Desk(Control.FASTER, Control.PAUSE)
    steered.steering.update(desk, 2 * S, "2 bytes")
    (shown,) = desk.shown
    assert (shown.position_ns, shown.rate, shown.is_paused, shown.done) == (
        2 * S,
        Fraction(2),
        True,
        "2 bytes",
    )
