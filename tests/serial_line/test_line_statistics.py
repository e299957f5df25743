"""Learned costs and response times."""

from __future__ import annotations

import pytest

from mbtool.serial_line.line_statistics import LatencyStatistics, LearnedCost

MS = 1_000_000


def test_learned_cost_begins_with_its_start_value() -> None:
    assert LearnedCost(2.0, (0.2, 5.0)).bits == 2.0
    assert LearnedCost(0.0, (0.2, 5.0)).bits == 0.0


def test_what_is_seen_costs_less_and_what_is_not_seen_costs_more() -> None:
    learned = LearnedCost(2.0, (0.2, 5.0))
    learned.learn(True)
    cheaper = learned.bits
    assert cheaper < 2.0
    learned.learn(False)
    assert learned.bits > cheaper


@pytest.mark.parametrize(("seen", "bits"), [(True, 0.2), (False, 5.0)])
def test_learned_cost_stays_within_its_limits(seen: bool, bits: float) -> None:
    learned = LearnedCost(2.0, (0.2, 5.0))
    for _ in range(10_000):
        learned.learn(seen)
        assert 0.2 <= learned.bits <= 5.0
    assert learned.bits == bits


def test_few_dozen_frames_teach_a_frequency() -> None:
    learned = LearnedCost(2.0, (0.2, 5.0))
    for number in range(64):
        learned.learn(number % 2 == 0)
    assert learned.bits == pytest.approx(1.0, abs=0.3)


def test_changed_frequency_is_learned_again() -> None:
    learned = LearnedCost(8.0, (3.0, 10.0))
    for _ in range(1000):
        learned.learn(False)
    for _ in range(100):
        learned.learn(True)
    assert learned.bits == 3.0


def test_response_time_is_assumed_long_until_enough_is_heard() -> None:
    latency = LatencyStatistics()
    assert latency.doublings_late(LatencyStatistics.INITIAL_NS) == 0
    before = 0.0
    for _ in range(LatencyStatistics.ENOUGH_RESPONSES - 1):
        latency.learn(5 * MS)
        late = latency.doublings_late(LatencyStatistics.INITIAL_NS)
        assert before < late < latency.doublings_late(2 * LatencyStatistics.INITIAL_NS)
        before = late
    latency.learn(5 * MS)
    assert latency.doublings_late(LatencyStatistics.MIN_NS) == 0


def test_lateness_is_counted_in_doublings_of_the_longest_response_time() -> None:
    latency = LatencyStatistics()
    for each in (20, 40, 30) * LatencyStatistics.ENOUGH_RESPONSES:
        latency.learn(each * MS)
    longest_silence_ns = 40 * MS
    assert latency.doublings_late(longest_silence_ns) == pytest.approx(0, abs=0.05)
    assert latency.doublings_late(4 * longest_silence_ns) == pytest.approx(2, abs=0.05)
    assert latency.doublings_late(longest_silence_ns // 2) == pytest.approx(-1, abs=0.05)


def test_longest_latency_is_forgotten_slowly() -> None:
    latency = LatencyStatistics()
    for _ in range(LatencyStatistics.ENOUGH_RESPONSES):
        latency.learn(15 * MS)
    latency.learn(400 * MS)
    for _ in range(20):
        latency.learn(15 * MS)
    assert latency.doublings_late(300 * MS) < 0
    for _ in range(600):
        latency.learn(15 * MS)
    assert latency.doublings_late(300 * MS) > 3


@pytest.mark.parametrize("silence_ns", [-(10**9), 0, 1])
def test_silence_of_nothing_is_no_error(silence_ns: int) -> None:
    assert LatencyStatistics().doublings_late(silence_ns) < 0


def test_latency_that_a_clock_got_wrong_is_no_error() -> None:
    latency = LatencyStatistics()
    for _ in range(LatencyStatistics.ENOUGH_RESPONSES):
        latency.learn(-(10**9))
    assert latency.doublings_late(LatencyStatistics.MIN_NS) == 0


def test_one_capped_response_time_can_only_double_the_longest() -> None:
    latency = LatencyStatistics()
    for _ in range(LatencyStatistics.ENOUGH_RESPONSES):
        latency.learn_capped(40 * MS)
    latency.learn_capped(1000 * MS)
    assert latency.doublings_late(80 * MS) == pytest.approx(0, abs=0.1)


def test_slow_cost_remembers_rare_events_longer() -> None:
    hasty, steady = (
        LearnedCost(8.0, (0.0, 10.0)),
        LearnedCost(8.0, (0.0, 10.0), is_slow=True),
    )
    for learned in (hasty, steady):
        for number in range(400):
            learned.learn(number % 20 == 0)
        for _ in range(40):
            learned.learn(False)
    assert 4.0 < steady.bits < hasty.bits - 0.5
