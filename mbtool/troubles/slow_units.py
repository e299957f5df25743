"""Finds the units that respond much slower than the other units."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from mbtool.ledger.distribution import Distribution

K = TypeVar("K")

SLOW_RATIO = 3
"""A unit is slow if its median latency is at least this many times the usual one. The usual one is
the median latency of another unit, which most of the others do not exceed. The latency must also be
at least SLOW_NS."""
SLOW_NS = 50_000_000
"""The least median latency of a slow unit, in ns. Below, devices differ by their kind: many answer
within 5 ms, many others within 40 ms."""
GRAVE_NS = 100_000_000
"""A slow unit with a lower median latency (ns) than this is a note, as masters wait longer."""
MIN_ANSWERS = 5
"""Units with fewer responses than this are ignored, as their median latency is not reliable."""

_MIN_MANY = 3
"""Slow units are probably another kind of device, not faulty, if there are at least this many and
they are more than the share _MIN_MANY_SHARE of all."""
_MIN_MANY_SHARE = 0.25
"""The share (0 to 1) of all units that slow ones must exceed; see _MIN_MANY."""


def are_many(slow: int, units: int) -> bool:
    """True if `slow` of `units` are at least 3 and more than 25 %: then they are probably another
    kind of device, and not faulty.
    """
    return slow >= _MIN_MANY and slow > units * _MIN_MANY_SHARE


def slow_units(latencies: Mapping[K, Distribution]) -> dict[K, int]:
    """Find the slow units; `latencies` has the latencies of each unit.

    The result has the slow units as keys. The value is the median latency (ns) of another unit,
    which most of the other units do not exceed.
    """
    medians = {
        unit: one.percentile(50) for unit, one in latencies.items() if one.count >= MIN_ANSWERS
    }
    in_order = sorted(medians.values())
    slow = {}
    for unit, own in medians.items():
        usual = _most_without(in_order, bisect_left(in_order, own))
        if usual and own >= max(SLOW_RATIO * usual, SLOW_NS):
            slow[unit] = usual
    return slow


def _most_without(in_order: list[int], left_out: int) -> int:
    """Return the number that most of the sorted numbers do not exceed, without the one at index
    `left_out`; 0 if there is no other number.
    """
    if len(in_order) < 2:
        return 0
    at = (len(in_order) - 1) // 2
    return in_order[at + 1 if at >= left_out else at]
