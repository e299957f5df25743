"""Formats transactions and events as lines of jsonl or CSV."""

# A jsonl line is one transaction with the fields of docs/log-format.md, or one event. Only events
# have `kind`, and only transactions have `outcome`:
#
#     jq 'select(.outcome == "exception")'      jq 'select(.kind == "gap")'
#
# Bytes are lower-case hex; times are UTC nanoseconds as integers; a field that does not apply is
# absent in jsonl and empty in CSV. In CSV the values of a list are separated by spaces, and a line
# end inside a text becomes a space.

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any, TextIO

import msgspec

from mbtool.logs.messages import EventMessage

if TYPE_CHECKING:
    from mbtool.core import WireEvent
    from mbtool.devices import NamedTransaction

_encode = msgspec.json.Encoder().encode

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
)
"""The columns in order. A column never changes its name or meaning; new columns come last."""


def transaction_to_jsonl(transaction: NamedTransaction) -> bytes:
    """Return a transaction as one line of jsonl, with its line end."""
    return _line(transaction, "request_raw", "response_raw")


def event_to_jsonl(event: WireEvent) -> bytes:
    """Return an event as one line of jsonl, with its line end."""
    return _line(EventMessage.of(event), "raw")


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
    return [_cell(fields.get(column)) for column in CSV_COLUMNS]


def _line(message: msgspec.Struct, *bytes_fields: str) -> bytes:
    # msgspec.structs.replace checks no types, so it can put hex strings into fields of type bytes.
    hexes = {name: raw.hex() for name in bytes_fields if (raw := getattr(message, name))}
    return _encode(msgspec.structs.replace(message, **hexes)) + b"\n"


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
        case _:
            return str(value).translate(_ONE_LINE)
