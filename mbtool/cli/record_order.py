"""The sort keys for the orders in which records can be printed."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Any

from mbtool.cli.options import SortKey
from mbtool.core import WireEvent

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record

SORTED: dict[SortKey, Callable[[tuple[Record, int]], Any]] = {
    SortKey.TIME: lambda one: start_ns(one[0]),
    SortKey.LATENCY: lambda one: _latency_ns(one[0]),
    SortKey.LINK: lambda one: one[0].link,
    SortKey.UNIT: lambda one: _field_of(one[0], "unit") or 0,
    SortKey.FUNCTION: lambda one: _field_of(one[0], "function") or 0,
    SortKey.ADDRESS: lambda one: _field_of(one[0], "address") or 0,
}


def _latency_ns(record: Record) -> float:
    """Return the sort key for the slowest first: the negative latency in ns.

    It is infinity for a record without latency, which comes last.
    """
    latency_ns = _field_of(record, "latency_ns")
    return inf if latency_ns is None else -latency_ns


def _field_of(record: Record, field: str) -> int | None:
    """Return the value of `field` in a transaction; None for an event, which has no such field."""
    value: int | None = getattr(record, field, None)
    return value


def start_ns(record: Record) -> int:
    """Return the time by which records are sorted, in ns since 1970: their start, or the event."""
    return record.ts_ns if isinstance(record, WireEvent) else record.start_ns
