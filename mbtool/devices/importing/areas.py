"""Makes a profile's areas (ranges of addresses) from the points of a register list."""

# An area covers consecutive addresses of the list. A hole of fewer than MAX_HOLE addresses between
# two points belongs to the area, because masters read such holes together with the points, and most
# devices allow it.

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.devices.model import Access, Area, FunctionRule, Point
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.devices.importing.points import RowPoint

MAX_HOLE = 16
"""An area ends before a hole of this many or more addresses that the list leaves out."""

_READ_FUNCTIONS = {
    known.table: code
    for code, known in FUNCTIONS.items()
    if known.table is not None and not known.writes
}
_WRITE_FUNCTIONS = {Table.COILS: (0x05, 0x0F), Table.HOLDING_REGISTERS: (0x06, 0x10)}


def make_areas(made: Sequence[RowPoint]) -> tuple[list[Area], list[Point], dict[str, FunctionRule]]:
    """Return the areas and the points of a profile, and a rule for each function, by its code as
    two hexadecimal digits. `made` are the points of the register list, sorted by table and address.

    A point gets a key `access` only if its access differs from that of its area. The functions are
    those that the list names, and those that read and write the tables of the list.
    """
    runs: list[list[RowPoint]] = []
    for one in made:
        if runs and _goes_on(runs[-1][-1], one):
            runs[-1].append(one)
        else:
            runs.append([one])
    areas: list[Area] = []
    points: list[Point] = []
    codes: set[int] = set()
    for run in runs:
        area = _area(run, {each.name for each in areas})
        areas.append(area)
        for one in run:
            access = one.area.access if one.area.access is not area.access else None
            points.append(replace(one.point, access=access))
        codes |= _functions(run, area)
    return areas, points, {f"{code:02X}": FunctionRule() for code in sorted(codes)}


def _goes_on(last: RowPoint, one: RowPoint) -> bool:
    same = last.area.table is one.area.table and last.area.notation == one.area.notation
    return same and one.point.address - last.end < MAX_HOLE


def _area(run: Sequence[RowPoint], taken: Collection[str]) -> Area:
    """Make one area from consecutive points. Its name is the table and the range as the list writes
    it.

    `taken` are the names of other areas. If one of them is the same, the first address is added to
    the name of this area.
    """
    rights = {one.area.access for one in run}
    access = rights.pop() if len(rights) == 1 else Access.READ_WRITE
    area = replace(run[0].area, last=run[-1].end - 1, access=access)
    words = area.table.value.replace("_", " ")
    name = words if area.last > area.first else words.removesuffix("s")
    name = f"{name} {area.span(area.first, area.last)}"
    return replace(area, name=f"{name}, from address {area.first}" if name in taken else name)


def _functions(run: Sequence[RowPoint], area: Area) -> set[int]:
    cells = [one.row.table for one in run]
    codes = {code for cell in cells if cell is not None for code in cell.functions}
    if area.access.allows(writing=False):
        codes.add(_READ_FUNCTIONS[area.table])
    if area.access.allows(writing=True) and not any(FUNCTIONS[code].writes for code in codes):
        codes.update(_WRITE_FUNCTIONS[area.table])
    return codes
