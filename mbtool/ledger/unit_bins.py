"""Counts the requests to one unit, and sums up their latencies, in bins of time."""

# The bins are whole multiples of a power of two of ns. Once there are more than MAX_BINS, they
# become twice as wide, so that the counts do not depend on the order in which requests are added: a
# missing answer is known long after later requests were answered.

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

MAX_BINS = 64
_NARROWEST = 20
"""The narrowest bins are 2 to the power of this wide, in ns: 1 ms."""


class UnitBin(NamedTuple):
    """The requests of one bin of time."""

    begin_ns: int
    end_ns: int
    asked: int
    answered: int
    latency_ns: int
    """The sum of the latencies of those that were answered."""


class UnitBins:
    """The bins that have requests: at most MAX_BINS."""

    __slots__ = ("_counts", "_shift")

    def __init__(self) -> None:
        self._shift = _NARROWEST
        self._counts: dict[int, list[int]] = {}
        """By bin the numbers of requests and of answers, and the sum of their latencies in ns. The
        key is the time in ns, shifted to the right by `_shift` bits."""

    def add(self, at_ns: int, latency_ns: int | None) -> None:
        """Count a request sent at `at_ns` (UTC ns); `latency_ns` is None if it has no answer."""
        counts = self._counts.get(at_ns >> self._shift)
        if counts is None:
            counts = self._new_bin(at_ns)
        counts[0] += 1
        if latency_ns is not None:
            counts[1] += 1
            counts[2] += latency_ns

    def add_answered(self, times_ns: list[int], latencies_ns: list[int]) -> None:
        """Count requests that were answered, sent at `times_ns` (UTC ns). It costs less for each
        than `add` if the times are sorted.
        """
        if times_ns != sorted(times_ns):
            for at_ns, latency_ns in zip(times_ns, latencies_ns, strict=True):
                self.add(at_ns, latency_ns)
            return
        begin = 0
        while begin < len(times_ns):
            at_ns = times_ns[begin]
            counts = self._counts.get(at_ns >> self._shift)
            if counts is None:
                counts = self._new_bin(at_ns)
            end_ns = ((at_ns >> self._shift) + 1) << self._shift
            end = bisect_left(times_ns, end_ns, begin)
            counts[0] += end - begin
            counts[1] += end - begin
            counts[2] += sum(latencies_ns[begin:end])
            begin = end

    def bins(self) -> list[UnitBin]:
        """Return the bins that have requests, sorted by time."""
        return [
            UnitBin(key << self._shift, (key + 1) << self._shift, *counts)
            for key, counts in sorted(self._counts.items())
        ]

    def asked_before(self, at_ns: int) -> int:
        """Return about how many requests were sent before `at_ns`.

        In the bin of that time, requests are taken to come at equal distances.
        """
        wanted = at_ns >> self._shift
        number = sum(counts[0] for key, counts in self._counts.items() if key < wanted)
        own = self._counts.get(wanted, (0,))[0]
        return number + ((own * (at_ns - (wanted << self._shift))) >> self._shift)

    def _new_bin(self, at_ns: int) -> list[int]:
        self._counts[at_ns >> self._shift] = [0, 0, 0]
        while len(self._counts) > MAX_BINS:
            self._shift += 1
            wider: dict[int, list[int]] = {}
            for key, counts in self._counts.items():
                kept = wider.get(key >> 1)
                if kept is None:
                    wider[key >> 1] = counts
                else:
                    wider[key >> 1] = [a + b for a, b in zip(kept, counts, strict=True)]
            self._counts = wider
        return self._counts[at_ns >> self._shift]
