from __future__ import annotations

from msgspec.structs import replace

from mbtool.devices.checking.finding import Finding
from mbtool.modbus import Outcome
from mbtool.views.report import transaction_rows
from mbtool.views.report.transaction_rows import FIRST, MORE, OF_KIND, TransactionRows
from tests.series.test_history import asked

FAILED = asked(1, outcome=Outcome.NO_ANSWER, latency_ms=None)


def test_the_first_rows_and_those_with_something_wrong_are_kept() -> None:
    rows = TransactionRows()
    for number in range(FIRST + 1000):
        rows.add(FAILED if number % 500 == 499 else asked(0), ["MB-401"] if number == 5600 else [])
    kept = [row[0] for row in rows.rows]
    assert kept[:FIRST] == list(range(1, FIRST + 1))
    assert kept[FIRST:] == [5500, 5601, 6000]
    told = rows.document()
    assert (told["transactions"], told["with_trouble"]) == (6000, 13)
    assert told["kept_with_trouble"] == told["with_trouble"]


def test_a_row_holds_places_of_texts() -> None:
    rows = TransactionRows()
    rows.add(replace(asked(1, latency_ms=7), findings=["FT1A-Q3"]), ["RTU-201"])
    told = rows.document()
    (row,) = told["rows"]
    number, us, link, unit, what, result, outcome, latency, codes = row
    assert (number, us, unit, latency) == (1, 0, 1, 7000)
    assert [told["texts"][one] for one in (link, what, result, outcome, codes)] == [
        "rs485", "03 read holding", "ok", "ok", "FT1A-Q3 RTU-201",
    ]  # fmt: skip


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
    assert sum(map(len, rows.document()["texts"])) < transaction_rows.ROOM[-1][0] + FIRST * 20


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
        rows.mark(Finding(code=code, message="", ts_ns=asked(1).start_ns, link="rs485", unit=1))
    rows.mark(Finding(code="MB-404", message="", ts_ns=7, link="rs485", unit=1))
    told = rows.document()
    assert [told["texts"][row[-1]] for row in told["rows"]] == ["RTU-101 MB-404", ""]
    assert told["with_trouble"] == told["kept_with_trouble"] == 1
