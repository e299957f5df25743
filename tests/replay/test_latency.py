from __future__ import annotations

import random

from mbtool.replay.latency import FixedLatency, RecordedLatency, SampledLatency
from mbtool.replay.recording import Recording
from tests.replay.recorded import MS, answered

READ = "03 0000 0001"
ANSWER = "03 02 0001"


def _recording() -> Recording:
    return Recording.of(
        [
            *(answered(at, READ, ANSWER, latency_ns=at * MS) for at in (1, 2, 3, 4)),
            answered(5, "04 0000 0001", "84 02", latency_ns=50 * MS),
        ]
    )


def test_a_recorded_answer_takes_its_own_time_and_others_the_median() -> None:
    latency = RecordedLatency(_recording())
    assert latency.is_recorded_time
    assert latency.ns(1, 3, 7) == 7
    assert latency.ns(1, 3, None) == 2 * MS


def test_a_fixed_latency_is_the_same_for_all() -> None:
    latency = FixedLatency(5 * MS)
    assert not latency.is_recorded_time
    assert {latency.ns(1, 3, own) for own in (None, 1, 99)} == {5 * MS}


def test_a_sampled_latency_is_one_that_was_recorded_for_the_unit_and_function() -> None:
    latency = SampledLatency(_recording(), random.Random(1).random)
    assert latency.is_recorded_time
    assert {latency.ns(1, 3, None) for _ in range(200)} == {at * MS for at in (1, 2, 3, 4)}
    assert {latency.ns(1, 4, 9) for _ in range(20)} == {50 * MS}
    assert {latency.ns(1, 1, None) for _ in range(200)} == {at * MS for at in (1, 2, 3, 4, 50)}
    assert latency.ns(2, 3, None) == 0


def test_equal_random_numbers_give_equal_latencies() -> None:
    first, second = (SampledLatency(_recording(), random.Random(7).random) for _ in range(2))
    assert [first.ns(1, 3, None) for _ in range(50)] == [second.ns(1, 3, None) for _ in range(50)]
