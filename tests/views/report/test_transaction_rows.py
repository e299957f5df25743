from __future__ import annotations

from functools import partial

from msgspec.structs import replace

from mbtool.devices.checking.finding import Finding
from mbtool.ledger.unit_account import UnitKey
from mbtool.modbus import Outcome
from mbtool.troubles.polling import LATE_NS
from mbtool.views.report import transaction_rows
from mbtool.views.report.late_answers import MAX_UNITS, OF_UNIT, LateAnswers
from mbtool.views.report.transaction_rows import FIRST, MORE, OF_KIND, TransactionRows
from tests.ledger.test_account_over_time import asked

FAILED = asked(1, outcome=Outcome.NO_ANSWER, latency_ms=None)


def test_the_first_rows_and_those_with_something_wrong_are_kept() -> None:
    rows = TransactionRows()
    for number in range(FIRST + 1000):
        rows.add(FAILED if number % 500 == 499 else asked(0), ["MB-401"] if number == 5600 else [])
    kept = [row[0] for row in rows.rows]
    assert kept[:FIRST] == list(range(1, FIRST + 1))
    assert kept[FIRST:] == [5500, 5601, 6000]
    told = rows.document({})
    assert (told["transactions"], told["with_trouble"]) == (6000, 13)
    assert told["kept_with_trouble"] == told["with_trouble"]


def test_late_answers_behind_the_first_rows_are_kept_with_their_numbers() -> None:
    rows = TransactionRows()
    for number in range(1, FIRST + 1001):
        slow = {FIRST + 20: 400, FIRST + 900: 700, 7: 400}.get(number, 5)
        rows.add(asked(number, latency_ms=slow), ())
        if number == FIRST + 500:
            rows.add(asked(number, unit=2, latency_ms=400), ())
            rows.add(FAILED, ())
    told = rows.document({UnitKey("rs485", 1): 300_000_000})
    assert [row[0] for row in told["rows"][FIRST:]] == [FIRST + 20, FIRST + 502, FIRST + 902]
    assert told["late"] == 2
    assert len(rows.document({})["rows"]) == FIRST + 1


def test_of_many_slow_answers_the_slowest_are_kept_and_the_first_of_equal_ones() -> None:
    late = LateAnswers()
    unit = UnitKey("rs485", 1)
    for number, latency_ms in enumerate([150] * 150 + [200] * 30, 1):
        late.offer(unit, latency_ms * 1_000_000, number, partial(asked, number))
    kept = [number for number, _ in late.late({unit: LATE_NS})]
    assert kept == [*range(1, OF_UNIT - 29), *range(151, 181)]
    for number in range(2, 1000):
        late.offer(UnitKey("rs485", number), LATE_NS, number, partial(asked, number))
    limits = {UnitKey("rs485", number): LATE_NS for number in range(2, 1000)}
    assert len(late.late(limits)) == MAX_UNITS - 1


def test_a_row_holds_places_of_texts() -> None:
    rows = TransactionRows()
    rows.add(replace(asked(1, latency_ms=7), findings=["FT1A-Q3"]), ["RTU-201"])
    told = rows.document({})
    (row,) = told["rows"]
    number, us, link, unit, what, result, outcome, latency, codes = row
    assert (number, us, unit, latency) == (1, 0, 1, 7000)
    assert [told["texts"][one] for one in (link, what, result, outcome, codes)] == [
        "rs485", "03 read holding", "ok", "ok", "FT1A-Q3 RTU-201",
    ]  # fmt: skip


def test_a_retry_is_marked_until_it_turns_out_to_be_none() -> None:
    rows = TransactionRows()
    for at in (1, 2, 3):
        rows.add(replace(asked(at), retries=at), ())
    unit = UnitKey("rs485", 1)
    for at, number in ((2, 1), (3, 1), (3, -1), (9, 1)):
        rows.mark_retry(unit, asked(at).start_ns, number)
    told = rows.document({})
    assert [row[9:] for row in told["rows"]] == [[], [1], []]
    assert {told["texts"][row[4]] for row in told["rows"]} == {"03 read holding"}


def test_many_failures_of_one_kind_leave_room_for_others() -> None:
    rows = TransactionRows()
    for _ in range(FIRST + OF_KIND + 500):
        rows.add(FAILED, ())
    rows.add(asked(9, unit=2, outcome=Outcome.EXCEPTION), ())
    assert len(rows.rows) == FIRST + OF_KIND + 1
    assert rows.with_trouble - rows.kept_with_trouble == 500


def test_the_size_is_bounded() -> None:
    rows = TransactionRows()
    for number in range(FIRST + MORE):
        name = f"{number} {'long name ' * 100}"
        rows.add(
            replace(asked(0, outcome=Outcome.MALFORMED), function_name=name, function=0x65), ()
        )
    assert sum(map(len, rows.document({})["texts"])) < transaction_rows.ROOM[-1][0] + FIRST * 20


def test_everything_is_kept_on_request() -> None:
    rows = TransactionRows(everything=True)
    for _ in range(FIRST + 10):
        rows.add(asked(0), ())
    assert len(rows.rows) == FIRST + 10


def test_a_finding_that_comes_later_marks_the_row_that_it_is_about() -> None:
    rows = TransactionRows()
    for at in (1, 2):
        rows.add(asked(at), ())
    for code in ("RTU-101", "RTU-101", "MB-404"):
        rows.add_finding(
            Finding(code=code, message="", ts_ns=asked(1).start_ns, link="rs485", unit=1)
        )
    rows.add_finding(Finding(code="MB-404", message="", ts_ns=7, link="rs485", unit=1))
    told = rows.document({})
    assert [told["texts"][row[-1]] for row in told["rows"]] == ["RTU-101 MB-404", ""]
    assert told["with_trouble"] == told["kept_with_trouble"] == 1
