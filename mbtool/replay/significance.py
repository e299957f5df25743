"""Whether two samples differ by more than chance: a rank test and a test of two shares."""

# Latencies have long tails and heaps at a timer's ticks, so nothing is assumed of their form:
#
#     rank_sum    Mann and Whitney's U with the correction for ties, by its normal approximation.
#                 From SMALLEST values on each side; for fewer it is too rough, and gives 1.
#     same_share  Fisher's exact test, two-sided: k of n here against l of m there.
#
# With many values the smallest shift is beyond chance, so `rank_sum` also gives the chance that a
# value from b exceeds one from a (Vargha and Delaney's A): 0.5 is none, and from 0.64 on (or 0.36
# down) it is of medium size by their scale.
#
# Cost: rank_sum sorts, same_share sums at most k + l terms.

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

SMALLEST = 8
MEDIUM = 0.14
"""How far from 0.5 a medium chance is."""

_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Shift:
    """How b stands to a."""

    p: float
    """How likely a difference like this is where there is none."""
    exceeds: float
    """The chance that a value of b is more than one of a; equal ones count half."""

    @property
    def is_medium(self) -> bool:
        return abs(self.exceeds - 0.5) >= MEDIUM


def rank_sum(a: Sequence[float], b: Sequence[float]) -> Shift:
    """Whether the values of b tend to be more, or less, than those of a."""
    if min(len(a), len(b)) < SMALLEST:
        return Shift(1.0, 0.5)
    both = sorted([(value, 0) for value in a] + [(value, 1) for value in b])
    ranks_of_b, ties, before = 0.0, 0, 0
    for _, equal in groupby(both, key=lambda one: one[0]):
        members = [of_b for _, of_b in equal]
        count = len(members)
        ranks_of_b += (before + (count + 1) / 2) * sum(members)
        ties += count**3 - count
        before += count
    n, m = len(a), len(b)
    u = ranks_of_b - m * (m + 1) / 2
    variance = n * m / 12 * (n + m + 1 - ties / ((n + m) * (n + m - 1)))
    if variance <= 0:  # All values are equal.
        return Shift(1.0, 0.5)
    z = max(abs(u - n * m / 2) - 0.5, 0.0) / math.sqrt(variance)
    return Shift(math.erfc(z / math.sqrt(2)), u / (n * m))


def same_share(k: int, n: int, other_k: int, other_n: int) -> float:
    """How likely shares as far apart as k of n and other_k of other_n are where there is one."""
    hits, lowest = k + other_k, max(0, k + other_k - other_n)
    logs = [_log_chance(each, n, hits, n + other_n) for each in range(lowest, min(hits, n) + 1)]
    here = logs[k - lowest] + _ROUNDING
    return min(1.0, sum(math.exp(each) for each in logs if each <= here))


def _log_chance(k: int, n: int, hits: int, whole: int) -> float:
    """The logarithm of the chance that k of all `hits` fall among n of the `whole`."""
    return _log_choices(n, k) + _log_choices(whole - n, hits - k) - _log_choices(whole, hits)


def _log_choices(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
