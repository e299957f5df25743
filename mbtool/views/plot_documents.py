"""Writes the values of registers and bits over time, as a table with a row each, or as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mbtool.views.plot_lines import number_text
from mbtool.views.statistics_columns import StatisticsColumn, StatisticsRow, StyledLine, table_lines
from mbtool.views.tables import printable, printable_json
from mbtool.views.watch_words import sparkline

if TYPE_CHECKING:
    from mbtool.values.value_series import ValueSeries
    from mbtool.values.values import SeriesKey

_BARS = 16
_RANKS = {"recent values": 4, "address": 3, "least": 2, "greatest": 2, "last": 1}
"""The order in which columns are left out in a narrow terminal; the highest number goes first."""


def values_lines(
    series: Mapping[SeriesKey, ValueSeries], width: int | None, *, unicode: bool
) -> list[StyledLine]:
    """Return a table with a row for each register, bit or point (named value).

    Those that change most often come first. `width` is the terminal's in characters, None on a
    pipe. `unicode` adds a column that draws the last values as bars. A column without any text is
    left out.
    """
    several = len({key.link for key in series}) > 1
    order = sorted(series.items(), key=lambda each: -each[1].changes)
    rows = [_cells(key, one) for key, one in order]
    names = [
        name
        for name in rows[0]
        if any(row[name] for row in rows)
        and (several or name != "link")
        and (unicode or name != "recent values")
    ]
    columns = [
        StatisticsColumn(
            name, 1 + max(len(name), *(len(row[name]) for row in rows)), _RANKS.get(name, 0)
        )
        for name in names
    ]
    return table_lines(
        "value",
        columns,
        [
            StatisticsRow(one.name, [row[name] for name in names])
            for (_, one), row in zip(order, rows, strict=True)
        ],
        width,
    )


def _cells(key: SeriesKey, one: ValueSeries) -> dict[str, str]:
    """Return the cells of a row, by their headings."""
    numbers = [sample.value for sample in one.samples]
    least, greatest = map(number_text, (min(numbers), max(numbers))) if numbers else ("", "")
    return {
        "link": printable(key.link),
        "unit": str(key.unit),
        "address": printable(one.reference),
        "changes": f"{one.changes:,}",
        "least": least,
        "greatest": greatest,
        "last": printable(one.last_text or (number_text(numbers[-1]) if numbers else "")),
        "recent values": sparkline(numbers[-_BARS:], _BARS),
    }


def values_json(
    series: Mapping[SeriesKey, ValueSeries], sources: Sequence[str], left_out: int
) -> str:
    """Return each register, bit or point (named value) with its changes as JSON.

    `sources` are the paths of the files, `left_out` is the number of values that were not
    collected, because there were too many. Times are in ns since 1970.
    """
    rows: list[dict[str, Any]] = [
        {
            "link": key.link,
            "unit": key.unit,
            "name": one.name,
            "reference": one.reference,
            "measure": one.unit,
            "changes": one.changes,
            "texts": [
                [value, text] for value, text in one.texts.items() if text != number_text(value)
            ],
            "samples": [[sample.ts_ns, sample.value] for sample in one.samples],
        }
        for key, one in series.items()
    ]
    document = {"schema": 1, "sources": [*sources], "left_out": left_out, "values": rows}
    return f"{printable_json(json.dumps(document, ensure_ascii=False))}\n"
