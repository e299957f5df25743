"""What the account counts over time, by unit and by link."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.core import EventKind, WireEvent
from mbtool.devices import NamedTransaction
from mbtool.ledger.account import Account
from mbtool.ledger.statistics_report import report
from mbtool.ledger.time_bins import LinkSum, UnitSum
from mbtool.ledger.unit_account import UnitKey
from mbtool.modbus import Outcome
from mbtool.modbus.adu import DirectionBy, Transport
from tests.ledger.requests import LINE

if TYPE_CHECKING:
    from mbtool.ledger.time_bins import Row

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


def event(at_s: float, kind: EventKind, raw: bytes = b"") -> WireEvent:
    return WireEvent(ts_ns=START + round(at_s * S), link="rs485", kind=kind, message="", raw=raw)


def account_of(*records: NamedTransaction | WireEvent) -> Account:
    account = Account(lambda _: LINE)
    for record in records:
        account.add(record)
    account.settle()
    return account


def columns(account: Account, row: Row, *places: int) -> list[list[int]]:
    """Some sums of a row in the bins of a chart."""
    chart = account.bins.chart(1000)
    return [chart.column(row, place) for place in places]


def of_unit(account: Account, unit: int, *places: UnitSum) -> list[list[int]]:
    return columns(account, account.units[UnitKey("rs485", unit)].bins, *places)


def of_link(account: Account, *places: LinkSum) -> list[list[int]]:
    return columns(account, account.links["rs485"].bins, *places)


def test_outcomes_and_latencies_are_counted_by_unit() -> None:
    told = account_of(
        asked(0),
        asked(0.0001, latency_ms=9),
        asked(0.0002, outcome=Outcome.EXCEPTION),
        asked(0.0003, unit=2, outcome=Outcome.NO_ANSWER, latency_ms=None),
    )
    sums = UnitSum.REQUESTS, UnitSum.EXCEPTION, UnitSum.LATENCY_NS, UnitSum.GREATEST_NS
    assert of_unit(told, 1, *sums) == [[3], [1], [19_000_000], [9_000_000]]
    assert of_unit(told, 2, UnitSum.NO_ANSWER) == [[1]]
    assert of_link(told, LinkSum.BYTES, LinkSum.REQUESTS) == [[32], [4]]


def test_a_response_without_request_is_no_request_of_its_time() -> None:
    lone = msgspec.structs.replace(
        asked(0, outcome=Outcome.UNSOLICITED, latency_ms=None),
        request_ns=None, request_raw=None, response_ns=START + 7, response_raw=bytes(5),
    )  # fmt: skip
    told = account_of(asked(0), lone)
    assert of_unit(told, 1, UnitSum.REQUESTS) == [[1]]
    assert of_link(told, LinkSum.BYTES, LinkSum.REQUESTS) == [[13], [1]]


def test_a_wrong_crc_counts_for_the_unit_whose_request_was_open() -> None:
    told = account_of(
        event(0.02, EventKind.BAD_CHECK, b"\x07" * 9),
        asked(0, unit=4, outcome=Outcome.NO_ANSWER, latency_ms=None),
    )
    (bad,) = of_unit(told, 4, UnitSum.BAD_CHECK)
    assert sum(bad) == 1


def test_a_wrong_crc_before_the_request_counts_for_no_unit() -> None:
    told = account_of(
        event(0, EventKind.BAD_CHECK), asked(1, unit=4, outcome=Outcome.NO_ANSWER, latency_ms=None)
    )
    (bad,), (of_line,) = of_unit(told, 4, UnitSum.BAD_CHECK), of_link(told, LinkSum.BAD_CHECK)
    assert (sum(bad), sum(of_line)) == (0, 1)


def test_what_the_capture_lacks_is_counted_by_link() -> None:
    told = account_of(
        event(0, EventKind.GAP), event(0, EventKind.SKIPPED, bytes(3)), event(0, EventKind.OPENED)
    )
    found = of_link(told, LinkSum.LACKING, LinkSum.NO_FRAME, LinkSum.BYTES)
    assert found == [[1], [1], [3]]
    assert report(told) == []


def test_retries_are_counted_at_their_times() -> None:
    missing = [asked(at, outcome=Outcome.NO_ANSWER, latency_ms=None) for at in (0, 2, 4)]
    told = account_of(*missing)
    (retries,) = of_unit(told, 1, UnitSum.RETRIES)
    assert (sum(retries), retries[0]) == (2, 0)
    (use,) = told.uses.values()
    assert use.repetitions == 2
