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


def test_the_clock_starts_at_the_first_call() -> None:
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


def test_a_pause_before_the_beginning_keeps_the_clock_still() -> None:
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


def test_a_step_pauses_the_clock_and_calls_the_player() -> None:
    steered = Steered()
    steered.steering.begin(0)
    steered.steering.apply(Control.STEP, 2 * S)
    steered.steering.apply(Control.STEP, 3 * S)
    assert (steered.steps, steered.clock.position(9 * S)) == ([2 * S, 3 * S], 2 * S)


def test_faster_and_slower_change_the_rate() -> None:
    steered = Steered()
    steered.steering.begin(0)
    steered.steering.apply(Control.FASTER, S)
    assert steered.clock.rate == 2
    steered.steering.apply(Control.SLOWER, S)
    steered.steering.apply(Control.SLOWER, S)
    assert steered.clock.rate == Fraction(1, 2)


def test_progress_has_the_position() -> None:
    steered = Steered()
    before = steered.steering.progress(0, "nothing")
    assert (before.is_waiting, before.is_paused, before.done) == (True, False, "nothing")
    steered.steering.begin(0)
    after = steered.steering.progress(3 * S, "")
    assert (after.position_ns, after.length_ns, after.lap) == (3 * S, 10 * S, 0)
    assert after.rate == 1
    assert not after.is_waiting


class _User:
    def __init__(self, *wanted: Control) -> None:
        self._wanted = wanted
        self.shown: list[Progress] = []

    def controls(self) -> tuple[Control, ...]:
        return self._wanted

    def show(self, progress: Progress) -> None:
        self.shown.append(progress)


def test_the_users_controls_are_applied_and_the_progress_is_shown() -> None:
    steered = Steered()
    steered.steering.begin(0)
    user = _User(Control.FASTER, Control.PAUSE)
    steered.steering.update(user, 2 * S, "2 bytes")
    (shown,) = user.shown
    assert (shown.position_ns, shown.rate, shown.is_paused, shown.done) == (
        2 * S,
        Fraction(2),
        True,
        "2 bytes",
    )
