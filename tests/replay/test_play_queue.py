"""Items of a recording at their times, or step by step."""

from __future__ import annotations

from mbtool.replay.bus import ByteRun
from mbtool.replay.clock import PlayClock
from mbtool.replay.play_queue import PlayQueue

S = 1_000_000_000
FIRST, SECOND = ByteRun(2 * S, b"a"), ByteRun(3 * S, b"b")


def test_items_are_due_by_the_clock_and_while_it_stands_still_by_steps() -> None:
    clock = PlayClock(10 * S)
    queue = PlayQueue([FIRST, SECOND], clock)
    assert queue.due_ns(FIRST, 0) is None
    queue.allow_step()
    assert queue.due_ns(FIRST, 1 * S) == 1 * S
    assert not queue.take(FIRST, 1 * S)
    assert (clock.position(9 * S), queue.due_ns(SECOND, 2 * S)) == (2 * S, None)
    clock.run(4 * S)
    assert queue.due_ns(SECOND, 4 * S) == 5 * S
    assert queue.take(SECOND, 5 * S)
    assert (queue.upcoming(), queue.taken) == (None, 2)


def test_unused_steps_are_dropped_when_the_clock_runs_again() -> None:
    clock = PlayClock(10 * S)
    queue = PlayQueue([FIRST], clock)
    for _ in range(3):
        queue.allow_step()
    clock.run(0)
    assert queue.due_ns(FIRST, 1 * S) == 2 * S
    clock.pause(1 * S)
    assert queue.due_ns(FIRST, 3 * S) is None


def test_a_loop_begins_its_next_lap_only_when_it_may() -> None:
    queue = PlayQueue([FIRST], PlayClock(10 * S, is_loop=True))
    queue.take(FIRST, 0)
    assert queue.upcoming(may_restart=False) is None
    assert (queue.upcoming(), queue.taken) == (FIRST, 1)
