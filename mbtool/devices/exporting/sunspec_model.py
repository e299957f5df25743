"""Writes a profile as a SunSpec model in JSON."""

# A SunSpec model describes consecutive holding registers. The first one has the model's number
# (ID), the second one its length (L). So only a profile with these two points can be exported. The
# model has no groups of points, as a profile has none. In SunSpec, a scale is a power of ten: the
# exponent is in the model, or in another register of the device (a scale factor).

from __future__ import annotations

import math
import re
from collections.abc import Collection
from typing import Any

import msgspec

from mbtool.core.errors import UsageError
from mbtool.devices.exporting.exported_points import (
    ExportedMap,
    Lacking,
    SinglePoint,
    single_points,
)
from mbtool.devices.importing.sunspec_layout import NO_VALUES
from mbtool.devices.model import Access, Point, Profile
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.tables import Table

_TYPES = {
    PointType.UINT16: "uint16", PointType.INT16: "int16", PointType.UINT32: "uint32",
    PointType.INT32: "int32", PointType.UINT64: "uint64", PointType.INT64: "int64",
    PointType.FLOAT32: "float32", PointType.FLOAT64: "float64", PointType.STRING: "string",
    PointType.FLAGS: "bitfield16", PointType.HEX16: "bitfield16", PointType.OCTETS: "uint16",
    PointType.BIT_FIELD: "bitfield16", PointType.NIBBLE_FIELD: "uint16",
}  # fmt: skip


def export_sunspec(profile: Profile) -> ExportedMap:
    """Write the holding registers of a profile as a SunSpec model in JSON.

    Raises UsageError if the profile has no point `ID` with a default, followed by a point `L`.
    """
    lacking = Lacking()
    registers = [one for one in single_points(profile) if one.point.table.is_bits is False]
    held = [one for one in registers if one.point.table is Table.HOLDING_REGISTERS]
    begin = next((at for at, one in enumerate(held) if one.point.name == "ID"), None)
    if begin is None or held[begin].point.default is None or not _has_length(held[begin:]):
        raise UsageError(
            f"{profile.name}: is no SunSpec model: it has no points ID, with a default, and L"
        )
    for one in single_points(profile):
        if one not in held[begin:]:
            lacking.note("left out, as they are not in the model", one.point.name)
    factors = {one.point.scale_from for one in held}
    points: list[dict[str, Any]] = []
    at = held[begin].point.address
    for one in held[begin:]:
        if one.point.type not in _TYPES or one.point.address < at:
            lacking.note("left out, as there is no such type", one.point.name)
            continue
        if one.point.address > at:
            size = one.point.address - at
            points.append({"name": f"Pad{at}", "type": "pad", "size": size})
        points.append(_point(one, factors, lacking))
        at = one.point.address + one.point.words
    group = {
        "name": _identifier(profile.name), "type": "group", "label": profile.title,
        "points": points,
    }  # fmt: skip
    model = {"id": held[begin].point.default, "group": group}
    text = msgspec.json.format(msgspec.json.encode(model), indent=4).decode()
    return ExportedMap(text + "\n", lacking.lines)


def _has_length(held: list[SinglePoint]) -> bool:
    names = [(one.point.name, one.point.address) for one in held[:2]]
    return len(names) == 2 and names[1] == ("L", names[0][1] + 1)


def _point(one: SinglePoint, factors: Collection[str | None], lacking: Lacking) -> dict[str, Any]:
    point = one.point
    kind = "sunssf" if point.name in factors else _type(point)
    told: dict[str, Any] = {"name": _identifier(point.name), "type": kind, "size": point.words}
    if point.note:
        told["label"] = point.note
    if point.unit:
        told["units"] = point.unit
    if one.access is not Access.READ:
        told["access"] = "RW"
    if point.default is not None and point.type is PointType.UINT16:
        told["value"] = point.default
    if point.no_value != NO_VALUES.get(kind):
        lacking.note("with the number that SunSpec has for no value, not their own", point.name)
    power = _power(point.scale)
    if power == 0 and not point.offset and point.scale_from is not None:
        told["sf"] = _identifier(point.scale_from)
    elif power is None or point.offset or point.scale_from is not None:
        lacking.note("without a scale that is no power of ten, and without offset", point.name)
    elif power:
        told["sf"] = power
    if point.word_order is not WordOrder.HIGH_FIRST or point.byte_order is not ByteOrder.HIGH_FIRST:
        lacking.note("in the order of SunSpec, not in their own", point.name)
    texts = point.bits if point.type is PointType.FLAGS else point.texts
    if texts:
        told["symbols"] = [{"name": text, "value": number} for number, text in texts.items()]
    return told


def _type(point: Point) -> str:
    if point.type is PointType.UINT16 and point.texts:
        return "enum16"
    if point.type is PointType.UINT32 and point.texts:
        return "enum32"
    return _TYPES[point.type]


def _power(scale: float) -> int | None:
    """Return the exponent of a scale that is a power of ten (-1 for 0.1); None for another
    scale.
    """
    if scale <= 0:
        return None
    power = round(math.log10(scale))
    return power if math.isclose(10.0**power, scale, rel_tol=1e-12) else None


def _identifier(name: str) -> str:
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "_"
