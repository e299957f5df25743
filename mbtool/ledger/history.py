"""Counts over time the transactions, bytes and errors of each unit and each link of a capture."""

# Memory: MAX_ROWS units and links together, with MAX_BINS spans of time (time_bins.py) each. A unit
# beyond that is only counted for its link.

from __future__ import annotations

from enum import IntEnum
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import EventKind, WireEvent
from mbtool.ledger.time_bins import TimeBins, note_value
from mbtool.modbus import Outcome
from mbtool.modbus.damaged_answers import DamagedAnswers

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.devices import NamedTransaction
    from mbtool.ledger.answered_reads import AnsweredReads

MAX_ROWS = 256

_NO_FRAME = frozenset((EventKind.SKIPPED, EventKind.FOREIGN, EventKind.ECHO, EventKind.REPEATED))
_LACKING = frozenset((EventKind.GAP, EventKind.DISCARDED, EventKind.CUT))


class UnitSum(IntEnum):
    """The numbers that are counted for a unit in each span of time. The enumeration's number is the
    index in the list of sums.
    """

    TRANSACTIONS = 0
    OK = 1
    EXCEPTION = 2
    NO_ANSWER = 3
    OTHER = 4
    """Transactions with any other outcome: not captured, unsolicited, broadcast, malformed."""
    RETRIES = 5
    """Requests that repeat an equal one without response at once; only `add_retry` counts them."""
    BAD_CHECK = 6
    """Requests whose response came with a wrong CRC or LRC."""
    LATENCIES = 7
    """Number of transactions whose latency is known."""
    LATENCY_NS = 8
    """Sum of all known latencies, in ns."""
    LATE = 9


class LinkSum(IntEnum):
    """The numbers that are counted for a link in each span of time. The enumeration's number is the
    index in the list of sums.
    """

    TRANSACTIONS = 0
    BYTES = 1
    """The number of all bytes, both those of ADUs and those that belong to no ADU."""
    BAD_CHECK = 2
    NO_FRAME = 3
    """Number of events about bytes that belong to no ADU."""
    LACKING = 4
    """Number of events about bytes that the capture lacks."""


class UnitRow(NamedTuple):
    """Identifies a unit of a link, as the key of its counts."""

    link: str
    unit: int


_PLACES = {
    Outcome.OK: UnitSum.OK,
    Outcome.EXCEPTION: UnitSum.EXCEPTION,
    Outcome.NO_ANSWER: UnitSum.NO_ANSWER,
    Outcome.LATE: UnitSum.LATE,
}


class History:
    """Counts transactions and events over time, in `bins`."""

    def __init__(self) -> None:
        self.bins = TimeBins(max(len(UnitSum), len(LinkSum)))
        """The counts. The key of a unit's counts is a UnitRow, that of a link's is its name."""
        self._damaged = DamagedAnswers()

    def add(self, record: NamedTransaction | WireEvent) -> None:
        if isinstance(record, WireEvent):
            self._add_event(record)
        else:
            self._add_transaction(record)

    def add_reads(self, reads: Iterable[AnsweredReads]) -> None:
        """Count many answered requests, with the same result as `add` for each."""
        # The bins may become wider meanwhile. All requests of a narrower bin are then in one of the
        # wider ones.
        width_ns = self.bins.width_ns
        for one in reads:
            timed = zip(one.request_ns, one.latencies_ns, strict=True)
            for _, some in groupby(timed, lambda times: times[0] // width_ns):
                times, latencies = zip(*some, strict=True)
                self._add_answered(one, times[0], latencies)

    def add_retry(self, row: UnitRow, at_ns: int, number: int = 1) -> None:
        """Count `number` retries of a unit, whose transactions are counted by `add`, too. A
        negative number takes back what was counted before.
        """
        if self._has_room(row):
            self.bins.bin(row, at_ns)[UnitSum.RETRIES] += number

    def _add_answered(self, one: AnsweredReads, at_ns: int, latencies: Sequence[int]) -> None:
        """Count requests that belong to one bin (span of time)."""
        count = len(latencies)
        if self._has_room(one.link):
            link = self.bins.bin(one.link, at_ns)
            link[LinkSum.TRANSACTIONS] += count
            link[LinkSum.BYTES] += count * one.size
        row = UnitRow(one.link, one.unit)
        if self._has_room(row):
            unit = self.bins.bin(row, at_ns)
            for place in (UnitSum.TRANSACTIONS, UnitSum.OK, UnitSum.LATENCIES):
                unit[place] += count
            unit[UnitSum.LATENCY_NS] += sum(latencies)
            note_value(unit, min(latencies))
            note_value(unit, max(latencies))

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
