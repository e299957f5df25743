"""Writes a profile as the `modbus:` part of a configuration of Home Assistant."""

# Registers become sensors, bits become binary sensors, coils that may be written become switches
# (Home Assistant, integration Modbus). Texts are written as JSON strings, which YAML accepts.

from __future__ import annotations

import json

from mbtool.devices.exporting.exported_points import (
    NOT_SCALED,
    ExportedMap,
    Lacking,
    SinglePoint,
    number_text,
    single_points,
)
from mbtool.devices.model import Access, Profile
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.tables import Table

_TYPES = {
    **{one: one.value for one in (
        PointType.UINT16, PointType.INT16, PointType.UINT32, PointType.INT32, PointType.UINT64,
        PointType.INT64, PointType.FLOAT32, PointType.FLOAT64, PointType.STRING,
    )},
    **dict.fromkeys((
        PointType.HEX16, PointType.FLAGS, PointType.OCTETS, PointType.BIT_FIELD,
        PointType.NIBBLE_FIELD,
    ), "uint16"),
}  # fmt: skip


def export_home_assistant(profile: Profile, unit: int = 1) -> ExportedMap:
    """Write the values of a profile as YAML for Home Assistant. `unit` is the unit of the slave to
    poll.
    """
    lacking = Lacking()
    platforms: dict[str, list[dict[str, str]]] = {
        "sensors": [], "binary_sensors": [], "switches": []
    }  # fmt: skip
    for one in single_points(profile):
        _add(one, unit, platforms, lacking)
    lines = [
        f"# {profile.title}: {profile.source}".replace("\n", " "),
        "# Made by mbtool devices export; set host, port and slave.",
        "modbus:",
        f"  - name: {json.dumps(profile.name)}",
        "    type: tcp",
        "    host: 127.0.0.1",
        "    port: 502",
    ]
    for platform, entries in platforms.items():
        if entries:
            lines.append(f"    {platform}:")
        for entry in entries:
            first, *others = (f"{key}: {value}" for key, value in entry.items())
            lines += [f"      - {first}", *(f"        {other}" for other in others)]
    return ExportedMap("\n".join(lines) + "\n", lacking.lines)


def _add(
    one: SinglePoint, unit: int, platforms: dict[str, list[dict[str, str]]], lacking: Lacking
) -> None:
    point = one.point
    entry = {"name": json.dumps(point.name), "slave": str(unit), "address": str(point.address)}
    if point.table is Table.COILS and one.access is not Access.READ:
        platforms["switches"].append({**entry, "write_type": "coil"})
        return
    if one.access is Access.WRITE:
        lacking.note("left out, as they can only be written", point.name)
        return
    if point.table.is_bits:
        kind = "coil" if point.table is Table.COILS else "discrete_input"
        platforms["binary_sensors"].append({**entry, "input_type": kind})
        return
    if point.type not in _TYPES:
        lacking.note(f"left out, as there is no type {point.type}", point.name)
        return
    if point.block is not None:
        lacking.note("left out, as they exist only in reads from one address", point.name)
        return
    if one.access is Access.READ_WRITE:
        lacking.note("only read, though they can be written", point.name)
    if point.texts or point.bits:
        lacking.note("without the texts of their values", point.name)
    kind = "input" if point.table is Table.INPUT_REGISTERS else "holding"
    entry |= {"input_type": kind, "data_type": _TYPES[point.type]}
    if point.type is PointType.STRING:
        entry["count"] = str(point.words)
    if point.scale != 1:
        entry["scale"] = number_text(point.scale)
    if point.offset:
        entry["offset"] = number_text(point.offset)
    if point.decimals is not None:
        entry["precision"] = str(point.decimals)
    if point.no_value is not None:
        entry["nan_value"] = str(point.no_value)
    if point.scale_from is not None:
        lacking.note(NOT_SCALED, point.name)
    elif point.unit:
        entry["unit_of_measurement"] = json.dumps(point.unit)
    if swap := _swap(one):
        entry["swap"] = swap
    platforms["sensors"].append(entry)


def _swap(one: SinglePoint) -> str | None:
    swaps_words = one.point.word_order is WordOrder.LOW_FIRST and one.point.words > 1
    swaps_bytes = one.point.byte_order is ByteOrder.LOW_FIRST
    if swaps_words and swaps_bytes:
        return "word_byte"
    return "word" if swaps_words else "byte" if swaps_bytes else None
