from __future__ import annotations

from statistics import median_high

import pytest

from mbtool.ledger.distribution import Distribution
from mbtool.troubles.slow_units import MIN_ANSWERS, SLOW_RATIO, are_many, slow_units
from tests.ledger.masters import MS


def answered(latency_ms: int, count: int = MIN_ANSWERS) -> Distribution:
    made = Distribution()
    for _ in range(count):
        made.add(latency_ms * MS)
    return made


def test_a_unit_is_slow_beside_one_that_most_others_do_not_exceed() -> None:
    assert slow_units({1: answered(4), 2: answered(6), 3: answered(60)}) == {3: 6 * MS}


@pytest.mark.parametrize("latencies", [(5,), (5, 5), (2, 9), (40, 100), (5, 5, 14), (8, 8, 45)])
def test_others_are_not_slow(latencies: tuple[int, ...]) -> None:
    assert slow_units({at: answered(one) for at, one in enumerate(latencies)}) == {}


def test_few_answers_tell_nothing() -> None:
    assert slow_units({1: answered(4), 2: answered(90, MIN_ANSWERS - 1)}) == {}


def test_each_unit_is_compared_with_all_others() -> None:
    latencies = [5, 90, 5, 7, 130, 13, 200, 5]
    found = slow_units({at: answered(one) for at, one in enumerate(latencies)})
    for at, own in enumerate(latencies):
        usual = median_high(one for other, one in enumerate(latencies) if other != at)
        assert found.get(at) == (usual * MS if own >= max(SLOW_RATIO * usual, 50) else None)


def test_many_slow_units_are_so_by_their_kind() -> None:
    assert not are_many(2, 4)
    assert not are_many(4, 16)
    assert are_many(4, 15)
