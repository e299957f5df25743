"""Counts over time what the units and the links of a capture did."""

# Memory: MAX_ROWS units and links with MAX_BINS bins (time_bins.py) each; units beyond are counted
# for their link only.

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Outcome
from mbtool.serial_line.damaged_answers import DamagedAnswers
from mbtool.series.time_bins import TimeBins, note_value

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

MAX_ROWS = 256

_NO_FRAME = frozenset((EventKind.SKIPPED, EventKind.FOREIGN, EventKind.ECHO))
_LACKING = frozenset((EventKind.GAP, EventKind.DISCARDED, EventKind.CUT))


class UnitSum(IntEnum):
    """What is counted of a unit, by the place in its bins."""

    TRANSACTIONS = 0
    OK = 1
    EXCEPTION = 2
    NO_ANSWER = 3
    OTHER = 4
    """Every other outcome: not captured, unsolicited, broadcast, malformed."""
    RETRIES = 5
    BAD_CHECK = 6
    """Answers with a wrong CRC or LRC."""
    LATENCIES = 7
    """The number of latencies."""
    LATENCY_NS = 8
    """The sum of the latencies, in ns."""


class LinkSum(IntEnum):
    """What is counted of a link, by the place in its bins."""

    TRANSACTIONS = 0
    BYTES = 1
    """Bytes on the line, also those that are in no frame."""
    BAD_CHECK = 2
    NO_FRAME = 3
    """Events about bytes that are in no frame."""
    LACKING = 4
    """Events about data that the capture lacks."""


class UnitRow(NamedTuple):
    """The key of a unit's bins."""

    link: str
    unit: int


_PLACES = {
    Outcome.OK: UnitSum.OK,
    Outcome.EXCEPTION: UnitSum.EXCEPTION,
    Outcome.NO_ANSWER: UnitSum.NO_ANSWER,
}


class History:
    """Counts records by time; its attributes can be read at any time."""

    def __init__(self) -> None:
        self.bins = TimeBins(max(len(UnitSum), len(LinkSum)))
        """Rows of units have a UnitRow as key, and rows of links the link's name."""
        self._damaged = DamagedAnswers()

    def add(self, record: NamedTransaction | WireEvent) -> None:
        if isinstance(record, WireEvent):
            self._add_event(record)
        else:
            self._add_transaction(record)

    def _add_transaction(self, one: NamedTransaction) -> None:
        at_ns = one.start_ns
        if self._has_room(one.link):
            link = self.bins.bin(one.link, at_ns)
            link[LinkSum.TRANSACTIONS] += 1
            link[LinkSum.BYTES] += len(one.request_raw or b"") + len(one.response_raw or b"")
        row = UnitRow(one.link, one.unit)
        if not self._has_room(row):
            return
        unit = self.bins.bin(row, at_ns)
        outcome = one.outcome
        unit[UnitSum.TRANSACTIONS] += 1
        unit[_PLACES.get(outcome, UnitSum.OTHER)] += 1
        if one.retries:
            unit[UnitSum.RETRIES] += 1
        latency_ns = one.latency_ns
        if latency_ns is not None:
            unit[UnitSum.LATENCIES] += 1
            unit[UnitSum.LATENCY_NS] += latency_ns
            note_value(unit, latency_ns)
        elif self._damaged.has(one):
            unit[UnitSum.BAD_CHECK] += 1

    def _add_event(self, event: WireEvent) -> None:
        if event.kind is EventKind.BAD_CHECK:
            place = LinkSum.BAD_CHECK
            self._damaged.note(event)
        elif event.kind in _NO_FRAME:
            place = LinkSum.NO_FRAME
        elif event.kind in _LACKING:
            place = LinkSum.LACKING
        else:
            return
        if self._has_room(event.link):
            link = self.bins.bin(event.link, event.ts_ns)
            link[place] += 1
            link[LinkSum.BYTES] += 0 if place is LinkSum.LACKING else len(event.raw)

    def _has_room(self, row: UnitRow | str) -> bool:
        return row in self.bins or len(self.bins) < MAX_ROWS
