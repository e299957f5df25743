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
import json
from datetime import datetime, timedelta
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TextIO

import msgspec

from mbtool.logs.messages import EventMessage

if TYPE_CHECKING:
    from mbtool.core import WireEvent
    from mbtool.devices import NamedTransaction

_encode = msgspec.json.Encoder().encode

_EPOCH = datetime(1970, 1, 1)
_FORMULA = ("=", "+", "-", "@")
"""A spreadsheet takes a text that begins with one of these for a formula."""
_ONE_LINE = str.maketrans("\r\n", "  ")

CSV_COLUMNS = (
    "request_ns",
    "response_ns",
    "latency_ns",
    "link",
    "transport",
    "source",
    "destination",
    "unit",
    "transaction_id",
    "function",
    "function_name",
    "sub_function",
    "address",
    "quantity",
    "write_address",
    "device",
    "reference",
    "outcome",
    "exception",
    "exception_name",
    "request_values",
    "response_values",
    "points",
    "findings",
    "retries",
    "verdicts",
    "direction_by",
    "confidence",
    "request_raw",
    "response_raw",
    "write_quantity",
    "time",
    "file",
    "response_file",
    "request_packet",
    "response_packet",
    "request_offset",
    "response_offset",
    "source_mac",
    "destination_mac",
    "vlan",
)
"""The columns in order. A column never changes its name or meaning; new columns come last."""


def transaction_to_jsonl(transaction: NamedTransaction) -> bytes:
    """Return a transaction as one line of jsonl, with its line end."""
    return _line(transaction, transaction.start_ns, "request_raw", "response_raw")


def event_to_jsonl(event: WireEvent) -> bytes:
    """Return an event as one line of jsonl, with its line end."""
    return _line(EventMessage.of(event), event.ts_ns, "raw")


class CsvWriter:
    """Writes transactions as CSV rows of one line each, after a row of column names."""

    def __init__(self, stream: TextIO) -> None:
        """Write the column names. `stream` must be opened with newline=""."""
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow(CSV_COLUMNS)

    def write(self, transaction: NamedTransaction) -> None:
        self._writer.writerow(csv_row(transaction))


def csv_row(transaction: NamedTransaction) -> list[str]:
    """Return the cells of CSV_COLUMNS; a cell is empty if its field does not apply."""
    fields = _with_hex(transaction)
    points = "; ".join(
        f"{point.name}{':=' if point.written else '='}{point.text}" for point in transaction.points
    )
    fields["points"] = points
    fields["time"] = iso_time(transaction.start_ns)
    return [_cell(fields.get(column)) for column in CSV_COLUMNS]


def iso_time(ts_ns: int) -> str | None:
    """A time in UTC ns as ISO 8601: `2026-11-22T09:14:03.201000000Z`; None beyond the year 9999.

    It always has nine decimals, so that texts sort as times.
    """
    seconds, ns = divmod(ts_ns, 1_000_000_000)
    text = _second(seconds)
    return None if text is None else f"{text}.{ns:09d}Z"


@lru_cache(maxsize=64)
def _second(seconds: int) -> str | None:
    """A whole second since 1970 as ISO 8601. Cached, as many rows are of the same second."""
    try:
        return (_EPOCH + timedelta(seconds=seconds)).isoformat()
    except OverflowError:
        return None


def _line(message: msgspec.Struct, ts_ns: int, *bytes_fields: str) -> bytes:
    # msgspec.structs.replace checks no types, so it can put hex strings into fields of type bytes.
    hexes = {name: raw.hex() for name in bytes_fields if (raw := getattr(message, name))}
    line = _encode(msgspec.structs.replace(message, **hexes))
    if not line.isascii():
        line = _escaped(line)
    time = iso_time(ts_ns)
    return line + b"\n" if time is None else b'%b,"time":"%b"}\n' % (line[:-1], time.encode())


def _escaped(line: bytes) -> bytes:
    """A JSON text in which characters that cannot be printed are written as JSON escapes."""
    text = line.decode()
    if text.isprintable():
        return line
    return "".join(one if one.isprintable() else json.dumps(one)[1:-1] for one in text).encode()


def _with_hex(message: msgspec.Struct) -> dict[str, Any]:
    fields: dict[str, Any] = msgspec.to_builtins(message, builtin_types=(bytes,))
    for name, value in fields.items():
        if isinstance(value, bytes):
            fields[name] = value.hex()
    return fields


def _cell(value: object) -> str:
    match value:
        case None:
            return ""
        case list():
            return _cell(" ".join(map(str, value)))
        case str():
            text = value.translate(_ONE_LINE)
            if not text.isprintable():
                text = "".join(one if one.isprintable() else "?" for one in text)
            return f"'{text}" if text.startswith(_FORMULA) else text
        case _:
            return str(value)
