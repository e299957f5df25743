"""Writes an inventory (the hosts, units and masters of a capture) as JSON or CSV."""

# The JSON has the fields of InventoryDocument (ledger/inventory_rows.py), the program's version,
# whether the files could be read to their ends, remarks about them and, if the user names an older
# inventory as baseline, the changes since then. mbtool can read this JSON again as a baseline.
#
# A row of CSV is a unit of a host, or a master; a master's row has no unit. Several values in a
# cell are separated by "; ". A spreadsheet would take a text that begins with = + - or @ as a
# formula, so such a text gets a ' in front.

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from mbtool.ledger.inventory_ranges import MAX_RANGES, ranges_text
from mbtool.ledger.inventory_rows import InventoryDocument, MasterRow, Role, SlaveRow, iso_time
from mbtool.views.inventory_table import UNKNOWN, function_label, identity_text
from mbtool.views.tables import printable_json
from mbtool.views.trouble_lines import trouble_documents

if TYPE_CHECKING:
    from mbtool.ledger.baseline import InventoryChange
    from mbtool.troubles.judge import Judgement

INVENTORY_COLUMNS = (
    "host", "port", "unit", "role", "macs", "makers", "identity", "device", "profile", "score",
    "why", "reads", "writes", "refused", "readers", "writers", "transactions", "answered",
    "unanswered", "exceptions", "first", "last", "first_ns", "last_ns", "transports",
    "unreached",
)  # fmt: skip
"""The CSV columns in order. A column never changes its name or meaning; new columns come last."""
CHANGE_COLUMNS = ("kind", "host", "port", "unit", "text", "first", "first_ns")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_ONE_LINE = str.maketrans("\r\n\t", "   ")


def inventory_json(
    document: InventoryDocument,
    version: str,
    changes: Sequence[InventoryChange] | None = None,
    *,
    judgement: Judgement | None = None,
    remarks: Sequence[str] = (),
    is_whole: bool = True,
) -> str:
    """Return the inventory as JSON, with a line end.

    `version` is that of mbtool. `changes` are those since a baseline, None without a baseline.
    `judgement` says what is wrong; None if nobody judged.
    `remarks` are lines for the user about the files. `is_whole` is False if a part of the files
    could not be read.
    """
    fields: dict[str, Any] = {"mbtool": version, **msgspec.to_builtins(document)}
    for row in (*fields.get("slaves", ()), *fields.get("masters", ())):
        row["first"], row["last"] = (
            iso_time(row.get("first_ns", 0)),
            iso_time(row.get("last_ns", 0)),
        )
    fields |= {"is_whole": is_whole, "remarks": list(remarks)}
    if judgement is not None:
        fields |= trouble_documents(judgement)
    if changes is not None:
        fields["changes"] = msgspec.to_builtins(changes)
    text = msgspec.json.format(msgspec.json.encode(fields), indent=2).decode()
    return printable_json(text) + "\n"


def inventory_csv(document: InventoryDocument) -> str:
    """Return the inventory as CSV: a row for each unit, then a row for each master."""
    rows = [_slave_cells(row) for row in document.slaves]
    rows += [_master_cells(row) for row in document.masters]
    return _csv(INVENTORY_COLUMNS, rows)


def changes_csv(changes: Sequence[InventoryChange]) -> str:
    """Return the changes since an older inventory as CSV."""
    rows: list[dict[str, object]] = [
        {
            "kind": one.kind.value,
            "host": one.host,
            "port": one.port,
            "unit": one.unit,
            "text": one.text,
            "first": "" if one.first_ns is None else iso_time(one.first_ns),
            "first_ns": one.first_ns,
        }
        for one in changes
    ]
    return _csv(CHANGE_COLUMNS, rows)


def spreadsheet_cell(value: object) -> str:
    """Return a value as text for a CSV cell that no spreadsheet takes as a formula."""
    if value is None:
        return ""
    if isinstance(value, int):
        return str(value)
    text = "".join(char if char.isprintable() else "?" for char in str(value).translate(_ONE_LINE))
    return f"'{text}" if text.lstrip().startswith(_FORMULA) else text


def _csv(columns: Sequence[str], rows: Iterable[dict[str, object]]) -> str:
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([spreadsheet_cell(row.get(column)) for column in columns])
    return stream.getvalue()


def _slave_cells(row: SlaveRow) -> dict[str, object]:
    fit = row.fit
    writers = row.masters(writing=True)
    return {
        "host": row.host,
        "port": row.port,
        "unit": row.unit,
        "role": row.role.value,
        "macs": "; ".join(row.macs),
        "makers": "; ".join(row.makers),
        "identity": identity_text(row),
        "device": row.device,
        "profile": "" if fit is None else fit.profile or UNKNOWN,
        "score": None if fit is None else fit.score,
        "why": "" if fit is None else fit.why,
        "reads": _uses(row, writes=False),
        "writes": _uses(row, writes=True),
        "refused": _uses(row, refused=True),
        "readers": "; ".join(
            dict.fromkeys(use.master for use in row.uses if use.master and not use.writes)
        ),
        "writers": "; ".join(writers),
        "transactions": row.transactions,
        "answered": row.answered,
        "unanswered": row.unanswered,
        "exceptions": "; ".join(f"{code:02X} x{count}" for code, count in row.exceptions.items()),
        "first": iso_time(row.first_ns),
        "last": iso_time(row.last_ns),
        "first_ns": row.first_ns,
        "last_ns": row.last_ns,
        "transports": "; ".join(row.transports),
        "unreached": row.unreached,
    }


def _master_cells(row: MasterRow) -> dict[str, object]:
    return {
        "host": row.host,
        "role": Role.MASTER.value,
        "macs": "; ".join(row.macs),
        "makers": "; ".join(row.makers),
        "transactions": row.requests,
        "first": iso_time(row.first_ns),
        "last": iso_time(row.last_ns),
        "first_ns": row.first_ns,
        "last_ns": row.last_ns,
    }


def _uses(row: SlaveRow, *, writes: bool = False, refused: bool = False) -> str:
    """List functions that masters use on a unit, with their address ranges; equal texts only once.

    With `refused`, these are the ranges that the unit refused. Otherwise they are the ranges of
    functions that write (`writes`) or that only read.
    """
    texts = []
    for use in row.uses:
        ranges = use.refused if refused else use.ranges
        if (refused and not ranges) or (not refused and use.writes is not writes):
            continue
        label = function_label(use.function, use.name)
        texts.append(f"{label} {ranges_text(ranges, MAX_RANGES)}".rstrip())
    return "; ".join(dict.fromkeys(texts))
