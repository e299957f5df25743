"""Which units are slow beside the others."""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mbtool.overview.distribution import Distribution

K = TypeVar("K")

SLOW = 3
"""A unit is slow if its median latency is so many times what the median of the other units is..."""
SLOW_NS = 10_000_000
"""...and at least this long, in ns."""
ENOUGH_ANSWERS = 5
"""The median latency of fewer answers tells nothing."""

_MANY = 3
_FEW = 0.25


def are_many(slow: int, units: int) -> bool:
    """True if so many of the units are slow that they may be so by their kind: 3 and over 25 %."""
    return slow >= _MANY and slow > units * _FEW


def slow_units(latencies: Mapping[K, Distribution]) -> dict[K, float]:
    """For each slow unit, the median of the other units' median latencies, in ns."""
    medians = {
        unit: one.percentile(50) for unit, one in latencies.items() if one.count >= ENOUGH_ANSWERS
    }
    in_order = sorted(medians.values())
    slow = {}
    for unit, own in medians.items():
        usual = _middle_without(in_order, bisect_left(in_order, own))
        if usual and own >= max(SLOW * usual, SLOW_NS):
            slow[unit] = usual
    return slow


def _middle_without(in_order: list[int], left_out: int) -> float:
    """The median of numbers in order without one of them; 0 if there is no other."""
    count = len(in_order) - 1
    if not count:
        return 0
    below, above = (count - 1) // 2, count // 2
    return sum(in_order[at + (at >= left_out)] for at in (below, above)) / 2
