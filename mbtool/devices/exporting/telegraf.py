"""Writes a profile as a configuration of Telegraf's Modbus input."""

# The configuration uses the style `request` of plugins/inputs/modbus: a request for each table and
# byte order, with a field for each value. Telegraf only reads. It can scale a value, but cannot add
# an offset.

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
from mbtool.devices.model import Access, Point, Profile
from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import Table

_REGISTERS = {
    Table.COILS: "coil",
    Table.DISCRETE_INPUTS: "discrete",
    Table.HOLDING_REGISTERS: "holding",
    Table.INPUT_REGISTERS: "input",
}
_TYPES = {
    PointType.UINT16: "UINT16", PointType.INT16: "INT16", PointType.UINT32: "UINT32",
    PointType.INT32: "INT32", PointType.UINT64: "UINT64", PointType.INT64: "INT64",
    PointType.FLOAT32: "FLOAT32", PointType.FLOAT64: "FLOAT64", PointType.STRING: "STRING",
    PointType.HEX16: "UINT16", PointType.FLAGS: "UINT16", PointType.OCTETS: "UINT16",
    PointType.BIT_FIELD: "UINT16", PointType.NIBBLE_FIELD: "UINT16",
}  # fmt: skip


def export_telegraf(profile: Profile, unit: int = 1) -> ExportedMap:
    """Write as TOML for Telegraf all values of a profile that a master may read.

    `unit` is the unit of the slave to poll.
    """
    lacking = Lacking()
    requests: dict[tuple[Table, str], list[str]] = {}
    for one in single_points(profile):
        if _can_be_read(one, lacking):
            key = one.point.table, "ABCD" if one.point.table.is_bits else one.letters
            requests.setdefault(key, []).append(_field(one.point))
    lines = [
        f"# {profile.title}: {profile.source}".replace("\n", " "),
        "# Made by mbtool devices export; set the controller and the slave_id.",
        "[[inputs.modbus]]",
        f"  name = {_quoted(profile.name)}",
        '  controller = "tcp://127.0.0.1:502"',
        '  configuration_type = "request"',
    ]
    for (table, letters), fields in requests.items():
        lines += [
            "",
            "  [[inputs.modbus.request]]",
            f"    slave_id = {unit}",
            f'    byte_order = "{letters}"',
            f'    register = "{_REGISTERS[table]}"',
            "    fields = [",
            *(f"      {field}," for field in fields),
            "    ]",
        ]
    return ExportedMap("\n".join(lines) + "\n", lacking.lines)


def _can_be_read(one: SinglePoint, lacking: Lacking) -> bool:
    """True if Telegraf can read the value `one`. Notes in `lacking` what Telegraf cannot express of
    it.
    """
    point = one.point
    if one.access is Access.WRITE:
        lacking.note("left out, as they can only be written", point.name)
        return False
    if not point.table.is_bits and point.type not in _TYPES:
        lacking.note(f"left out, as there is no type {point.type}", point.name)
        return False
    if point.block is not None:
        lacking.note("left out, as they exist only in reads from one address", point.name)
        return False
    if point.scale_from is not None:
        lacking.note(NOT_SCALED, point.name)
    if point.no_value is not None:
        lacking.note("that a number means no value", point.name)
    if point.offset:
        lacking.note("without their offset", point.name)
    if point.texts or point.bits:
        lacking.note("without the texts of their values", point.name)
    if point.unit:
        lacking.note("without their unit", point.name)
    return True


def _field(point: Point) -> str:
    parts = [f"address={point.address}", f"name={_quoted(point.name)}"]
    if not point.table.is_bits:
        parts.append(f'type="{_TYPES[point.type]}"')
        if point.type is PointType.STRING:
            parts.append(f"length={point.words}")
        if point.scale != 1:
            scale = number_text(point.scale)
            parts.append(f"scale={scale if '.' in scale or 'e' in scale else scale + '.0'}")
    return f"{{ {', '.join(parts)} }}"


def _quoted(text: str) -> str:
    """Return a text as a quoted TOML string."""
    return json.dumps(text)
