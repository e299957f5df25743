"""Units that became slower, and since when."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.ledger.time_bins import TimeBins
from mbtool.troubles.units import Slower, became_slower
from tests.ledger.masters import MS, START_NS
from tests.ledger.test_time_bins import add

if TYPE_CHECKING:
    from collections.abc import Sequence

S = 1000 * MS


def slower(latencies_ms: Sequence[float], every_ns: int = S) -> Slower | None:
    times = ((START_NS + at * every_ns, round(ms * MS)) for at, ms in enumerate(latencies_ms))
    return became_slower(add(TimeBins().row(), times).bins())


@pytest.mark.parametrize("every_ns", [S // 5, S, 3600 * S])
@pytest.mark.parametrize("since", [100, 110, 119, 133])
def test_a_unit_that_became_slower_is_told_since_when(since: int, every_ns: int) -> None:
    found = slower([5] * since + [50] * (200 - since), every_ns)
    assert found is not None
    assert abs(found.since_ns - START_NS - since * every_ns) <= every_ns
    assert found.before_ns == pytest.approx(5 * MS, rel=0.3)
    assert found.mean_ns == pytest.approx(50 * MS, rel=0.1)
    assert found.is_long == (every_ns == 3600 * S)


@pytest.mark.parametrize(
    "latencies_ms",
    [
        [5] * 200,
        [50] * 100 + [5] * 100,
        [5] * 100 + [14] * 100,
        [20] * 100 + [38] * 100,
        [5] * 100 + [50] * 80 + [5] * 20,
        [5] * 100 + [50] * 92 + [5] * 8,
        [5] * 190 + [50] * 10,
        [5] * 5 + [50],
        [5] * 6 + [50] * 4,
        [],
    ],
    ids=lambda some: ",".join(map(str, dict.fromkeys(some))),
)
def test_a_unit_that_is_not_slower_is_not_told(latencies_ms: Sequence[float]) -> None:
    assert slower(latencies_ms) is None


def test_a_single_late_answer_before_the_change_is_not_the_latency_before() -> None:
    found = slower([5] * 120 + [60_000] + [5] * 9 + [50] * 70)
    assert found is not None
    assert found.before_ns == 5 * MS
    assert found.mean_ns == pytest.approx(50 * MS, rel=0.1)


def test_the_least_that_is_told_is_twice_as_slow() -> None:
    assert slower([10] * 10 + [20.5] * 10) is not None
    assert slower([10] * 10 + [19.5] * 10) is None
