"""Rows of register lists, read without making a profile of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.devices.importing.columns import find_sheet
from mbtool.devices.importing.locating import LocatedRow, locate_rows
from mbtool.devices.importing.options import ImportOptions, ImportReport, Scaling
from mbtool.devices.importing.register_list import BodyReader

if TYPE_CHECKING:
    from mbtool.devices.importing.rows import ListRow


def read_rows(text: str, scaling: Scaling | None = None) -> tuple[list[ListRow], ImportReport]:
    """The rows of a list, and what is told of them."""
    report = ImportReport()
    sheet = find_sheet(text, "map.csv")
    return BodyReader(sheet, ImportOptions(scaling=scaling), report).read(), report


def locate(text: str, **options: Any) -> tuple[list[LocatedRow], ImportReport]:
    """The rows of a list with their areas, and what is told of them."""
    rows, report = read_rows(text)
    addresses = find_sheet(text, "map.csv").addresses
    return locate_rows(rows, addresses, ImportOptions(**options), report), report
