from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING

from mbtool.devices.checking.polls import MAX_PERIODS, MAX_POLLS, PollRules
from tests.devices.checking.talk import transaction

if TYPE_CHECKING:
    from collections.abc import Iterable


def text(periods_ms: Iterable[float]) -> str | None:
    rules = PollRules()
    for at_ms in accumulate(periods_ms, initial=0.0):
        rules.transaction(transaction(at_ms=at_ms))
    found = [*rules.close()]
    assert len(found) <= 1
    return found[0].message if found else None


def test_a_poll_that_is_late_now_and_then_is_found() -> None:
    assert text([100] * 50 + [180] * 5) == (
        "read holding 0: asked every 100.0 ms, but 5 of 55 periods are off by more than half of "
        "that; 100.0 ms to 180.0 ms"
    )


def test_a_poll_that_is_early_is_found_too() -> None:
    assert text([100, 100, 100, 100, 40] * 10) is not None


def test_a_regular_poll_is_no_finding() -> None:
    assert text([100] * 60) is None
    assert text([100, 102, 98, 130, 99] * 12) is None


def test_single_pauses_are_no_finding() -> None:
    assert text([100] * 30 + [5000] + [100] * 30) is None
    assert text([100] * 300 + [180] * 5) is None


def test_irregular_requests_are_no_poll() -> None:
    assert text([100, 300, 50, 900, 20, 400] * 10) is None
    assert text([100] * 15 + [180] * 4) is None


def test_polls_as_fast_as_possible_have_no_finding() -> None:
    assert text([10] * 50 + [18] * 10) is None


def test_a_clock_that_was_set_back_is_no_period() -> None:
    assert text([100] * 30 + [-5000] + [100] * 30) is None


def test_the_sample_is_spread_over_a_long_capture() -> None:
    message = text(([100] * 9 + [180]) * 200)
    assert message is not None
    assert "looked at, of 2000," in message


def test_each_poll_is_checked_separately() -> None:
    rules = PollRules()
    for turn in range(60):
        rules.transaction(transaction(at_ms=100 * turn))
        late = 80 if turn % 6 == 5 else 0
        rules.transaction(transaction("04 0000 0001", "04 02 0001", at_ms=100 * turn + late + 5))
    found = [*rules.close()]
    assert [one.message.partition(":")[0] for one in found] == ["read input 0"]


def test_equal_requests_of_two_masters_are_two_polls() -> None:
    rules = PollRules()
    for at in range(60):
        for master, late_ms in (("10.0.0.1", 0), ("10.0.0.9", 370)):
            last = transaction(at_ms=1000 * at + late_ms, source=f"{master}:5000{at % 5}")
            rules.transaction(last)
    assert [*rules.close()] == []
    assert rules.usual_ns(last) == 1_000_000_000


def test_memory_is_bounded() -> None:
    rules = PollRules()
    for at in range(3 * MAX_PERIODS):
        rules.transaction(transaction(at_ms=100 * at))
    (poll,) = rules._polls.values()
    assert len(poll.sample) < MAX_PERIODS
    for unit in range(256):
        for quantity in range(1, MAX_POLLS // 128):
            rules.transaction(transaction(f"03 0000 {quantity:04X}", None, unit=unit))
    assert len(rules._polls) == MAX_POLLS
