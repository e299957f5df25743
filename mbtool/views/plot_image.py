"""Draws values over time as a picture with matplotlib; no other module imports matplotlib."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import IO, TYPE_CHECKING, Any

from mbtool.views.plot_lines import series_title

if TYPE_CHECKING:
    from mbtool.values.value_series import ValueSeries
    from mbtool.values.values import SeriesKey

_TIMES = ["%Y", "%b", "%d", "%H:%M", "%H:%M", "%H:%M:%S.%f"]
_BEGINS = ["", "%Y", "%b", "%b %d", "%H:%M", "%H:%M:%S"]
_DAYS = ["", "%Y", "%Y-%m", "%Y-%m-%d", "%Y-%m-%d", "%Y-%m-%d"]
"""The labels at the time axis, those where a year, month, day, hour or minute begins, and the date
at its end; each for ticks at years, months, days, hours, minutes and seconds."""
_WIDTH_INCHES, _CHART_INCHES, _EDGE_INCHES = 10.0, 1.8, 0.9


def write_image(
    series: Sequence[tuple[SeriesKey, ValueSeries]],
    begin_ns: int,
    end_ns: int,
    file: IO[bytes],
    format_: str,
) -> None:
    """Write one picture with a chart for each series; `format_` is `png`, `svg` or `pdf`.

    The time axis goes from `begin_ns` to `end_ns`, both in ns since 1970.
    matplotlib must not take texts of the capture for formulas, so parse_math is off.
    """
    import matplotlib.dates
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    several = len({key.link for key, _ in series}) > 1
    figure = Figure(
        figsize=(_WIDTH_INCHES, _EDGE_INCHES + _CHART_INCHES * len(series)), layout="constrained"
    )
    FigureCanvasAgg(figure)
    charts = figure.subplots(len(series), 1, sharex=True, squeeze=False)[:, 0]
    begin, end = _moment(begin_ns), _moment(max(end_ns, begin_ns + 1_000_000))
    for chart, (key, one) in zip(charts, series, strict=True):
        samples = sorted(one.samples, key=lambda sample: sample.ts_ns)
        times = [*(_moment(sample.ts_ns) for sample in samples), end]
        values = [sample.value for sample in samples]
        if values:
            chart.step(times, [*values, values[-1]], where="post", linewidth=1.2)
        if one.bit:
            chart.set_yticks([0, 1])
            chart.set_ylim(-0.1, 1.1)
        else:
            chart.ticklabel_format(axis="y", useOffset=False)
            if len({*values}) == 1:
                chart.set_yticks(values[:1])
            elif all(value == int(value) for value in values):
                chart.yaxis.set_major_locator(MaxNLocator("auto", integer=True))
        title = series_title(key, one, with_link=several)
        chart.set_title(title, loc="left", fontsize=10, parse_math=False)
        if one.unit:
            chart.set_ylabel(one.unit, parse_math=False)
        chart.grid(alpha=0.3)
    charts[-1].set_xlim(begin, end)
    dates: Any = matplotlib.dates  # matplotlib.dates has no types.
    locator = dates.AutoDateLocator(tz=UTC)
    charts[-1].xaxis.set_major_locator(locator)
    charts[-1].xaxis.set_major_formatter(
        dates.ConciseDateFormatter(
            locator, tz=UTC, formats=_TIMES, zero_formats=_BEGINS, offset_formats=_DAYS
        )
    )
    charts[-1].set_xlabel("UTC")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # A character that the font lacks becomes a box.
        figure.savefig(file, format=format_, dpi=120)


def _moment(ns: int) -> datetime:
    return datetime.fromtimestamp(ns / 1e9, UTC)
