"""Makes a profile from points whose addresses are known; derives its areas and functions."""

# If fewer than MAX_HOLE addresses lie between two points, one area includes both points and these
# addresses, as in the import of register lists (areas.py).

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from msgspec.structs import replace

from mbtool.core.errors import UsageError
from mbtool.devices.dumping import dump_profile
from mbtool.devices.importing.areas import MAX_HOLE
from mbtool.devices.importing.register_list import ImportedList
from mbtool.devices.loading import MAX_FILE_BYTES
from mbtool.devices.model import Access, Area, FunctionRule, Point, Profile
from mbtool.devices.validation import validate
from mbtool.modbus.adu import Transport
from mbtool.modbus.tables import Table

_FUNCTIONS = {
    Table.COILS: ("01", "05", "0F"),
    Table.DISCRETE_INPUTS: ("02",),
    Table.HOLDING_REGISTERS: ("03", "06", "10"),
    Table.INPUT_REGISTERS: ("04",),
}
_TABLES = list(Table)


@dataclass(frozen=True, slots=True)
class PlacedPoint:
    """A point, and the access that a master has to it (read, write or both)."""

    point: Point
    access: Access


@dataclass(frozen=True, slots=True)
class ImportedDevice:
    """The facts about a device that were read from another program's file, as material for a
    profile.
    """

    name: str
    title: str
    source: str
    points: Sequence[PlacedPoint]
    remarks: Sequence[str]
    vendor: str = "unknown"
    span: range | None = None
    """The addresses of all holding registers of the device. If None, only the registers of its
    points are known."""
    finding_prefix: str | None = None


def assemble(device: ImportedDevice, file: str) -> ImportedList:
    """Make the profile of a device, and the profile's TOML text with the remarks in a comment at
    the top.

    If points overlap, only the one with the lowest address is used. Raises UsageError if the device
    has no point. `file` is the name of the file that was read, for messages.
    """
    remarks = list(device.remarks)
    points = _without_overlaps(device.points, remarks)
    if not points:
        raise UsageError(f"{file}: has no value that a profile can have")
    areas, owned = _areas(points, device.span)
    functions = {
        code: FunctionRule()
        for area in areas
        for code in _FUNCTIONS[area.table][: None if area.access is not Access.READ else 1]
    }
    profile = Profile(
        name=device.name,
        title=device.title,
        vendor=device.vendor,
        transports=[Transport.RTU, Transport.TCP],
        source=device.source,
        areas=areas,
        functions=dict(sorted(functions.items())),
        points=owned,
        finding_prefix=device.finding_prefix,
    )
    validate(profile, file)
    notes = [f"Made by mbtool from {device.source}."]
    text = dump_profile(profile, {"": [*notes, *(f"- {one}" for one in remarks)]})
    if len(text.encode()) > MAX_FILE_BYTES:
        raise UsageError(f"{file}: its profile would have more than {MAX_FILE_BYTES} bytes")
    return ImportedList(profile, text, tuple(remarks))


def _without_overlaps(points: Sequence[PlacedPoint], remarks: list[str]) -> list[PlacedPoint]:
    """Sort the points by table and address, leave out overlapping ones, and make names unique.

    Adds a sentence to `remarks` for each point that is left out.
    """
    kept: list[PlacedPoint] = []
    names: set[str] = set()
    ends: dict[Table, int] = {}
    for one in sorted(
        points, key=lambda each: (_TABLES.index(each.point.table), each.point.address)
    ):
        point = one.point
        if point.address < ends.get(point.table, 0):
            remarks.append(f"{point.name}: left out, as it overlaps another one")
            continue
        name = point.name
        if name in names:
            name = f"{name} ({point.address})"
        while name in names:
            name = f"{name}'"
        names.add(name)
        ends[point.table] = point.address + point.words
        kept.append(PlacedPoint(replace(point, name=name), one.access))
    return kept


def _areas(points: Sequence[PlacedPoint], span: range | None) -> tuple[list[Area], list[Point]]:
    areas: list[Area] = []
    owned: list[Point] = []
    runs: list[list[PlacedPoint]] = []
    for one in points:
        last = runs[-1][-1].point if runs else None
        if last is not None and (span is not None or _goes_on(last, one.point)):
            runs[-1].append(one)
        else:
            runs.append([one])
    for run in runs:
        rights = {one.access for one in run}
        access = rights.pop() if len(rights) == 1 else Access.READ_WRITE
        first, last = run[0].point, run[-1].point
        begin, end = first.address, last.address + last.words - 1
        if span is not None:
            begin, end = min(begin, span.start), max(end, span.stop - 1)
        name = f"{first.table.value.replace('_', ' ')} {begin}..{end}"
        areas.append(Area(name=name, table=first.table, first=begin, last=end, access=access))
        owned += [
            replace(one.point, access=None if one.access is access else one.access) for one in run
        ]
    return areas, owned


def _goes_on(last: Point, point: Point) -> bool:
    hole = point.address - (last.address + last.words)
    return last.table is point.table and hole < MAX_HOLE
