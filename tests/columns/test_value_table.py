"""The table of values has the rows of Capture.points."""

from __future__ import annotations

from pathlib import Path

import pytest

import mbtool
from mbtool.api.point_rows import PointRow
from mbtool.columns.row_table import row_table
from mbtool.columns.value_table import VALUE_SCHEMA, value_tables
from mbtool.devices import load_profile

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
FILES = sorted(
    path
    for path in (*CAPTURES.glob("*.mcap"), *CAPTURES.glob("*.pcap"), *CAPTURES.glob("*/*.pcap"))
)


@pytest.mark.parametrize("name", [None, "fa3-at1m8x", "idec-ft1a-touch"])
def test_a_table_has_the_rows_of_point_rows(name: str | None) -> None:
    devices: dict[int | str, str] | None = None if name is None else {"all": name}
    for path in FILES:
        if name is not None and path.suffix == ".mcap":
            continue  # A log has profiles of its own.
        capture = mbtool.open(path, devices=devices, incomplete=True)
        expected = list(capture.points())
        tables = value_tables(row_table(list(capture)), load_profile)
        rows = [row for one in tables for row in one.to_pylist()]
        assert [PointRow(*map(row.get, PointRow._fields)) for row in rows] == expected, path


def test_each_value_has_what_joins_it_to_its_transaction() -> None:
    capture = mbtool.open(CAPTURES / "plant.pcap")
    transactions = list(capture)
    (table,) = value_tables(row_table(transactions), lambda _: None)
    assert table.schema == VALUE_SCHEMA
    keys = {(one.link, one.unit, one.request_ns): one for one in transactions}
    assert len(keys) == len(transactions)
    for row in table.to_pylist():
        one = keys[row["link"], row["unit"], row["request_ns"]]
        assert (row["slave"], row["master"], row["file"]) == (
            one.destination, one.source, one.file,
        )  # fmt: skip
        assert row["time_ns"] == one.response_ns
        assert row["time"].timestamp() == row["time_ns"] // 1000 / 1e6
