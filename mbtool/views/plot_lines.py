"""Draws values over time in characters: numbers as steps, bits as bands."""

# Each column of a chart stands for an equal part of the time. It shows all numbers from the least
# to the greatest value of that time, including the value that the part began with; so no peak is
# lost. A character of the Braille patterns (Unicode U+2800) has two columns and four rows of dots;
# on a terminal without Unicode, a `*` stands for one dot.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.moments import DAY_NS, SECOND_NS, clock_time, day
from mbtool.views.statistics_columns import StyledLine
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from mbtool.values.value_series import SeriesSample, ValueSeries
    from mbtool.values.values import SeriesKey

LEAST_ROWS, MOST_ROWS = 3, 12
_MOST_LABEL = 16
_BANDS = {True: ("▁", "█", "▄"), False: ("_", "#", "+")}
"""The characters for a bit that is 0, is 1, or is both within a column; the key is True for
Unicode."""
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""The bits of a Braille pattern that stand for its dots; a pair for each of the four rows."""

Extent = tuple[float, float] | None
"""The least and the greatest value within one column of a chart; None before the first value."""


class PlotSize(NamedTuple):
    """The size of the charts in characters, and the kind of characters."""

    width: int
    rows: int
    """The height of each chart of numbers; the chart of a bit always has one row."""
    unicode: bool = True


def plot_lines(
    series: Sequence[tuple[SeriesKey, ValueSeries]], begin_ns: int, end_ns: int, size: PlotSize
) -> list[StyledLine]:
    """Draw a chart for each series of values that changes, one below the other, over one time axis.

    A series without changes gets only its title. Times are in ns since 1970.
    """
    several = len({key.link for key, _ in series}) > 1
    labels = {key: _labels(one, size.rows) for key, one in series if one.changes}
    margin = min(
        max((len(text) for some in labels.values() for text in some), default=0), _MOST_LABEL
    )
    width = max(size.width - margin - 1, 10)
    lines = []
    for key, one in series:
        lines.append(StyledLine(series_title(key, one, with_link=several)[: size.width], "bold"))
        if key in labels:
            rows = _chart(one, begin_ns, end_ns, size._replace(width=width))
            lines += [
                StyledLine(f"{label[:margin]:>{margin}} {row}".rstrip(), "cyan")
                for label, row in zip(labels[key], rows, strict=True)
            ]
    lines.append(StyledLine(f"{'':>{margin}} {_time_axis(begin_ns, end_ns, width)}", "dim"))
    return lines


def series_title(key: SeriesKey, one: ValueSeries, *, with_link: bool = False) -> str:
    """Return the title of a chart: `CH1 (RWr2), unit 0: 1190 to 1200 mV, 2 changes`.

    It has the name and the unit of the slave (with `with_link` also its link), and the least and
    greatest value.
    """
    name = f"{one.name} ({one.reference})" if one.reference not in ("", one.name) else one.name
    place = f"{key.link} unit {key.unit}" if with_link else f"unit {key.unit}"
    numbers = [sample.value for sample in one.samples]
    unit = f" {one.unit}" if one.unit else ""
    if not numbers:
        went = one.last_text
    elif min(numbers) == max(numbers):
        went = f"always {one.texts.get(numbers[0]) or number_text(numbers[0]) + unit}"
    else:
        went = f"{number_text(min(numbers))} to {number_text(max(numbers))}{unit}, "
        went += f"{one.changes:,} changes" if one.changes != 1 else "1 change"
    return printable(f"{name}, {place}: {went}")


def number_text(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else f"{value:.6g}"


def extents(
    samples: Sequence[SeriesSample], begin_ns: int, end_ns: int, count: int
) -> list[Extent]:
    """Return the least and the greatest value within each of `count` equal parts of the time.

    The time goes from `begin_ns` to `end_ns`. A value lasts until the next sample, so the last
    value of one part counts in the next part, too. A part before the first sample has None.
    """
    in_order = sorted(samples, key=lambda one: one.ts_ns)
    held: float | None = None
    at = 0
    found: list[Extent] = []
    for piece in range(count):
        until_ns = begin_ns + (end_ns - begin_ns) * (piece + 1) // count
        seen = [] if held is None else [held]
        while at < len(in_order) and (in_order[at].ts_ns < until_ns or piece == count - 1):
            held = in_order[at].value
            seen.append(held)
            at += 1
        found.append((min(seen), max(seen)) if seen else None)
    return found


def _chart(one: ValueSeries, begin_ns: int, end_ns: int, size: PlotSize) -> list[str]:
    if one.bit:
        low, high, both = _BANDS[size.unicode]
        words: dict[Extent, str] = {None: " ", (0, 0): low, (1, 1): high}
        return ["".join(words.get(each, both) for each in
                        extents(one.samples, begin_ns, end_ns, size.width))]  # fmt: skip
    across, down = (2, 4) if size.unicode else (1, 1)
    columns = extents(one.samples, begin_ns, end_ns, size.width * across)
    values = [value for column in columns if column is not None for value in column]
    low_value, high_value = (min(values), max(values)) if values else (0, 0)
    steps = size.rows * down - 1
    room = (high_value - low_value) or 1

    def row_of(value: float) -> int:
        """Return the row of dots for a value: 0, the top row, for the greatest value."""
        return steps - round((value - low_value) / room * steps)

    spans = [None if one is None else (row_of(one[1]), row_of(one[0])) for one in columns]
    return [_cells(spans, row, size) for row in range(size.rows)]


def _cells(spans: Sequence[tuple[int, int] | None], row: int, size: PlotSize) -> str:
    """Draw row `row` of a chart's characters, counted from 0 at the top.

    `spans` has, for each column of dots, the rows of its first and last dot, also from 0 at the
    top; None for a column without values.
    """
    if not size.unicode:
        return "".join("*" if one and one[0] <= row <= one[1] else " " for one in spans)
    cells = []
    for at in range(0, len(spans), 2):
        pattern = 0
        for column, span in enumerate(spans[at : at + 2]):
            for dot in range(4):
                if span is not None and span[0] <= row * 4 + dot <= span[1]:
                    pattern |= _DOTS[dot][column]
        cells.append(chr(0x2800 + pattern) if pattern else " ")
    return "".join(cells)


def _labels(one: ValueSeries, rows: int) -> list[str]:
    """Return the labels at the left of a chart, one for each of its `rows`.

    The top one is the greatest value of the series, the bottom one the least; the others are empty.
    """
    numbers = [sample.value for sample in one.samples]
    if one.bit or not numbers:
        return [""] * (1 if one.bit else rows)
    low, high = (
        printable(one.texts.get(each) or "") if len(one.texts) <= rows else ""
        for each in (min(numbers), max(numbers))
    )
    low, high = low or number_text(min(numbers)), high or number_text(max(numbers))
    return [high, *[""] * (rows - 2), low]


def _time_axis(begin_ns: int, end_ns: int, width: int) -> str:
    """Return a line with `begin_ns` at the left end, `end_ns` at the right and the time between.

    Times are given in ns since 1970, and written in UTC. `width` is in characters.
    """
    exact = 12 if end_ns - begin_ns < 100 * SECOND_NS else 8

    def text(ns: int) -> str:
        time = clock_time(ns)[:exact]
        return f"{day(ns)} {time}" if end_ns - begin_ns >= DAY_NS else time

    first, last = f"{day(begin_ns)} {clock_time(begin_ns)[:exact]}", f"{text(end_ns)} UTC"
    middle = text((begin_ns + end_ns) // 2)
    gap = width - len(first) - len(last)
    if gap < len(middle) + 4:
        return f"{first}{'':>{max(gap, 1)}}{last}"
    left = max((width - len(middle)) // 2 - len(first), 1)
    right = width - len(first) - left - len(middle) - len(last)
    return f"{first}{'':>{left}}{middle}{'':>{right}}{last}"
