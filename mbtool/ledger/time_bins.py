"""Adds up counts in spans of time (bins), which become wider as the recording becomes longer."""

# A row is one thing that is counted: a unit or a link. A bin begins at a multiple of its width in
# UTC. Each width in _WIDTHS_NS is a multiple of the one before it, so a wider bin consists of whole
# narrower ones, and rows of different widths can be shown in one chart. As long as MAX_CELLS is not
# reached, the width depends on the counted times only, not on their order.
#
# Memory: for each row at most MAX_BINS bins, or MAX_HOURS if they are an hour wide or wider. Empty
# bins take no memory. All rows together have at most MAX_CELLS bins; beyond that, the limit of each
# row is halved. With the greatest width, all 64-bit times in ns are in 215 bins.

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

MAX_BINS = 256
"""A row has at most this many bins; beyond it, its bins become wider."""
MAX_HOURS = 768
"""A row whose bins are an hour wide or wider has at most this many bins: 32 days of hours. Beyond
it, its bins become wider."""
MAX_CELLS = 1 << 20
"""If all rows together have more bins than this, the limit of bins of each row is halved."""
_MS = 1_000_000
_S = 1000 * _MS
HOUR_NS = 3600 * _S
_DAY = 24 * HOUR_NS
_WIDTHS_NS = (
    _MS, 2 * _MS, 10 * _MS, 20 * _MS, 100 * _MS, 200 * _MS, _S, 2 * _S, 10 * _S, 30 * _S, 60 * _S,
    120 * _S, 600 * _S, 1800 * _S, HOUR_NS, 2 * HOUR_NS, 6 * HOUR_NS, _DAY, 10 * _DAY, 100 * _DAY,
    1000 * _DAY,
)  # fmt: skip
"""The widths of bins (ns); each is a multiple of the one before it."""
_JUDGED_BINS = 64
"""A unit is judged by at most this many bins. In more, narrower bins, single late answers would
decide."""


class UnitSum(IntEnum):
    """The numbers that are counted for a unit in each bin; the value is the index in its sums."""

    REQUESTS = 0
    OK = 1
    EXCEPTION = 2
    NO_ANSWER = 3
    LATE = 4
    RETRIES = 5
    """Requests that repeat an unanswered one at once, not at the usual period of their poll."""
    BAD_CHECK = 6
    """Requests whose response came with a wrong CRC or LRC; they are in NO_ANSWER, too."""
    LATENCIES = 7
    """The number of requests whose latency is known."""
    LATENCY_NS = 8
    """The sum of all known latencies, in ns."""
    GREATEST_NS = 9
    """The greatest latency in ns; no sum."""


class LinkSum(IntEnum):
    """The numbers that are counted for a link in each bin; the value is the index in its sums."""

    REQUESTS = 0
    BYTES = 1
    """All bytes, both those of ADUs and those that belong to no ADU."""
    BAD_CHECK = 2
    NO_ANSWER = 3
    NO_FRAME = 4
    """Events about bytes that belong to no ADU."""
    LACKING = 5
    """Events about bytes that the capture lacks."""


_GREATEST = UnitSum.GREATEST_NS
_EMPTY = [0] * len(UnitSum)

Cell = list[int]
"""The sums of one row in one bin, by UnitSum or LinkSum."""


class HourCount(NamedTuple):
    """The requests in one hour, or in a wider bin, that begins at `begin_ns` (UTC ns)."""

    begin_ns: int
    requests: int
    missing: int
    """The number of requests that got no answer."""


class UnitBin(NamedTuple):
    """The requests to a unit in one bin."""

    begin_ns: int
    end_ns: int
    asked: int
    answered: int
    latency_ns: int
    """The sum of the latencies (ns) of the answered requests."""


class TimeBins:
    """The bins of all rows."""

    def __init__(self) -> None:
        self.share = 1
        """The greatest number of bins of a row is divided by this number, because there are many
        rows."""
        self.cells = 0
        """The number of bins of all rows."""
        self._rows: list[Row] = []

    def row(self) -> Row:
        """Return a new row without bins."""
        row = Row(self)
        self._rows.append(row)
        return row

    def fit(self) -> None:
        """Make the bins of all rows wider while there are too many."""
        while self.cells > MAX_CELLS and self.share < MAX_BINS:
            self.share *= 2
            for row in self._rows:
                row.fit()

    def chart(self, most: int) -> Chart:
        """Return bins for a chart of all rows: at most `most` (at least 1), where possible."""
        rows = [row for row in self._rows if row.cells]
        if not rows:
            return Chart(_WIDTHS_NS[0], 0, 0)
        begin_ns = min(row.width_ns * min(row.cells) for row in rows)
        end_ns = max(row.width_ns * (max(row.cells) + 1) for row in rows)
        widest_ns = max(row.width_ns for row in rows)
        for width_ns in _WIDTHS_NS:
            first, last = begin_ns // width_ns, (end_ns - 1) // width_ns
            if width_ns >= widest_ns and last - first < max(most, 1):
                break
        return Chart(width_ns, first, last - first + 1)


class Row:
    """The bins of one unit or link."""

    __slots__ = ("_every", "_step", "cells", "width_ns")

    def __init__(self, every: TimeBins) -> None:
        self._every = every
        self._step = 0
        self.width_ns = _WIDTHS_NS[0]
        self.cells: dict[int, Cell] = {}
        """The sums of the bins that are not empty. The key of a bin is the ns from 1970 to its
        begin, divided by `width_ns`."""

    def cell(self, at_ns: int) -> Cell:
        """Return the sums for a time, so that the caller can add to them.

        They are valid until the next call, which may make the bins wider.
        """
        found = self.cells.get(at_ns // self.width_ns)
        return found if found is not None else self._new_cell(at_ns)

    def cells_of(self, times_ns: Sequence[int]) -> Iterator[tuple[Cell, int, int]]:
        """Yield the sums for many times (UTC ns, sorted), each with the indices of the first time
        that belongs to it, and of the first time that does not.
        """
        self.fit(times_ns)
        begin = 0
        while begin < len(times_ns):
            found = self.cell(times_ns[begin])
            end_ns = (times_ns[begin] // self.width_ns + 1) * self.width_ns
            end = bisect_left(times_ns, end_ns, begin)
            yield found, begin, end
            begin = end

    def hours(self) -> list[HourCount]:
        """Return the requests of a link for each hour that has some; for wider bins if these are
        wider than an hour.
        """
        width_ns = max(HOUR_NS, self.width_ns)
        hours = self._joined(width_ns // self.width_ns, LinkSum.REQUESTS, LinkSum.NO_ANSWER)
        return [HourCount(hour * width_ns, *both) for hour, both in hours.items() if both[0]]

    def bins(self) -> list[UnitBin]:
        """Return the requests to a unit in at most _JUDGED_BINS bins, without those that have none,
        sorted by time.
        """
        ratio = 1
        while len({number // ratio for number in self.cells}) > _JUDGED_BINS:
            ratio *= 2
        joined = self._joined(ratio, UnitSum.REQUESTS, UnitSum.LATENCIES, UnitSum.LATENCY_NS)
        width_ns = ratio * self.width_ns
        return [
            UnitBin(number * width_ns, (number + 1) * width_ns, *sums)
            for number, sums in joined.items()
            if sums[0]
        ]

    def asked_before(self, at_ns: int) -> int:
        """Return about how many requests to a unit were sent before `at_ns` (UTC ns).

        In the bin of that time, requests are taken to come at equal distances.
        """
        wanted, behind_ns = divmod(at_ns, self.width_ns)
        number = sum(cell[UnitSum.REQUESTS] for at, cell in self.cells.items() if at < wanted)
        own = self.cells.get(wanted, _EMPTY)[UnitSum.REQUESTS]
        return number + own * behind_ns // self.width_ns

    def total(self, *places: int) -> int:
        """Return the sum of some sums over all bins."""
        return sum(cell[place] for cell in self.cells.values() for place in places)

    def fit(self, times_ns: Sequence[int] = ()) -> None:
        """Make the bins wider while there are too many, with those that `times_ns` needs."""
        while self._step + 1 < len(_WIDTHS_NS) and self._number_with(times_ns) > self._most:
            before = len(self.cells)
            self._step += 1
            ratio = _WIDTHS_NS[self._step] // self.width_ns
            self.width_ns = _WIDTHS_NS[self._step]
            wider: dict[int, Cell] = {}
            for number, cell in self.cells.items():
                other = wider.get(number // ratio)
                wider[number // ratio] = cell if other is None else _added(other, cell)
            self.cells = wider
            self._every.cells -= before - len(wider)

    def _number_with(self, times_ns: Sequence[int]) -> int:
        """Return the number of bins, with those that `times_ns` needs."""
        if len(self.cells) + len(times_ns) <= self._most:
            return len(self.cells)
        return len(self.cells.keys() | {at_ns // self.width_ns for at_ns in times_ns})

    @property
    def _most(self) -> int:
        most = MAX_HOURS if self.width_ns >= HOUR_NS else MAX_BINS
        return most // self._every.share

    def _new_cell(self, at_ns: int) -> Cell:
        every, cells = self._every, self.cells
        cell = cells[at_ns // self.width_ns] = _EMPTY.copy()
        every.cells += 1
        if len(cells) * every.share <= MAX_BINS and every.cells <= MAX_CELLS:
            return cell
        self.fit()
        every.fit()
        return self.cells[at_ns // self.width_ns]

    def _joined(self, ratio: int, *places: int) -> dict[int, list[int]]:
        """Return some sums of bins that are `ratio` times as wide, sorted by time."""
        joined: dict[int, list[int]] = {}
        for number, cell in sorted(self.cells.items()):
            sums = joined.setdefault(number // ratio, [0] * len(places))
            for at, place in enumerate(places):
                sums[at] += cell[place]
        return joined


class Chart(NamedTuple):
    """Bins that all rows of a chart share."""

    width_ns: int
    first: int
    """The number of the first bin: the ns from 1970 to its begin, divided by `width_ns`."""
    bins: int
    """The number of bins from the first to the last one, including empty ones."""

    @property
    def begin_ns(self) -> int:
        """The beginning of the first bin, in UTC ns."""
        return self.first * self.width_ns

    def column(self, row: Row, place: int) -> list[int]:
        """Return one sum of a row for each bin, from the first to the last; 0 in an empty bin.

        `place` is the index of the sum in a cell, such as UnitSum.RETRIES.
        """
        column = [0] * self.bins
        ratio = self.width_ns // row.width_ns
        for number, cell in row.cells.items():
            at = number // ratio - self.first
            if place == _GREATEST:
                column[at] = max(column[at], cell[place])
            else:
                column[at] += cell[place]
        return column


def _added(cell: Cell, other: Cell) -> Cell:
    sums = [a + b for a, b in zip(cell, other, strict=True)]
    sums[_GREATEST] = max(cell[_GREATEST], other[_GREATEST])
    return sums
