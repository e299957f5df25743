from __future__ import annotations

import csv
import io
import json

import msgspec
import pytest
from hypothesis import given

from mbtool.devices import NamedTransaction
from mbtool.logs.exports import (
    CsvWriter,
    csv_columns,
    csv_row,
    event_to_jsonl,
    iso_time,
    transaction_to_jsonl,
)
from tests.logs.samples import EVENT, NAMED, transaction, transactions


def test_a_transaction_is_one_line_with_bytes_in_hex() -> None:
    assert transaction_to_jsonl(transaction()) == (
        b'{"link":"rs485","transport":"rtu","unit":1,"function":3,'
        b'"function_name":"read holding registers","address":0,"quantity":2,'
        b'"response_values":[4660,22136],"outcome":"ok","request_ns":1700000000000000000,'
        b'"response_ns":1700000000000500000,"latency_ns":400000,"retries":0,'
        b'"request_raw":"010300000002c40b","response_raw":"010304123456788107",'
        b'"direction_by":"pending","confidence":0.9,"time":"2023-11-14T22:13:20.000000000Z"}\n'
    )


def test_an_event_is_one_line_that_its_kind_tells_from_a_transaction() -> None:
    assert event_to_jsonl(EVENT) == (
        b'{"ts_ns":1700000000000000001,"link":"10.0.0.9","kind":"gap",'
        b'"message":"60 bytes are missing","source":"10.0.0.1:50211",'
        b'"destination":"10.0.0.9:502","missing":60,"time":"2023-11-14T22:13:20.000000001Z"}\n'
    )
    assert "kind" not in NamedTransaction.__struct_fields__
    assert "outcome" not in json.loads(event_to_jsonl(EVENT))


@given(transactions)
def test_a_line_holds_all_of_a_transaction(item: NamedTransaction) -> None:
    line = transaction_to_jsonl(item)
    assert line.count(b"\n") == 1
    fields = json.loads(line)
    fields.pop("time")
    for name in ("request_raw", "response_raw"):
        if name in fields:
            fields[name] = bytes.fromhex(fields[name])
    assert msgspec.convert(fields, NamedTransaction) == item


def test_a_csv_row_has_a_cell_for_each_column() -> None:
    stream = io.StringIO()
    writer = CsvWriter(stream)
    writer.write(NAMED)
    stream.seek(0)
    (row,) = csv.DictReader(stream)
    assert tuple(row) == csv_columns()
    assert row["request_ns"] == "1700000000005000000"
    assert row["response_values"] == "4660 22136"
    assert row["request_values"] == ""
    assert row["verdicts"] == "glued"
    assert row["points"] == "HR400001=4660; level=2.5 m; flow=not a number; valve:=open"
    assert row["findings"] == "FT1A-Q3"
    assert row["request_raw"] == "010300000002c40b"


def test_empty_lists_and_bytes_are_empty_cells() -> None:
    stream = io.StringIO(newline="")
    CsvWriter(stream).write(transaction(response_values=[], request_values=[], response_raw=b""))
    stream.seek(0)
    (row,) = csv.DictReader(stream)
    assert {row[name] for name in ("request_values", "response_values", "response_raw")} == {""}
    assert {row[name] for name in ("verdicts", "findings", "points")} == {""}


def test_every_field_of_a_transaction_has_a_column() -> None:
    assert set(csv_columns()) == {*NamedTransaction.__struct_fields__, "time"}
    assert len(csv_columns()) == len(set(csv_columns()))


@given(transactions)
def test_a_csv_row_is_read_back_whatever_it_holds(item: NamedTransaction) -> None:
    stream = io.StringIO(newline="")
    CsvWriter(stream).write(item)
    stream.seek(0)
    _, row = csv.reader(stream)
    assert len(row) == len(csv_columns())


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "@SUM(A1)", "+1", "-1", "=1"])
def test_a_spreadsheet_takes_no_text_for_a_formula(text: str) -> None:
    row = dict(zip(csv_columns(), csv_row(transaction(reference=text)), strict=True))
    assert row["reference"] == f"'{text}"


@pytest.mark.parametrize("sign", ["\x1b", "\x9b", "\x00", "\u202e", "\u2028"])
def test_what_controls_a_terminal_is_escaped(sign: str) -> None:
    item = transaction(reference=f"HR4{sign}[2J\u00e9")
    row = dict(zip(csv_columns(), csv_row(item), strict=True))
    assert row["reference"] == "HR4?[2J\u00e9"
    line = transaction_to_jsonl(item).decode()
    assert line[:-1].isprintable()
    assert json.loads(line)["reference"] == f"HR4{sign}[2J\u00e9"


@pytest.mark.parametrize(
    ("ts_ns", "text"),
    [
        (0, "1970-01-01T00:00:00.000000000Z"),
        (1_700_000_000_000_000_001, "2023-11-14T22:13:20.000000001Z"),
        (-1, "1969-12-31T23:59:59.999999999Z"),
        (10**20 * 10, None),
    ],
)
def test_a_time_is_written_as_iso_8601(ts_ns: int, text: str | None) -> None:
    assert iso_time(ts_ns) == text
