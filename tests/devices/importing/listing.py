"""Rows of register lists, read without placing them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.devices.importing.addresses import parse_address
from mbtool.devices.importing.columns import Column, Meaning, Sheet, find_sheet
from mbtool.devices.importing.placing import ImportOptions, Placer
from mbtool.devices.importing.rows import Complaints, Item, RowReader, Scaling

if TYPE_CHECKING:
    from mbtool.devices.importing.layout import PlacedRow


def read_items(
    text: str, scaling: Scaling | None = None
) -> tuple[list[Item], Complaints, RowReader]:
    """The rows of a list whose first column has the addresses."""
    sheet = find_sheet(text, "map.csv")
    complaints = Complaints("map.csv")
    reader = RowReader(sheet, complaints, scaling)
    items = []
    for number, row in enumerate(sheet.rows[1:], start=2):
        written = parse_address(row[0])
        assert written is not None, row
        items.append(reader.item(number, row, written, None, None))
    return items, complaints, reader


def place(text: str, **options: Any) -> tuple[list[PlacedRow], Complaints, Placer]:
    """The rows of such a list in their places."""
    items, complaints, _ = read_items(text)
    chosen = ImportOptions(**options)
    placer = Placer(items, address_column(find_sheet(text, "map.csv")), chosen, complaints)
    return placer.place_all(), complaints, placer


def address_column(sheet: Sheet) -> Column:
    """The column of addresses."""
    column = sheet.column(Meaning.ADDRESS)
    assert column is not None
    return column
