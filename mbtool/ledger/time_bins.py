"""Adds up counts in spans of time (bins), which become wider as the capture becomes longer."""

# A row is one thing that is counted, such as a unit. All rows have bins with the same bounds, so
# that charts of several rows have one time axis. A bin begins at a multiple of its width in UTC.
# Each width of _WIDTHS_NS is a multiple of the one before it, so a wider bin consists of whole
# narrower ones.
#
# Memory: `limit` bins for each row; the caller limits the number of rows.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

MAX_BINS = 300
_MS = 1_000_000
_S = 1000 * _MS
_HOUR = 3600 * _S
_WIDTHS_NS = (
    _MS, 2 * _MS, 10 * _MS, 20 * _MS, 100 * _MS, 200 * _MS, _S, 2 * _S, 10 * _S, 30 * _S, 60 * _S,
    120 * _S, 600 * _S, 1800 * _S, _HOUR, 2 * _HOUR, 6 * _HOUR, 24 * _HOUR,
)  # fmt: skip

Bin = list[int]
"""The sums in one span of time, such as requests and bytes; their meaning is the caller's. The last
two items are the least and the greatest value noted in the span by note_value; both 0 if none."""
LEAST, GREATEST = -2, -1


REQUESTS_IN_BIN = 5
"""A bin of a chart is at least so many requests wide in the mean. Narrower ones would show single
requests, as a comb; much wider ones would leave a capture of 100 requests only a few."""


class TimeBins:
    """Sums for each row (such as a unit) and each span of time (bin)."""

    def __init__(self, sums: int, limit: int = MAX_BINS) -> None:
        """`sums` is the number of sums in each bin, `limit` the greatest number of bins per row."""
        self._empty = [0] * (sums + 2)
        self._limit = limit
        self._rows: dict[Hashable, dict[int, Bin]] = {}
        self._first = self._last = 0
        """The numbers of the first and the last bin. A bin's number is the ns from 1970 to its
        begin, divided by `width_ns`."""
        self._step = 0
        self.width_ns = _WIDTHS_NS[0]

    def bin(self, row: Hashable, at_ns: int) -> Bin:
        """Return the sums of a row for a time, so that the caller can add to them.

        The list is valid until the next call, which may merge bins into wider ones.
        """
        number = at_ns // self.width_ns
        if not self._rows:
            self._first = self._last = number
        elif not self._first <= number <= self._last:
            number = self._reach(number, at_ns)
        bins = self._rows.get(row)
        if bins is None:
            bins = self._rows[row] = {}
        found = bins.get(number)
        if found is None:
            found = bins[number] = self._empty.copy()
        return found

    def __contains__(self, row: Hashable) -> bool:
        return row in self._rows

    def __len__(self) -> int:
        """The number of rows (counted things, such as units)."""
        return len(self._rows)

    @property
    def rows(self) -> Sequence[Hashable]:
        return list(self._rows)

    @property
    def begin_ns(self) -> int:
        """The beginning of the first bin, in UTC ns."""
        return self._first * self.width_ns

    @property
    def count(self) -> int:
        """The number of bins from the first to the last one, including empty ones."""
        return self._last - self._first + 1 if self._rows else 0

    def column(self, row: Hashable, place: int) -> list[int]:
        """Return one sum of a row for each bin, from the first to the last; 0 in an empty bin.

        `place` is the index of the sum in a bin, such as UnitSum.RETRIES.
        """
        bins = self._rows.get(row, {})
        numbers = range(self._first, self._last + 1)
        return [bins[one][place] if one in bins else 0 for one in numbers]

    def coarser(self, most: int) -> TimeBins:
        """Return the same sums in at most `most` bins (at least 1), or this object if it has no
        more.
        """
        made = TimeBins(len(self._empty) - 2, max(most, 1))
        if self.count <= made._limit:
            return self
        made._step, made.width_ns = self._step, self.width_ns
        made._first, made._last = self._first, self._last
        made._rows = {
            row: {number: one.copy() for number, one in bins.items()}
            for row, bins in self._rows.items()
        }
        while made.count > made._limit and made._step + 1 < len(_WIDTHS_NS):
            made._widen()
        return made

    def _reach(self, number: int, at_ns: int) -> int:
        """Add bins up to the time `at_ns`, which is before the first bin or after the last.

        `number` is the time's bin at the present width. If there would be too many bins, all become
        wider; so the number of the time's bin is returned.
        """
        first, last = min(self._first, number), max(self._last, number)
        while last - first >= self._limit and self._step + 1 < len(_WIDTHS_NS):
            self._widen()
            number = at_ns // self.width_ns
            first, last = min(self._first, number), max(self._last, number)
        # Bins of one day are the widest. A time that needs more of them is in no real capture; it
        # is counted in the first or the last bin.
        if last - first >= self._limit:
            return min(max(number, self._first), self._last)
        self._first, self._last = first, last
        return number

    def _widen(self) -> None:
        self._step += 1
        before, self.width_ns = self.width_ns, _WIDTHS_NS[self._step]
        ratio = self.width_ns // before
        self._first //= ratio
        self._last //= ratio
        for row, bins in self._rows.items():
            wider: dict[int, Bin] = {}
            for number, one in bins.items():
                other = wider.get(number // ratio)
                if other is None:
                    wider[number // ratio] = one
                else:
                    _merge(other, one)
            self._rows[row] = wider


def note_value(one: Bin, value: int) -> None:
    """Update the least and the greatest value of a bin with `value`, which is above 0; 0 in a bin
    means that it has no value yet.
    """
    if value > one[GREATEST]:
        one[GREATEST] = value
    if value < one[LEAST] or not one[LEAST]:
        one[LEAST] = value


def _merge(into: Bin, other: Bin) -> None:
    for place in range(len(into) - 2):
        into[place] += other[place]
    if other[GREATEST]:
        note_value(into, other[GREATEST])
        note_value(into, other[LEAST])
