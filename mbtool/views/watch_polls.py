"""The columns of the live tables of polls (repeated requests) and of points (named values)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.core.moments import in_ms
from mbtool.devices import NamedTransaction, describe_points
from mbtool.modbus import FUNCTIONS, Outcome
from mbtool.views.cells import GROUP, MANY_BITS, result_text, transaction_text
from mbtool.views.watch_columns import LEAST_REST, DrawContext, Spans, WatchColumn, plain_column
from mbtool.views.watch_names import cut_name, with_short_names
from mbtool.views.watch_words import (
    OVERDUE,
    age,
    change_style,
    count,
    in_table_words,
    period,
    sparkline,
)
from mbtool.watching.value_formats import ValueFormat, float_text, register_text, register_texts

if TYPE_CHECKING:
    from mbtool.watching.board import PollRow, WatchedPointRow

_MAX_VALUES = 125
_LEAST_NAME, _LEAST_POINT = 44, 32
"""If the name or the value of a point would get fewer characters than this, and has more, other
columns are left out."""
_LEAST_VALUES = 30
"""If the last values of a poll would get fewer characters than this, its latencies are left out."""


def _poll_request(row: PollRow, _: DrawContext) -> Spans:
    poll = row.poll
    what = row.reference or row.function_name
    if poll.sub_function is not None:
        what = f"{what} {poll.sub_function:02X}"
    function = FUNCTIONS.get(poll.function)
    sign = " w" if function is not None and function.writes else ""
    return [(f"{poll.function:02X} ", "dim"), (f"{what}{sign}", "")]


def poll_values(row: PollRow, context: DrawContext) -> Spans:
    """Return the cell with the last result of a poll (repeated request): an error, or the values.

    An error is red. Values that changed in the last seconds are highlighted.
    """
    one = row.kept.record
    if isinstance(one, WireEvent):
        return []
    one = in_table_words(one)
    if one.outcome not in (Outcome.OK, Outcome.BROADCAST):
        # Leave out the word `exception`, because the code and its name are enough.
        result = result_text(one).removeprefix("exception ")
        text = "wrong CRC" if row.is_damaged else result
        return [(text, "bold red"), *_separated(_values(row, one, context))]
    return _values(row, one, context) or [(result_text(one), "dim")]


def fitted_values(row: PollRow, context: DrawContext, width: int) -> Spans:
    """Return the cell with the last result of a poll for `width` characters, with shorter names."""
    spans, one = poll_values(row, context), row.kept.record
    return spans if isinstance(one, WireEvent) else with_short_names(spans, one, width)


def _separated(spans: Spans) -> Spans:
    return [(" last ", "dim"), *spans] if spans else []


def _values(row: PollRow, one: NamedTransaction, context: DrawContext) -> Spans:
    form = context.format_of(row.key)
    if one.points and form is ValueFormat.NAMED:
        return _point_spans(row, one, context)
    if not row.values:
        return []
    function = FUNCTIONS.get(row.poll.function)
    if function is not None and function.table is not None and function.table.is_bits:
        return _bits(row, context)
    values, times = row.values[:_MAX_VALUES], row.changed_ns[:_MAX_VALUES]
    texts = register_texts(values, form)
    if form.is_float:
        times = [max(times[at : at + 2]) for at in range(0, len(times), 2)]
    spans: Spans = []
    for text, changed_ns in zip(texts, times, strict=False):
        spans.append((text, change_style(changed_ns, context.now_ns)))
        spans.append((" ", ""))
    return spans


def _point_spans(row: PollRow, one: NamedTransaction, context: DrawContext) -> Spans:
    """Return the texts of the points (named values) in the last transaction `one` of a poll.

    Points that changed in the last seconds come first, the newest at the front, highlighted.
    """
    changed = row.points_changed_ns
    lit: list[tuple[int, str, str]] = []
    rest = []
    for point in one.points:
        changed_ns = changed.get(point.name, 0)
        style = change_style(changed_ns, context.now_ns)
        if style:
            lit.append((-changed_ns, f"{point.name} {point.text}", style))
        else:
            rest.append(point)
    spans: Spans = []
    for _, text, style in sorted(lit):
        spans += [(text, style), (", ", "")]
    return [*spans, ("; ".join(describe_points(rest)), "")] if rest else spans[:-1]


def _bits(row: PollRow, context: DrawContext) -> Spans:
    spans: Spans = []
    gap = 1 if len(row.values) <= MANY_BITS else GROUP
    for at, (bit, changed_ns) in enumerate(zip(row.values, row.changed_ns, strict=False)):
        if at and at % gap == 0:
            spans.append((" ", ""))
        spans.append((str(bit), change_style(changed_ns, context.now_ns)))
    return spans


def _poll_age(row: PollRow, context: DrawContext) -> Spans:
    since_ns = context.now_ns - row.last_ns
    is_late = row.has_regular_period and since_ns > OVERDUE * row.period_ns
    return [(f"{age(since_ns):>4}", "bold yellow" if is_late and not context.is_over else "")]


def _poll_period(row: PollRow, _: DrawContext) -> str:
    if row.period_ns and not row.has_regular_period:
        return "varies"
    return period(row.period_ns)


def _errors(row: PollRow, _: DrawContext) -> Spans:
    return [(f"{count(row.errors):>4}", "bold red" if row.errors else "")]


def _last_ms(row: PollRow, _: DrawContext) -> str:
    last = row.latencies[-1] if row.latencies else None
    return "" if last is None else in_ms(last)


def _trend(row: PollRow, _: DrawContext) -> Spans:
    return [(sparkline(row.latencies, 8), "cyan")]


POLL_COLUMNS = (
    plain_column("link", "link", 15, "poll.link", is_usual=False),
    plain_column("master", "master", 15, "poll.master", is_usual=False),
    plain_column("unit", "un", 3, "poll.unit", is_right=True),
    WatchColumn(
        name="request", title="request", width=23, least=10, cell=_poll_request,
        sort=lambda row: (row.poll.function, row.poll.address or 0),
    ),
    WatchColumn(
        name="values", title="last values", width=0, least=LEAST_REST, least_share=_LEAST_VALUES,
        cell=poll_values, fit=fitted_values,
        sort=lambda row: transaction_text(row.kept.record),
    ),
    WatchColumn(
        name="age", title="age", width=4, is_right=True, cell=_poll_age, rank=2, is_spared=True,
        sort=lambda row: -row.last_ns,
    ),
    WatchColumn(
        name="every", title="every", width=6, is_right=True, rank=4, is_spared=True,
        cell=_poll_period, sort=lambda row: (not row.has_regular_period, row.period_ns),
    ),
    plain_column(
        "count", "count", 5, "asked", text=count, is_right=True, rank=3, is_spared=True,
    ),
    WatchColumn(
        name="errors", title="err", width=4, is_right=True, cell=_errors, rank=1, is_spared=True,
        sort=lambda row: row.errors,
    ),
    WatchColumn(
        name="ms", title="ms", width=5, is_right=True, cell=_last_ms, rank=5,
        sort=lambda row: (row.latencies[-1] or 0) if row.latencies else 0,
    ),
    plain_column("max", "max", 5, "slowest_ns", text=in_ms, is_right=True, is_usual=False),
    plain_column("retries", "retr", 4, text=count, is_right=True, is_usual=False),
    WatchColumn(
        name="trend", title="latency", width=8, cell=_trend, rank=6,
        sort=lambda row: row.slowest_ns,
    ),
)  # fmt: skip


def _point_text(row: WatchedPointRow, context: DrawContext) -> str:
    form = context.format_of(row.key)
    if form.is_float:
        return float_text(*row.pair, form) if row.pair is not None else "-"
    if form is ValueFormat.NAMED or not isinstance(row.value, int):
        return row.text
    return register_text(row.value, form)


def _point_value(row: WatchedPointRow, context: DrawContext) -> Spans:
    style = change_style(row.changed_ns, context.now_ns)
    written = [("w ", "magenta")] if row.is_written else []
    return [*written, (_point_text(row, context), style)]


POINT_COLUMNS = (
    plain_column("link", "link", 15, is_usual=False),
    plain_column("unit", "un", 3, is_right=True),
    WatchColumn(
        name="reference", title="reference", width=14, least=9,
        cell=lambda row, _: row.reference,
        sort=lambda row: (row.device or "", row.reference.rstrip("0123456789"),
                          len(row.reference), row.reference),
    ),
    plain_column(
        "name", "name", 0, least=4, least_share=_LEAST_NAME,
        fit=lambda row, _, width: [(cut_name(row.name, width), "")],
    ),
    WatchColumn(
        name="value", title="value", width=0, least=8, least_share=_LEAST_POINT,
        cell=_point_value,
        sort=lambda row: (row.value is None, row.value or 0, row.text),
    ),
    plain_column("before", "before", 10, rank=2),
    WatchColumn(
        name="changed", title="chgd", width=4, is_right=True,
        cell=lambda row, context: age(context.now_ns - row.changed_ns) if row.changed_ns else "",
        sort=lambda row: -row.changed_ns,
    ),
    WatchColumn(
        name="age", title="age", width=4, is_right=True,
        cell=lambda row, context: age(context.now_ns - row.last_ns),
        sort=lambda row: -row.last_ns,
    ),
    plain_column("changes", "chgs", 5, text=count, is_right=True, rank=1),
    WatchColumn(
        name="device", title="device", width=16, is_usual=False,
        cell=lambda row, _: row.device or "", sort=lambda row: row.device or "",
    ),
    WatchColumn(
        name="trend", title="values", width=10, rank=3,
        cell=lambda row, _: [(sparkline(row.history, 10), "cyan")], sort=lambda row: row.changes,
    ),
)  # fmt: skip
