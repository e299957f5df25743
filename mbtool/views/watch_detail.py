"""Shows one row of a live view in full: the bytes by field, and how the direction was decided."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Direction, WireEvent
from mbtool.core.moments import clock_time, day, in_ms, percent
from mbtool.devices import NamedTransaction, Profile, finding_text
from mbtool.modbus import Transport
from mbtool.modbus.adu import DirectionBy, Verdict
from mbtool.views.cells import result_text, transaction_text
from mbtool.views.tables import printable
from mbtool.watching.adu_parts import adu_parts

if TYPE_CHECKING:
    from mbtool.views.watch_columns import Spans
    from mbtool.watching.board import WatchedSlaveRow
    from mbtool.watching.watched_rows import KeptRecord, TroubleRow

WHY = {
    DirectionBy.PORT: "the port tells who sent it",
    DirectionBy.PENDING: "it fits the request that waited for an answer",
    DirectionBy.IDLE: "no request waited, and it has the form of one",
    DirectionBy.FORM: "only one direction can have this form",
    DirectionBy.TIMING: "the silence before it decided, as its form fits both",
}
"""The evidence by which the decoder took a frame for a request or a response, in words."""
VERDICTS = {
    Verdict.GLUED: "no silence separates it from the frame beside it",
    Verdict.SPLIT: "a silence of t3.5 or longer inside",
    Verdict.ONLY_REQUEST_SPLIT: "only inside the request",
    Verdict.RESYNCHRONISED: "bytes were skipped before it",
    Verdict.NOISE_BEFORE: "unreadable bytes right before it",
    Verdict.T1_5_BROKEN: "a silence longer than t1.5 inside",
    Verdict.AMBIGUOUS: "another reading is nearly as likely",
    Verdict.CUT: "the capture has only its first bytes",
    Verdict.OVER_LENGTH: "longer than the standard allows",
}
"""The meaning of verdicts (remarks of the decoder on a frame) whose names are not clear."""
_COLOURS = {
    "transaction id": "cyan",
    "protocol id": "dim",
    "length": "dim",
    "start": "dim",
    "end": "dim",
    "unit": "magenta",
    "function": "bold yellow",
    "address": "green",
    "write address": "green",
    "quantity": "blue",
    "write quantity": "blue",
    "byte count": "blue",
    "exception code": "bold red",
    "data": "bold",
    "value": "bold",
    "CRC": "dim cyan",
    "LRC": "dim cyan",
}


def record_detail(
    kept: KeptRecord, profile: Profile | None, width: int, damaged: WireEvent | None = None
) -> list[Spans]:
    """Return the lines that show one transaction or event in full, broken at `width` characters.

    `profile` is that of the slave, None if it has none. `damaged` is the event of a response with
    a wrong CRC or LRC that belongs to the transaction, if there is one.
    """
    record = kept.record
    if isinstance(record, WireEvent):
        return _event_detail(record, width)
    title = f"#{kept.number}  {day(record.start_ns)} {clock_time(record.start_ns)} UTC"
    text, place = transaction_text(replace(record, retries=0)), _place(record)
    if damaged is not None:
        wrong = "wrong LRC" if record.transport is Transport.ASCII else "wrong CRC"
        text = f"{text.removesuffix(result_text(record))}{wrong}"
        place = f"{place} ({wrong})"
    lines: list[Spans] = [[(title, "bold"), (f"  {place}", "")]]
    lines += _wrapped(text, width)
    if record.retries:
        before = "equal request" if record.retries == 1 else f"{record.retries:,} equal requests"
        lines += _wrapped(f"the {before} before it got no answer", width)
    if record.latency_ns is not None:
        lines.append([(f"answered after {in_ms(record.latency_ns)} ms", "")])
    lines += _adu_lines("request ", record.transport, record.request_raw, Direction.REQUEST, width)
    if damaged is None:
        raw = record.response_raw
        lines += _adu_lines("response", record.transport, raw, Direction.RESPONSE, width)
    else:
        lines += _damaged_lines(damaged, width)
    why = WHY.get(record.direction_by, record.direction_by.value)
    lines.append([
        ("direction by ", ""), (record.direction_by.value, "bold"), (f": {why}; ", ""),
        (f"sure to {percent(record.confidence)}", "bold"),
    ])  # fmt: skip
    for verdict in record.verdicts:
        meaning = VERDICTS.get(verdict)
        lines += _wrapped(
            f"{verdict.value}: {meaning}" if meaning else verdict.value, width, "yellow"
        )
    for code in record.findings:
        lines += _wrapped(f"{code} {finding_text(code, profile)}", width, "magenta")
    for point in record.points:
        text = f"  {point.reference} {point.name}: {point.text}"
        lines += _wrapped(
            text if point.name != point.reference else f"  {point.name}: {point.text}", width
        )
    return lines


def _damaged_lines(event: WireEvent, width: int) -> list[Spans]:
    """Return the lines on the response of a transaction of which only an event tells."""
    title = "response "
    raw: Spans = [(title, "bold"), (event.raw.hex(" "), "yellow")]
    reason: Spans = [(" " * len(title), ""), (printable(event.message), "yellow")]
    return _flowed(raw, width, len(title)) + _flowed(reason, width, len(title))


def trouble_detail(row: TroubleRow, profile: Profile | None, width: int) -> list[Spans]:
    """Return the lines that show how often findings or events of a kind came, then the last one.

    `profile` is that of the slave, None if it has none.
    """
    lines = record_detail(row.kept, profile, width)
    if row.times == 1:
        return lines
    first, last = clock_time(row.first_ns), clock_time(row.last_ns)
    unit = "" if row.unit is None else f"unit {row.unit}, "
    times = (
        f"{row.times:,} times, first {day(row.first_ns)} {first}, last {last} UTC; the last one:"
    )
    return [*_wrapped(f"{row.code} of {unit}{row.link}: {times}", width, "bold"), *lines]


def slave_detail(row: WatchedSlaveRow, width: int) -> list[Spans]:
    """Return the lines that show one slave in full, broken at `width` characters."""
    device = f" {row.device}" if row.device else ""
    lines: list[Spans] = [[(f"{row.link} unit {row.unit}{device}", "bold")]]
    faulty = [
        f"{word} {number}"
        for word, number in (("refused", row.exceptions), ("malformed", row.malformed))
        if number
    ]
    of_these = f" (of these {', '.join(faulty)})" if faulty else ""
    counts = f"asked {row.asked}, answered {row.answered}{of_these}"
    damaged = f" (of these {row.damaged} with a wrong CRC or LRC)" if row.damaged else ""
    lines += _wrapped(f"{counts}, missing {row.missing}{damaged}, retries {row.retries}", width)
    whole = row.whole or row
    if row.whole is not None:
        of_all = f"asked {whole.asked}, answered {whole.answered}, missing {whole.missing}"
        lines += _wrapped(f"without the filter: {of_all}", width)
    if row.findings:
        found = f"findings in single transactions {row.findings}; mbtool check FILE finds more"
        lines += _wrapped(found, width)
    if row.median_ns:
        text = f"latency: median {in_ms(row.median_ns)} ms, most {in_ms(row.slowest_ns)} ms"
        lines.append([(text, "")])
    if whole.answered_ns is not None:
        lines.append([(f"last answer {clock_time(whole.answered_ns)} UTC", "")])
    if whole.silent_since_ns is not None:
        lines.append([(f"no answer since {clock_time(whole.silent_since_ns)} UTC", "bold red")])
    return lines


def _place(one: NamedTransaction) -> str:
    ends = f"{one.source} -> {one.destination}, " if one.source and one.destination else ""
    device = f" {one.device}" if one.device else ""
    return printable(f"{one.link}, {ends}unit {one.unit}{device}, {one.outcome.value}")


def _event_detail(event: WireEvent, width: int) -> list[Spans]:
    title = f"{event.kind.value}  {day(event.ts_ns)} {clock_time(event.ts_ns)} UTC"
    lines: list[Spans] = [[(title, "bold"), (f"  {printable(event.link)}", "")]]
    lines += _wrapped(event.message, width)
    if event.source or event.destination:
        lines += _wrapped(f"{event.source} -> {event.destination}", width)
    return lines + _wrapped(event.raw.hex(" "), width)


def _adu_lines(
    title: str, transport: Transport, raw: bytes | None, direction: Direction, width: int
) -> list[Spans]:
    """Return lines with `title` and an ADU's bytes in hexadecimal, then the names of its fields.

    Bytes and name of a field have the same colour. `raw` is None if there is no such message.
    """
    if raw is None:
        return [[(f"{title} ", "bold"), ("none", "dim")]]
    is_ascii = transport is Transport.ASCII
    spans: Spans = []
    names: Spans = []
    for name, begin, end in adu_parts(transport, raw, direction):
        style = _COLOURS.get(name, "")
        part = raw[begin:end]
        text = part.decode("ascii", "replace") if is_ascii else part.hex(" ")
        if name == "end":
            text = text.replace("\r", "CR").replace("\n", "LF")
        spans += [(f"{printable(text)} ", style)]
        names += [(f"{_field_text(name, part, is_ascii=is_ascii)} ", style)]
    indent = len(title) + 1
    lines = _flowed([(f"{title} ", "bold"), *spans], width, indent)
    return lines + _flowed([(" " * indent, ""), *names], width, indent, is_whole=True)


def _field_text(name: str, part: bytes, *, is_ascii: bool) -> str:
    """Return a field's name and its number, such as `address 107`; data and CRC have no number.

    `part` has the field's bytes as captured; with `is_ascii`, two hexadecimal digits a byte.
    """
    if name in ("data", "start", "end", "CRC", "LRC", "protocol id"):
        return name
    try:
        number = int(part, 16) if is_ascii else int.from_bytes(part)
    except ValueError:
        return name
    return f"{name} {number:02X}H" if name == "function" else f"{name} {number}"


def _flowed(spans: Spans, width: int, indent: int, *, is_whole: bool = False) -> list[Spans]:
    """Break spans (texts with styles) into lines of at most `width` characters.

    Lines after the first are indented by `indent` spaces. A line may break between two words; with
    `is_whole`, only between two spans.
    """
    lines: list[Spans] = [[]]
    used = 0
    for text, style in spans:
        for word in [text] if is_whole else _words_with_spaces(text):
            if used + len(word.rstrip()) > width and used > indent:
                lines.append([(" " * indent, "")])
                used = indent
            lines[-1].append((word, style))
            used += len(word)
    return lines


def _words_with_spaces(text: str) -> list[str]:
    """Return the words of a text, each with the spaces behind it."""
    if not text.strip():
        return [text]
    words = text.split(" ")
    return [f"{word} " for word in words[:-1]] + ([words[-1]] if words[-1] else [])


def _wrapped(text: str, width: int, style: str = "") -> list[Spans]:
    return _flowed([(printable(text), style)], width, 2) if text else []
