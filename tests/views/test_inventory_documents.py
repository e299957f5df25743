"""An inventory as JSON and CSV."""

from __future__ import annotations

import csv
import json

import msgspec
import pytest

from mbtool.ledger.baseline import changes
from mbtool.ledger.inventory_rows import InventoryDocument
from mbtool.views.inventory_documents import (
    CHANGE_COLUMNS,
    INVENTORY_COLUMNS,
    changes_csv,
    inventory_csv,
    inventory_json,
    spreadsheet_cell,
)
from tests.ledger.plant import asked, inventory_of, named, plant


def test_json_has_every_field_and_can_be_read_again() -> None:
    document = inventory_of(plant())
    text = inventory_json(document, "1.2.3")
    data = json.loads(text)
    assert (data["mbtool"], data["format"]) == ("1.2.3", "mbtool-inventory-1")
    assert data["slaves"][0]["first"] == "2023-11-14T22:13:20.000000Z"
    assert data["slaves"][0]["role"] == "slave"
    assert "changes" not in data
    assert msgspec.json.decode(text, type=InventoryDocument) == document


def test_json_against_a_baseline_has_the_changes() -> None:
    old, new = inventory_of(plant()), inventory_of([*plant(), asked(4, 0, 2)])
    data = json.loads(inventory_json(new, "1", changes(old, new)))
    assert [one["kind"] for one in data["changes"]] == ["new function"]


def test_csv_has_a_row_for_each_unit_and_master() -> None:
    rows = list(csv.DictReader(inventory_csv(inventory_of(plant())).splitlines()))
    assert tuple(rows[0]) == INVENTORY_COLUMNS
    assert [(row["host"], row["unit"], row["role"]) for row in rows] == [
        ("10.0.0.10", "1", "slave"),
        ("10.0.0.20", "3", "gateway"),
        ("10.0.0.20", "4", "gateway"),
        ("10.0.0.1", "", "master"),
        ("10.0.0.2", "", "master"),
    ]
    first = rows[0]
    assert first["reads"] == "03 read holding 0..99; 03 read holding 0..9; 2B encapsulated"
    assert first["writes"] == "10 write registers 10..11"
    assert (first["readers"], first["writers"]) == ("10.0.0.1; 10.0.0.2", "10.0.0.1")


def test_refused_addresses_have_a_column() -> None:
    document = inventory_of([asked(3, 0, 4), asked(3, 90, 2, exception=2)])
    (row, _) = csv.DictReader(inventory_csv(document).splitlines())
    assert (row["refused"], row["exceptions"]) == ("03 read holding 90..91", "02 x1")


def test_changes_as_csv() -> None:
    old, new = inventory_of(plant()), inventory_of([*plant(), asked(4, 0, 2)])
    (row,) = csv.DictReader(changes_csv(changes(old, new)).splitlines())
    assert tuple(row) == CHANGE_COLUMNS
    assert (row["kind"], row["host"], row["unit"]) == ("new function", "10.0.0.10", "1")


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
        ("+1", "'+1"),
        (" @SUM(A1)", "' @SUM(A1)"),
        ("-2", "'-2"),
        (-2, "-2"),
        ("a\r\nb\x1b", "a  b?"),
        ("\t=1", "' =1"),
        (None, ""),
        ("plain", "plain"),
    ],
)
def test_no_cell_is_a_formula(value: object, cell: str) -> None:
    assert spreadsheet_cell(value) == cell


def test_a_text_of_a_device_cannot_be_a_formula() -> None:
    document = inventory_of([named("=1+1"), asked(3, 0, 1, slave="=10.0.0.7")])
    rows = list(csv.reader(inventory_csv(document).splitlines()))
    assert not any(cell.startswith(("=", "+", "@")) for row in rows for cell in row)
