"""Finds rows of a live table by text, or by bytes in hexadecimal."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from mbtool.core import WireEvent
from mbtool.views.watch_columns import DrawContext, row_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.views.watch_columns import WatchColumn

_HEX = re.compile(r"(?:0x)?((?:[0-9a-f]{2}[ :]?)+)", re.IGNORECASE)


def find_row(
    rows: Sequence[Any], columns: Sequence[WatchColumn], text: str, start: int, step: int
) -> int | None:
    """Return the index of the next row that shows `text`, or whose frames have its bytes.

    `text` stands for bytes if it is hexadecimal, such as `01 03`. The search begins with the row
    after `start` (`step` 1) or before it (-1), and wraps around; row `start` itself comes last.
    Returns None if no row matches.
    """
    wanted, data = text.lower(), hex_bytes(text)
    context = DrawContext()
    for distance in range(1, len(rows) + 1):
        index = (start + step * distance) % len(rows)
        row = rows[index]
        if wanted in row_text(row, columns, context).lower() or (data and _has_bytes(row, data)):
            return index
    return None


def hex_bytes(text: str) -> bytes:
    """Return the bytes of `01 03`, `0103` or `0x0103`; empty for a text that is not hexadecimal."""
    match = _HEX.fullmatch(text.strip())
    return bytes.fromhex(match[1].replace(":", " ")) if match is not None else b""


def _has_bytes(row: Any, data: bytes) -> bool:
    if row.kept is None:
        return False
    record = row.kept.record
    if isinstance(record, WireEvent):
        return data in record.raw
    return data in (record.request_raw or b"") or data in (record.response_raw or b"")
