"""The columns of the live tables of transactions, of events and findings, and of slaves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import clock_time, host_of, in_ms, percent
from mbtool.devices import finding_text
from mbtool.devices.checking.rules import Severity
from mbtool.modbus import Outcome
from mbtool.views.cells import ARROW, event_text, result_text, transaction_text
from mbtool.views.watch_columns import (
    LEAST_REST,
    DrawContext,
    Spans,
    WatchColumn,
    cut_spans,
    plain_column,
)
from mbtool.views.watch_names import with_short_names
from mbtool.views.watch_words import age, count, in_table_words
from mbtool.watching.value_formats import ValueFormat

if TYPE_CHECKING:
    from mbtool.watching.board import RecordRow, WatchedSlaveRow
    from mbtool.watching.watched_rows import TroubleRow

_STYLES = {
    Outcome.EXCEPTION: "red",
    Outcome.LATE: "bold red",
    Outcome.NO_ANSWER: "bold red",
    Outcome.MALFORMED: "bold red",
    Outcome.NOT_CAPTURED: "dim",
    Outcome.UNSOLICITED: "yellow",
}


_LEAST_RECORD = 34
"""If a request with its response would get fewer characters than this, the latency is left out, so
that `03 read holding 0..1 -> no answer` is seen whole."""
_LEAST_MEANING, _LEAST_STATE = 60, 48
"""If the meaning of a finding, or the state of a slave, would get fewer characters than this, and
has more, other columns are left out."""
_OF_SOME_UNIT = (EventKind.BAD_CHECK, EventKind.SKIPPED, EventKind.LINE_ERROR, EventKind.GAP)


def record_text(row: RecordRow, context: DrawContext) -> Spans:
    """Return request and result of a transaction with the codes of its findings.

    For an event, return its text.
    """
    record = row.kept.record
    if isinstance(record, WireEvent):
        return [(event_text(record), "yellow")]
    in_hex = context.format_of(row.key) is ValueFormat.HEX
    record = in_table_words(record)
    text = transaction_text(record, in_hex=in_hex)
    if row.is_damaged:
        text = f"{text.removesuffix(result_text(record))}wrong CRC"
    if row.is_retry:
        request, arrow, result = text.partition(ARROW)
        text = f"{request} (retry){arrow}{result}"
    spans = [(text, _STYLES.get(record.outcome, ""))]
    return [*spans, (f" ! {' '.join(record.findings)}", "magenta")] if record.findings else spans


def fitted_record(row: RecordRow, context: DrawContext, width: int) -> Spans:
    """Return the text of a transaction for `width` characters, with shorter names of points.

    The codes of findings are kept if that leaves enough room for the request and its result.
    """
    spans, record = record_text(row, context), row.kept.record
    if isinstance(record, WireEvent):
        return spans
    spans = with_short_names(spans, record, width)
    room = width - len(spans[-1][0])
    is_too_long = sum(len(text) for text, _ in spans) > width
    if record.findings and is_too_long and room >= _LEAST_RECORD:
        return [*cut_spans(spans[:-1], room), spans[-1]]
    return spans


def _text_of(name: str, row: RecordRow) -> str:
    value = getattr(row.kept.record, name, None)
    return "" if value is None else str(value)


def _field(name: str, title: str, width: int) -> WatchColumn:
    """Return a column that is shown only if the user chooses it.

    Its cells have the field `name` of the transaction or event.
    """
    return WatchColumn(
        name=name, title=title, width=width, is_usual=False,
        cell=lambda row, _: _text_of(name, row), sort=lambda row: _text_of(name, row),
    )  # fmt: skip


def _unit(row: RecordRow | TroubleRow) -> str:
    """Return the unit; `?` for bytes of some unit that cannot be told, `-` for an event of none."""
    if row.unit is not None:
        return str(row.unit)
    record = row.kept.record
    return "?" if isinstance(record, WireEvent) and record.kind in _OF_SOME_UNIT else "-"


def _latency(row: RecordRow) -> int | None:
    record = row.kept.record
    return None if isinstance(record, WireEvent) else record.latency_ns


def _mark_cell(row: RecordRow, context: DrawContext) -> Spans:
    return [("*" if row.kept.order in context.marked else " ", "bold green")]


def _latency_cell(row: RecordRow, _: DrawContext) -> str:
    latency_ns = _latency(row)
    return "" if latency_ns is None else in_ms(latency_ns)


def _confidence_cell(row: RecordRow, _: DrawContext) -> str:
    record = row.kept.record
    return "" if isinstance(record, WireEvent) else percent(record.confidence)


RECORD_COLUMNS = (
    WatchColumn(
        name="mark", title=" ", width=1, cell=_mark_cell, sort=lambda row: row.kept.order,
    ),
    WatchColumn(
        name="number", title="#", width=6, least=3, is_right=True, rank=1, is_spared=True,
        cell=lambda row, _: "" if row.kept.number is None else str(row.kept.number),
        sort=lambda row: row.kept.order,
    ),
    WatchColumn(
        name="time", title="time (UTC)", width=12,
        cell=lambda row, _: clock_time(row.kept.at_ns), sort=lambda row: row.kept.at_ns,
    ),
    WatchColumn(
        name="ms", title="ms", width=5, is_right=True, cell=_latency_cell, rank=2,
        sort=lambda row: -1 if _latency(row) is None else _latency(row),
    ),
    _field("link", "link", 15),
    WatchColumn(
        name="master", title="master", width=15, is_usual=False,
        cell=lambda row, _: host_of(_text_of("source", row) or None),
        sort=lambda row: _text_of("source", row),
    ),
    _field("source", "from", 21),
    _field("destination", "to", 21),
    WatchColumn(
        name="unit", title="un", width=3, is_right=True,
        cell=lambda row, _: _unit(row), sort=lambda row: -1 if row.unit is None else row.unit,
    ),
    _field("device", "device", 16),
    _field("transaction_id", "id", 5),
    _field("outcome", "outcome", 12),
    _field("direction_by", "by", 8),
    WatchColumn(
        name="sure", title="sure", width=5, is_usual=False, cell=_confidence_cell,
        sort=lambda row: getattr(row.kept.record, "confidence", 0),
    ),
    WatchColumn(
        name="text", title="request -> response", width=0, least_share=_LEAST_RECORD,
        cell=record_text, fit=fitted_record,
        sort=lambda row: "".join(text for text, _ in record_text(row, DrawContext())),
    ),
)  # fmt: skip


def _trouble_code(row: TroubleRow, _: DrawContext) -> Spans:
    return [(row.code, "magenta" if row.is_finding else "yellow")]


def trouble_text(row: TroubleRow, _: DrawContext) -> str:
    """Return what a finding's code means; for an event, the text of its last occurrence."""
    record = row.kept.record
    if isinstance(record, WireEvent):
        return event_text(record).removeprefix(f"{row.code}: ")
    return finding_text(row.code)


TROUBLE_COLUMNS = (
    WatchColumn(
        name="code", title="what", width=14, least=6, cell=_trouble_code, sort=lambda row: row.code,
    ),
    plain_column("count", "count", 5, "times", text=count, is_right=True),
    WatchColumn(
        name="unit", title="un", width=3, is_right=True,
        cell=lambda row, _: _unit(row), sort=lambda row: -1 if row.unit is None else row.unit,
    ),
    WatchColumn(
        name="first", title="first UTC", width=9, rank=1,
        cell=lambda row, _: clock_time(row.first_ns)[:8], sort=lambda row: row.first_ns,
    ),
    WatchColumn(
        name="last", title="last UTC", width=8,
        cell=lambda row, _: clock_time(row.last_ns)[:8], sort=lambda row: row.last_ns,
    ),
    plain_column("link", "link", 15, is_usual=False),
    WatchColumn(
        name="text", title="meaning, or last event", width=0, least=LEAST_REST,
        least_share=_LEAST_MEANING, cell=trouble_text,
        sort=lambda row: trouble_text(row, DrawContext()),
    ),
)  # fmt: skip


def slave_state(row: WatchedSlaveRow, _: DrawContext) -> Spans:
    """Return in words how a slave answers, or what is wrong with it.

    Under a filter that tells of all records, as the line of troubles does.
    """
    row = row.whole or row
    if row.silent_since_ns is not None and row.damaged * 2 <= row.missing:
        silent = f"no answer since {clock_time(row.silent_since_ns)[:8]}"
        return [("never answers" if row.answered_ns is None else silent, "bold red")]
    if not row.troubles:
        return [("answers", "green") if row.answered else ("", "")]
    is_grave = any(one.severity is Severity.ERROR for one in row.troubles)
    text = ", ".join(one.short for one in row.troubles)
    return [(text, "bold red" if is_grave else "yellow")]


def _failures(name: str, title: str) -> WatchColumn:
    """Return a column for the field `name`, a count of failures; it is red unless it is 0."""

    def cell(row: WatchedSlaveRow, _: DrawContext) -> Spans:
        number = getattr(row, name)
        return [(f"{count(number):>5}", "red" if number else "")]

    return WatchColumn(
        name=name, title=title, width=5, is_right=True, cell=cell,
        sort=lambda row: getattr(row, name),
    )  # fmt: skip


def _known_ms(ns: int) -> str:
    return in_ms(ns) if ns else ""


SLAVE_COLUMNS = (
    plain_column("link", "link", 15, is_usual=False),
    plain_column("unit", "un", 3, is_right=True),
    WatchColumn(
        name="device", title="device", width=16, least=6, rank=4,
        cell=lambda row, _: row.device or "", sort=lambda row: row.device or "",
    ),
    plain_column("asked", "asked", 5, text=count, is_right=True),
    _failures("exceptions", "exc"),
    _failures("missing", "miss"),
    plain_column("retries", "retry", 5, text=count, is_right=True, rank=3),
    plain_column("p50", "p50ms", 5, "median_ns", text=_known_ms, is_right=True),
    plain_column("max", "maxms", 5, "slowest_ns", text=_known_ms, is_right=True, rank=2),
    WatchColumn(
        name="age", title="age", width=4, is_right=True, rank=1,
        cell=lambda row, context: age(context.now_ns - row.last_ns),
        sort=lambda row: -row.last_ns,
    ),
    plain_column("findings", "find", 4, text=count, is_right=True, is_usual=False),
    WatchColumn(
        name="state", title="state", width=0, least=LEAST_REST, least_share=_LEAST_STATE,
        cell=slave_state,
        sort=lambda row: slave_state(row, DrawContext())[0][0],
    ),
)  # fmt: skip
