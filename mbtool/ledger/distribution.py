"""Counts durations in buckets, so that percentiles of many durations need little memory."""

# A bucket holds all durations whose first `bits` binary digits are equal (an HDR histogram). At
# first `bits` is larger than the number of digits of any duration, so each bucket holds one exact
# duration. When there are more than `limit` buckets, `bits` is reduced until at most half of
# `limit` are left. So percentiles are exact if there are few different durations; else their error
# is at most 1/2**bits (`error`). Measured with 1024 buckets and 100,000 durations: an error of
# 1.6 % if the longest is 10,000 times the shortest, 0.02 % if all differ by at most 10 %.
#
# The number, the sum, the least and the greatest of the durations are always exact.
#
# Memory: `limit` buckets of about 100 bytes each.

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

MAX_BUCKETS = 1024
"""The most buckets of a distribution; beyond it, they become twice as wide."""
_EXACT_BITS = 64
_STEPS = (1, 2, 5)
"""The widths of bars are these numbers times a power of ten."""
_MICROSECOND = 1000
PERCENTILES = (50, 95, 99)
"""The percentiles of latencies that statistics, the report and the metrics show."""
_MAX_TAIL_RATIO = 1.5
"""Bars end at the greatest duration if it is at most this many times the 99th percentile, else at
the 99th percentile."""


class Bucket(NamedTuple):
    """The number of durations from `low_ns` up to, but not including, `high_ns`."""

    low_ns: int
    high_ns: int
    number: int


class Distribution:
    """A set of durations in ns. `add` ignores negative durations, which come from a clock that was
    set back.
    """

    __slots__ = ("_buckets", "_limit", "bits", "count", "greatest", "least", "total")

    def __init__(self, limit: int = MAX_BUCKETS) -> None:
        self._limit = limit
        self._buckets: dict[int, int] = {}
        """The number of durations in each bucket; the key is the least duration (ns) that the
        bucket can hold."""
        self.bits = _EXACT_BITS
        self.count = 0
        self.total = 0
        self.least = 0
        self.greatest = 0

    def add(self, ns: int) -> None:
        if ns < 0:
            return
        if not self.count:
            self.least = self.greatest = ns
        elif ns < self.least:
            self.least = ns
        elif ns > self.greatest:
            self.greatest = ns
        self.count += 1
        self.total += ns
        self._put(ns, 1)

    def add_all(self, durations: Sequence[int]) -> None:
        """Add several durations (ns), none of them negative. The result is the same as if `add` was
        called for each.
        """
        if not durations:
            return
        least, greatest = min(durations), max(durations)
        self.least = min(self.least, least) if self.count else least
        self.greatest = max(self.greatest, greatest)
        self.count += len(durations)
        self.total += sum(durations)
        lows: dict[int, int] = {}
        for ns, count in Counter(durations).items():
            low = self._low(ns)
            lows[low] = lows.get(low, 0) + count
        if len(self._buckets.keys() | lows.keys()) > self._limit:
            for ns in durations:  # At some duration `_put` will reduce the number of buckets.
                self._put(ns, 1)
            return
        for low, count in lows.items():
            self._buckets[low] = self._buckets.get(low, 0) + count

    def merge(self, other: Distribution) -> None:
        """Add all durations of another distribution to this one."""
        if not other.count:
            return
        self.least = min(self.least, other.least) if self.count else other.least
        self.greatest = max(self.greatest, other.greatest)
        self.count += other.count
        self.total += other.total
        if other.bits < self.bits:
            self._coarsen(other.bits)
        for low, count in other._buckets.items():
            self._put(low, count)

    @property
    def mean(self) -> float:
        return self.total / self.count if self.count else 0.0

    @property
    def error(self) -> float:
        """The largest relative error of a percentile, such as 0.01 for 1 %; 0 if percentiles are
        exact.
        """
        return 0.0 if self.bits == _EXACT_BITS else 0.5**self.bits

    def percentile(self, percent: float) -> int:
        """Return a duration (ns) that `percent` % of all durations do not exceed (nearest rank).

        `percent` is above 0 and at most 100. Returns 0 if there are no durations.
        """
        rank = -(-self.count * percent // 100)
        seen = 0
        for low in sorted(self._buckets):
            seen += self._buckets[low]
            if seen >= rank:
                middle = low + (self._width(low) - 1) // 2
                return min(max(middle, self.least), self.greatest)
        return 0

    def count_at_least(self, ns: int) -> int:
        """Return how many durations are `ns` or longer, as exactly as `error` says."""
        return sum(count for low, count in self._buckets.items() if low + self._width(low) > ns)

    def histogram(self) -> list[Bucket]:
        """Count the durations in steps that begin at 0, 1, 2, 5, 10, 20 us and so on.

        Steps without durations at both ends are left out.
        """
        counts: dict[int, int] = {}
        for low, count in self._buckets.items():
            step = _step(min(max(low + (self._width(low) - 1) // 2, self.least), self.greatest))
            counts[step] = counts.get(step, 0) + count
        if not counts:
            return []
        return [
            Bucket(_edge(step), _edge(step + 1), counts.get(step, 0))
            for step in range(min(counts), max(counts) + 1)
        ]

    def bars(self, most: int = 40) -> tuple[list[Bucket], int]:
        """Count the durations in at most `most` + 1 bars of equal width, and those beyond the bars.

        The bars end at the 99th percentile, or at the greatest duration if that is not far away.
        """
        if not self.count:
            return [], 0
        end = self.percentile(99)
        end = self.greatest if self.greatest <= _MAX_TAIL_RATIO * end else end
        width = _nice_width((end - self.least) / most)
        first, last = self.least // width, end // width
        counts: dict[int, int] = {}
        for low, count in self._buckets.items():
            middle = min(max(low + (self._width(low) - 1) // 2, self.least), self.greatest)
            counts[middle // width] = counts.get(middle // width, 0) + count
        bars = [
            Bucket(bar * width, (bar + 1) * width, counts.get(bar, 0))
            for bar in range(first, last + 1)
        ]
        return bars, self.count - sum(bar.number for bar in bars)

    def _put(self, ns: int, count: int) -> None:
        low = self._low(ns)
        self._buckets[low] = self._buckets.get(low, 0) + count
        if len(self._buckets) > self._limit:
            self._shrink()

    def _low(self, ns: int) -> int:
        """The least duration (ns) that is in the same bucket as the duration `ns`."""
        shift = ns.bit_length() - self.bits
        return ns >> shift << shift if shift > 0 else ns

    def _width(self, low: int) -> int:
        return 1 << max(low.bit_length() - self.bits, 0)

    def _shrink(self) -> None:
        while len(self._buckets) > self._limit // 2:
            self._coarsen(min(self.bits, max(self._buckets).bit_length()) - 1)

    def _coarsen(self, bits: int) -> None:
        buckets, self._buckets, self.bits = self._buckets, {}, bits
        for low, count in buckets.items():
            coarse = self._low(low)
            self._buckets[coarse] = self._buckets.get(coarse, 0) + count


def _nice_width(least_ns: float) -> int:
    """Return the least of 1, 2, 5, 10, 20 us and so on that is not below `least_ns`, in ns."""
    width, at = _MICROSECOND, 0
    while width < least_ns:
        at += 1
        width = _STEPS[at % len(_STEPS)] * 10 ** (at // len(_STEPS)) * _MICROSECOND
    return width


def _edge(step: int) -> int:
    """The duration (ns) at which step number `step` of the histogram begins; step 0 begins at 0."""
    if not step:
        return 0
    decade, within = divmod(step - 1, len(_STEPS))
    return int(_STEPS[within] * 10**decade * _MICROSECOND)


def _step(ns: int) -> int:
    """The number of the histogram's step that the duration `ns` belongs to, from 0."""
    if ns < _MICROSECOND:
        return 0
    decade = len(str(ns // _MICROSECOND)) - 1
    first = decade * len(_STEPS) + 1
    return max(step for step in range(first, first + len(_STEPS)) if _edge(step) <= ns)
