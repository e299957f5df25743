from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices import NamedTransaction
from mbtool.ledger.answered_reads import AnsweredReads, ReadValues, ValueChanges
from mbtool.ledger.history import MAX_ROWS, History, LinkSum, UnitRow, UnitSum
from mbtool.modbus import Outcome
from mbtool.modbus.adu import DirectionBy, Transport

if TYPE_CHECKING:
    from collections.abc import Sequence

S = 1_000_000_000
START = 1_700_000_000 * S


def asked(
    at_s: float, unit: int = 1, outcome: Outcome = Outcome.OK, latency_ms: int | None = 5
) -> NamedTransaction:
    return NamedTransaction(
        link="rs485",
        transport=Transport.RTU,
        unit=unit,
        function=3,
        function_name="read holding registers",
        outcome=outcome,
        request_ns=START + round(at_s * S),
        latency_ns=None if latency_ms is None else latency_ms * 1_000_000,
        retries=0,
        request_raw=bytes(8),
        direction_by=DirectionBy.PORT,
        confidence=1.0,
    )


class NoValues(ReadValues):
    def last(self) -> list[int]:
        return []

    def changes(self, before: Sequence[int] | None, place: int) -> ValueChanges:
        return ValueChanges([], [], [])


def event(at_s: float, kind: EventKind, raw: bytes = b"") -> WireEvent:
    return WireEvent(ts_ns=START + round(at_s * S), link="rs485", kind=kind, message="", raw=raw)


def test_outcomes_and_latencies_are_counted_by_unit() -> None:
    told = History()
    for record in (
        asked(0),
        asked(0.0001, latency_ms=9),
        asked(0.0002, outcome=Outcome.EXCEPTION),
        asked(0.0003, unit=2, outcome=Outcome.NO_ANSWER, latency_ms=None),
    ):
        told.add(record)
    row = UnitRow("rs485", 1)
    assert told.bins.column(row, UnitSum.TRANSACTIONS) == [3]
    assert told.bins.column(row, UnitSum.EXCEPTION) == [1]
    assert told.bins.column(row, UnitSum.LATENCY_NS) == [19_000_000]
    assert told.bins.column(UnitRow("rs485", 2), UnitSum.NO_ANSWER) == [1]
    assert told.bins.column("rs485", LinkSum.BYTES) == [32]


def test_reads_counted_together_stay_apart_while_the_bins_become_wider() -> None:
    at_s = (0, 0.4, 0.8, 1.6)  # The bins become twice as wide at 0.4 s.
    together, singly = History(), History()
    for at in at_s:
        singly.add(asked(at - START / S))
    times = [round(at * S) for at in at_s]
    reads = AnsweredReads("rs485", 1, 3, 0, 1, 8, times, [5_000_000] * 4, NoValues())
    together.add_reads([reads])
    for place in UnitSum:
        row = UnitRow("rs485", 1)
        assert together.bins.column(row, place) == singly.bins.column(row, place)
    assert together.bins.column("rs485", LinkSum.BYTES) == singly.bins.column(
        "rs485", LinkSum.BYTES
    )


def test_a_wrong_crc_counts_for_the_unit_whose_request_was_open() -> None:
    told = History()
    told.add(event(0.02, EventKind.BAD_CHECK, b"\x07" * 9))
    told.add(asked(0, unit=4, outcome=Outcome.NO_ANSWER, latency_ms=None))
    assert sum(told.bins.column(UnitRow("rs485", 4), UnitSum.BAD_CHECK)) == 1


def test_a_wrong_crc_before_the_request_counts_for_no_unit() -> None:
    told = History()
    told.add(event(0, EventKind.BAD_CHECK))
    told.add(asked(1, unit=4, outcome=Outcome.NO_ANSWER, latency_ms=None))
    assert sum(told.bins.column(UnitRow("rs485", 4), UnitSum.BAD_CHECK)) == 0
    assert sum(told.bins.column("rs485", LinkSum.BAD_CHECK)) == 1


def test_what_the_capture_lacks_is_counted_by_link() -> None:
    told = History()
    told.add(event(0, EventKind.GAP))
    told.add(event(0, EventKind.SKIPPED, bytes(3)))
    told.add(event(0, EventKind.OPENED))
    assert told.bins.column("rs485", LinkSum.LACKING) == [1]
    assert told.bins.column("rs485", LinkSum.NO_FRAME) == [1]
    assert told.bins.column("rs485", LinkSum.BYTES) == [3]


def test_memory_is_bounded() -> None:
    told = History()
    for link in range(MAX_ROWS + 20):
        told.add(WireEvent(ts_ns=START, link=str(link), kind=EventKind.GAP, message=""))
    assert len(told.bins) == MAX_ROWS
