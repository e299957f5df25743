"""Writes a profile as a register list: CSV that `mbtool devices import` and spreadsheets read."""

from __future__ import annotations

import csv
import io

from mbtool.devices.exporting.exported_points import (
    NOT_SCALED,
    ExportedMap,
    Lacking,
    SinglePoint,
    number_text,
    single_points,
)
from mbtool.devices.model import Access, Point, Profile
from mbtool.devices.point_types import PointType

HEADINGS = (
    "wire address", "name", "table", "type", "order", "length", "access", "unit", "scale", "offset",
    "decimals", "minimum", "maximum", "values", "note", "in the manual",
)  # fmt: skip
_TYPES = {
    PointType.BIT: "bool",
    PointType.HEX16: "hex16",
    PointType.FLAGS: "bitfield16",
    PointType.OCTETS: "hex16",
    PointType.BIT_FIELD: "hex16",
    PointType.NIBBLE_FIELD: "hex16",
}
"""The word for a type of point in a register list. A type that is not here keeps its name."""
_ACCESS = {Access.READ: "R", Access.WRITE: "W", Access.READ_WRITE: "RW"}
_ABOUT_FIELDS = "a field of channels or octets is a hexadecimal number"


def export_register_list(profile: Profile) -> ExportedMap:
    """Write the values of a profile as CSV, one row each, with addresses as on the wire."""
    lacking = Lacking()
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEADINGS)
    for one in single_points(profile):
        _note(one.point, lacking)
        writer.writerow(_row(one))
    return ExportedMap(out.getvalue(), lacking.lines)


def _note(point: Point, lacking: Lacking) -> None:
    if point.type in (PointType.OCTETS, PointType.BIT_FIELD, PointType.NIBBLE_FIELD):
        lacking.note(_ABOUT_FIELDS, point.name)
    if point.block is not None:
        lacking.note("that a point exists only in reads from one address", point.name)
    if point.scale_from is not None:
        lacking.note(NOT_SCALED, point.name)
    if point.no_value is not None:
        lacking.note("that a number means no value", point.name)
    is_scaled = point.scale != 1 or point.offset != 0
    if is_scaled and (point.minimum is not None or point.maximum is not None):
        lacking.note("whether a range is before or after scaling", point.name)


def _row(one: SinglePoint) -> list[str]:
    point = one.point
    texts = point.bits if point.type is PointType.FLAGS else point.texts
    return [
        str(point.address),
        point.name,
        point.table.value.replace("_", " "),
        _TYPES.get(point.type, point.type.value),
        "" if point.table.is_bits else one.letters,
        "" if point.table.is_bits else str(point.words),
        _ACCESS[one.access],
        point.unit or "" if point.scale_from is None else "",
        number_text(point.scale) if point.scale != 1 else "",
        number_text(point.offset) if point.offset else "",
        "" if point.decimals is None else str(point.decimals),
        "" if point.minimum is None else number_text(point.minimum),
        "" if point.maximum is None else number_text(point.maximum),
        "; ".join(f"{number} = {text}" for number, text in texts.items()),
        point.note or "",
        one.reference,
    ]
