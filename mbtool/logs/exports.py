"""Formats transactions and events as lines of jsonl or CSV."""

# A jsonl line is one transaction with the fields of docs/log-format.md, or one event. Only events
# have `kind`, and only transactions have `outcome`:
#
#     jq 'select(.outcome == "exception")'      jq 'select(.kind == "gap")'
#
# Bytes are lower-case hex; times are UTC nanoseconds as integers, and `time` repeats the first of
# them as ISO 8601. A field that does not apply is absent in jsonl and empty in CSV. In CSV the
# values of a list are separated by spaces, and a line end inside a text becomes a space.
#
# A log may hold any text, and someone may show the lines in a terminal or open the CSV in a
# spreadsheet. So characters that cannot be printed are escaped in jsonl and become ? in CSV, and a
# CSV text that a spreadsheet would take for a formula gets an apostrophe in front.

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from datetime import datetime, timedelta
from functools import cache, lru_cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TextIO

import msgspec

from mbtool.core import WireEvent
from mbtool.devices.transaction_fields import TIME, column_names
from mbtool.logs.messages import EventMessage

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, PointValue

_encode = msgspec.json.Encoder().encode
_replace = msgspec.structs.replace
"""msgspec's replace. It checks no types, so it can put hex strings into fields of type bytes."""

_EPOCH = datetime(1970, 1, 1)
_FORMULA = ("=", "+", "-", "@")
"""Signs at the beginning of a text that make a spreadsheet take the text for a formula."""
_ONE_LINE = str.maketrans("\r\n", "  ")


@cache
def csv_columns() -> tuple[str, ...]:
    """Return the CSV columns in order. A column never changes its name or meaning; new ones come
    last.
    """
    return column_names("csv")


def transaction_to_jsonl(transaction: NamedTransaction) -> bytes:
    """Return a transaction as one line of jsonl, with its line end."""
    request, response = transaction.request_raw, transaction.response_raw
    return _line(
        _replace(
            transaction,
            request_raw=request and request.hex(),
            response_raw=response and response.hex(),
        ),
        transaction.start_ns,
    )


def event_to_jsonl(event: WireEvent) -> bytes:
    """Return an event as one line of jsonl, with its line end."""
    message = EventMessage.of(event)
    return _line(_replace(message, raw=message.raw and message.raw.hex()), event.ts_ns)


@cache
def _fields() -> tuple[Callable[[object], tuple[Any, ...]], int]:
    """Return what gets the fields of all columns but the time, and the place of the time."""
    columns = csv_columns()
    return attrgetter(*(one for one in columns if one != TIME)), columns.index(TIME)


class CsvWriter:
    """Writes transactions as CSV rows of one line each, after a row of column names."""

    def __init__(self, stream: TextIO) -> None:
        """Write the column names. `stream` must be opened with newline=""."""
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow(csv_columns())

    def write(self, transaction: NamedTransaction) -> None:
        self._writer.writerow(csv_row(transaction))


def csv_line(transaction: NamedTransaction) -> str:
    """Return a transaction as one line of CSV, as `CsvWriter` writes it."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(csv_row(transaction))
    return line.getvalue()


def csv_row(transaction: NamedTransaction) -> list[str | int | float | None]:
    """Return the cells of the columns; a cell is None or empty if its field does not apply."""
    texts = _replace(
        transaction,
        request_raw=(transaction.request_raw or b"").hex(),
        response_raw=(transaction.response_raw or b"").hex(),
        request_values=" ".join(map(str, transaction.request_values or ())),
        response_values=" ".join(map(str, transaction.response_values or ())),
        verdicts=" ".join(transaction.verdicts),
        findings=" ".join(transaction.findings),
        points="; ".join(map(_point_text, transaction.points)),
    )
    fields, time_at = _fields()
    cells = [*fields(texts)]
    cells.insert(time_at, iso_time(transaction.start_ns))
    for place, cell in enumerate(cells):
        if isinstance(cell, str) and (not cell.isprintable() or cell.startswith(_FORMULA)):
            cells[place] = _harmless(cell)
    return cells


def _point_text(point: PointValue) -> str:
    return f"{point.name}{':=' if point.written else '='}{point.text}"


def iso_time(ts_ns: int) -> str | None:
    """A time in UTC ns as ISO 8601: `2026-11-22T09:14:03.201000000Z`; None beyond the year 9999.

    The text always has nine decimals, so that sorting the texts sorts the times.
    """
    seconds, ns = divmod(ts_ns, 1_000_000_000)
    text = _second(seconds)
    return None if text is None else f"{text}.{ns:09d}Z"


@lru_cache(maxsize=64)
def _second(seconds: int) -> str | None:
    """Format seconds since 1970 as ISO 8601. Cached, since many rows have the same second."""
    try:
        return (_EPOCH + timedelta(seconds=seconds)).isoformat()
    except OverflowError:
        return None


def _line(message: msgspec.Struct, ts_ns: int) -> bytes:
    line = _encode(message)
    if not line.isascii():
        line = _escaped(line)
    time = iso_time(ts_ns)
    return line + b"\n" if time is None else b'%b,"time":"%b"}\n' % (line[:-1], time.encode())


def _escaped(line: bytes) -> bytes:
    """Return a JSON text with JSON escapes in place of the characters that cannot be printed."""
    text = line.decode()
    if text.isprintable():
        return line
    return "".join(one if one.isprintable() else json.dumps(one)[1:-1] for one in text).encode()


def _harmless(text: str) -> str:
    """Make a text safe to show: one line, no control characters, no formula of a spreadsheet."""
    text = text.translate(_ONE_LINE)
    text = "".join(one if one.isprintable() else "?" for one in text)
    return f"'{text}" if text.startswith(_FORMULA) else text
