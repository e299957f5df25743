"""Writes the values of registers and bits over time, as a table with a row each, or as JSON."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from mbtool.views.plot_lines import number_text
from mbtool.views.tables import plain, plain_table, printable_json
from mbtool.views.watch_words import sparkline

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

    from mbtool.series.value_series import ValueSeries
    from mbtool.series.values import SeriesKey

_BARS = 16


def values_table(series: Mapping[SeriesKey, ValueSeries], *, unicode: bool) -> Table:
    """Return a table with a row for each register, bit or point (named value).

    Those that change most often come first. `unicode` adds a column that draws the last values as
    bars.
    """
    several = len({key.link for key in series}) > 1
    table = plain_table(
        *(["link"] if several else []), "unit", "value", "address", "changes", "from", "to", "last",
        *(["course"] if unicode else []),
    )  # fmt: skip
    for key, one in sorted(series.items(), key=lambda each: -each[1].changes):
        numbers = [sample.value for sample in one.samples]
        ends = map(number_text, (min(numbers), max(numbers))) if numbers else ("", "")
        last = one.last_text or (number_text(numbers[-1]) if numbers else "")
        cells = [
            *([key.link] if several else []), str(key.unit), one.name, one.reference,
            f"{one.changes:,}", *ends, last,
            *([sparkline(numbers[-_BARS:], _BARS)] if unicode else []),
        ]  # fmt: skip
        table.add_row(*map(plain, cells))
    return table


def values_json(series: Mapping[SeriesKey, ValueSeries], sources: Sequence[str]) -> str:
    """Return each register, bit or point (named value) with its changes as JSON.

    `sources` are the paths of the files. Times are in ns since 1970.
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
    text = json.dumps({"schema": 1, "sources": [*sources], "values": rows}, ensure_ascii=False)
    return f"{printable_json(text)}\n"
