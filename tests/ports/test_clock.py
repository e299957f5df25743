"""The clocks of recordings and slaves."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from mbtool.ports import clock as clocks
from mbtool.ports.clock import ClockWatch, begun_run, now_ns, share_clock, steady_clock

if TYPE_CHECKING:
    from collections.abc import Callable

SECOND_NS = 1_000_000_000
HOUR_NS = 3600 * SECOND_NS


@pytest.fixture
def set_clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Sets the system's clock forward by some ns, as far as this program can see."""
    ahead_ns = 0

    def set_forward(by_ns: int) -> None:
        nonlocal ahead_ns
        ahead_ns += by_ns

    monkeypatch.setattr(clocks, "system_ns", lambda: time.time_ns() + ahead_ns)
    return set_forward


@pytest.mark.parametrize("by_ns", [HOUR_NS, -HOUR_NS])
def test_a_clock_that_is_set_changes_no_time_of_a_run(
    set_clock: Callable[[int], None], by_ns: int
) -> None:
    with begun_run():
        before_ns = now_ns()
        set_clock(by_ns)
        with begun_run():
            assert 0 <= now_ns() - before_ns < 600 * SECOND_NS


def test_a_run_begins_at_the_system_s_utc(set_clock: Callable[[int], None]) -> None:
    set_clock(HOUR_NS)
    with begun_run():
        assert abs(now_ns() - time.time_ns() - HOUR_NS) < 600 * SECOND_NS
    set_clock(-HOUR_NS)
    with begun_run():
        assert abs(now_ns() - time.time_ns()) < 600 * SECOND_NS


def test_a_child_process_tells_the_same_time() -> None:
    (ahead,) = share_clock({}).values()
    assert int(ahead) == clocks._RunClock.ahead_ns


def test_a_step_is_told_once_with_its_size(set_clock: Callable[[int], None]) -> None:
    watch = ClockWatch()
    assert watch.take_step() == 0
    set_clock(HOUR_NS)
    assert abs(watch.take_step() - HOUR_NS) < SECOND_NS // 4
    assert watch.take_step() == 0
    set_clock(-2 * SECOND_NS)
    assert abs(watch.take_step() + 2 * SECOND_NS) < SECOND_NS // 4


def test_small_steps_are_told_when_they_sum_up(set_clock: Callable[[int], None]) -> None:
    watch = ClockWatch()
    told = 0
    for _ in range(10):
        set_clock(SECOND_NS // 10)
        told += watch.take_step()
    assert told >= SECOND_NS // 2


def test_times_of_the_system_s_clock_are_those_of_the_run_before_and_after_a_step(
    set_clock: Callable[[int], None],
) -> None:
    with begun_run():
        watch = ClockWatch()
        old_ns = time.time_ns()
        assert abs(watch.from_system(old_ns, now_ns()) - now_ns()) < SECOND_NS
        set_clock(HOUR_NS)
        watch.look()
        new_ns = time.time_ns() + HOUR_NS
        assert abs(watch.from_system(new_ns, now_ns()) - now_ns()) < SECOND_NS
        assert abs(watch.from_system(old_ns, now_ns()) - now_ns()) < SECOND_NS


def test_tells_utc_and_never_steps_back() -> None:
    clock = steady_clock()
    before = time.time_ns()
    times = [clock() for _ in range(1000)]
    assert times == sorted(times)
    assert abs(times[0] - before) < 1_000_000_000


def test_does_not_follow_a_clock_that_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = steady_clock()
    before = clock()
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    assert 0 <= clock() - before < 10_000_000_000
