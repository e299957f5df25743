"""Tests whether two samples differ significantly: a rank test and a test of two shares."""

# Latencies have long tails and clusters at a timer's ticks, so no distribution is assumed:
#
#     rank_sum    the Mann-Whitney U test with correction for ties, in its normal approximation. It
#                 needs MIN_VALUES values on each side; with fewer the approximation is too rough,
#                 and p is 1.
#     same_share  Fisher's exact test, two-sided, for k of n against l of m.
#
# With many values even a tiny shift is significant. So `rank_sum` also gives the probability that
# a random value of sample b exceeds a random value of sample a (Vargha and Delaney's A): 0.5 means
# no shift; at least 0.64, or at most 0.36, is at least a medium shift on their scale.
#
# Cost: rank_sum sorts all values; same_share sums at most k + l terms.

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

ALPHA = 0.01
"""The significance level of a whole comparison. Each of its tests gets ALPHA, divided by the number
of tests (Bonferroni)."""
MIN_VALUES = 8
MEDIUM = 0.14
"""The shift between samples a and b is at least of medium size if `Shift.exceeds` differs from 0.5
by at least this."""

_ROUNDING = 1e-9
"""In Fisher's test, an outcome counts as at most as likely as the observed one if its log
probability is at most this much higher, which allows for rounding errors."""


@dataclass(frozen=True, slots=True)
class Shift:
    """The result of a rank test that compares the samples a and b."""

    p: float
    """The p-value: the probability of a difference at least as great as the one found, if both
    samples come from the same distribution."""
    exceeds: float
    """The probability that a random value of b is greater than a random one of a. A pair of equal
    values counts half."""

    @property
    def is_medium(self) -> bool:
        return abs(self.exceeds - 0.5) >= MEDIUM


def rank_sum(a: Sequence[float], b: Sequence[float]) -> Shift:
    """Test whether the values of b tend to be greater or smaller than those of a.

    With fewer than MIN_VALUES values on one side, the result is no difference (p = 1).
    """
    if min(len(a), len(b)) < MIN_VALUES:
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
    """Test whether two shares differ: k of n, and other_k of other_n. Returns the p-value.

    The p-value is the probability of a difference at least as great, if the true shares are equal.
    """
    hits, lowest = k + other_k, max(0, k + other_k - other_n)
    logs = [_log_chance(each, n, hits, n + other_n) for each in range(lowest, min(hits, n) + 1)]
    here = logs[k - lowest] + _ROUNDING
    return min(1.0, sum(math.exp(each) for each in logs if each <= here))


def _log_chance(k: int, n: int, hits: int, whole: int) -> float:
    """The natural logarithm of the probability that exactly k of the first n items are chosen, if
    `hits` of `whole` items are chosen at random.
    """
    return _log_choices(n, k) + _log_choices(whole - n, hits - k) - _log_choices(whole, hits)


def _log_choices(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
