from __future__ import annotations

from tests.benchmarks.watch import REGISTERS, measure, traffic


def test_the_screen_shows_all_that_comes() -> None:
    cost = measure(rate=200, seconds=0.5)
    assert cost.shown == 100
    assert cost.drawings > 0
    assert cost.ratio > 1


def test_one_value_of_each_poll_changes_from_cycle_to_cycle() -> None:
    chunks = traffic(21, 1000)
    first, again = chunks[1].data[9:], chunks[41].data[9:]
    assert len(first) == len(again) == 2 * REGISTERS
    assert first[2:] == again[2:]
    assert first[:2] != again[:2]
