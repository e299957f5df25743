"""Makes a profile from the `modbus:` part of a configuration of Home Assistant."""

# These entries become points (Home Assistant, integration Modbus):
#
#     sensors                  registers with type, scale, offset, precision, unit, swap, count
#     binary_sensors           a coil or a discrete input; a whole register if the entry reads one
#     switches, lights, fans   the coil or holding register that they write
#     climates                 the measured temperature, and the register of the wanted temperature
#
# Everything else is left out, and the user is told so: covers, sensors of a type `custom`, and
# types of 8 bits. The file is YAML; tags such as !secret are read as text.
#
# Limits: MAX_VALUES values.

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from types import new_class
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from mbtool.core.errors import UsageError
from mbtool.core.extras import missing_extra
from mbtool.devices.importing.assembling import ImportedDevice, PlacedPoint, assemble
from mbtool.devices.model import Access, Point
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.functions import READ_LIMIT
from mbtool.modbus.tables import ADDRESSES, Table

if TYPE_CHECKING:
    from mbtool.devices.importing.register_list import ImportedList

MAX_VALUES = 20_000
_TYPES = {
    **{one.value: one for one in (
        PointType.UINT16, PointType.INT16, PointType.UINT32, PointType.INT32, PointType.UINT64,
        PointType.INT64, PointType.FLOAT32, PointType.FLOAT64, PointType.STRING,
    )},
    "int": PointType.INT16, "uint": PointType.UINT16, "float": PointType.FLOAT32,
}  # fmt: skip
_TABLES = {
    "coil": Table.COILS, "coils": Table.COILS, "discrete_input": Table.DISCRETE_INPUTS,
    "input": Table.INPUT_REGISTERS, "holding": Table.HOLDING_REGISTERS,
    "holdings": Table.HOLDING_REGISTERS,
}  # fmt: skip
_SWAPS = {
    "none": (WordOrder.HIGH_FIRST, ByteOrder.HIGH_FIRST),
    "byte": (WordOrder.HIGH_FIRST, ByteOrder.LOW_FIRST),
    "word": (WordOrder.LOW_FIRST, ByteOrder.HIGH_FIRST),
    "word_byte": (WordOrder.LOW_FIRST, ByteOrder.LOW_FIRST),
}
_SWITCHED = ("switches", "lights", "fans")
_PLATFORMS = ("sensors", "binary_sensors", *_SWITCHED, "climates")
_LARGEST_IN_TOML = (1 << 63) - 1
_UNIT_KEYS = ("slave", "device_address")


def import_home_assistant(
    data: bytes, file: str, name: str, *, unit: int | None = None
) -> ImportedList:
    """Make the profile of one device from a configuration of Home Assistant.

    `data` is the content of the file, `file` its name, and `name` the name of the profile. `unit`
    chooses one of the devices in the file; None if there is only one. Raises UsageError if the file
    is no such configuration, or has several devices and `unit` is None.
    """
    entries = _entries(_hubs(_parsed(data, file), file), file)
    units = sorted({one.unit for one in entries})
    if unit is None and len(units) > 1:
        raise UsageError(
            f"{file}: has the units {', '.join(map(str, units))}; choose one with --unit"
        )
    reader = _EntityReader()
    for entry in entries:
        if unit in (None, entry.unit):
            reader.read(entry)
    chosen = unit if unit is not None or not units else units[0]
    device = ImportedDevice(
        name=name,
        title=f"{name}, unit {chosen}",
        source=f"a configuration of Home Assistant, unit {chosen}",
        points=reader.points,
        remarks=list(reader.remarks),
    )
    return assemble(device, file)


@dataclass(frozen=True, slots=True)
class _HubEntry:
    """An entry of a hub: a sensor, a switch and so on. A hub is Home Assistant's word for a
    connection.
    """

    platform: str
    unit: int
    values: dict[str, Any]


def _parsed(data: bytes, file: str) -> Any:
    try:
        import yaml
    except ImportError:
        raise missing_extra("--home-assistant", "yaml") from None

    loader: Any = new_class("LoaderWithTags", (yaml.SafeLoader,))
    loader.add_multi_constructor("!", lambda _loader, tag, node: f"!{tag} {node.value}")
    try:
        return yaml.load(data, loader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        said = " ".join(str(error).split())
        raise UsageError(f"{file}: is no YAML: {said[:200]}") from error


def _hubs(parsed: Any, file: str) -> list[dict[str, Any]]:
    """Return the hubs (connections) of a configuration.

    `parsed` is the whole configuration, or only its part below `modbus:`. Raises UsageError if it
    has no hubs.
    """
    hubs = parsed.get("modbus", parsed) if isinstance(parsed, dict) else parsed
    if isinstance(hubs, dict):
        hubs = [hubs]
    if not isinstance(hubs, list) or not all(isinstance(one, dict) for one in hubs):
        raise UsageError(f"{file}: has no list of hubs under modbus:")
    return hubs


def _entries(hubs: list[dict[str, Any]], file: str) -> list[_HubEntry]:
    entries = []
    for hub in hubs:
        for platform, listed in hub.items():
            if platform not in _PLATFORMS and platform != "covers":
                continue
            for values in listed if isinstance(listed, list) else ():
                if not isinstance(values, dict):
                    raise UsageError(f"{file}: {platform}: an entry is no table of keys")
                entries.append(_HubEntry(platform, _unit_of(values), values))
                if len(entries) > MAX_VALUES:
                    raise UsageError(f"{file}: has more than {MAX_VALUES} values")
    if not entries:
        raise UsageError(f"{file}: has no sensors, binary_sensors or switches under modbus:")
    return entries


def _unit_of(values: dict[str, Any]) -> int:
    unit = next((values[key] for key in _UNIT_KEYS if key in values), 1)
    return unit if isinstance(unit, int) else 1


@dataclass(slots=True)
class _EntityReader:
    """Makes points from the entries of a configuration."""

    points: list[PlacedPoint] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def read(self, entry: _HubEntry) -> None:
        """Make the points of an entry. If it can have none, add the reason to `remarks`."""
        name = _text(entry.values.get("name")) or "unnamed"
        try:
            if entry.platform in _SWITCHED:
                self._read_switch(name, entry.values)
            elif entry.platform == "binary_sensors":
                self._read_bit(name, entry.values)
            elif entry.platform in ("sensors", "climates"):
                self._read_register(name, entry)
            else:
                raise ValueError(f"is one of the {entry.platform}")
        except (ValueError, TypeError, OverflowError) as why:
            self.remarks.append(f"{name}: left out, as it {why}")

    def _read_switch(self, name: str, values: dict[str, Any]) -> None:
        table = _table(values.get("write_type", "holding"))
        kind = PointType.BIT if table.is_bits else PointType.UINT16
        point = Point(name=name, table=table, address=_address(values, "address"), type=kind)
        self.points.append(PlacedPoint(point, Access.READ_WRITE))

    def _read_bit(self, name: str, values: dict[str, Any]) -> None:
        table = _table(values.get("input_type", "coil"))
        kind = PointType.BIT if table.is_bits else PointType.UINT16
        count = 1 + _checked_whole(values.get("virtual_count", values.get("slave_count", 0)))
        point = Point(name=name, table=table, address=_address(values, "address"), type=kind)
        self._add_series(point, count)

    def _read_register(self, name: str, entry: _HubEntry) -> None:
        values = entry.values
        word = str(values.get("data_type", "int16"))
        kind = _TYPES.get(word)
        if kind is None:
            raise ValueError(f"has the type {word}")
        point = Point(
            name=name,
            table=_table(values.get("input_type", "holding")),
            address=_address(values, "address"),
            type=kind,
            length=_length(values) if kind is PointType.STRING else None,
        )
        if point.table.is_bits:
            raise ValueError("reads registers from a table of bits")
        point = _with_entry_keys(point, values)
        if entry.platform == "sensors":
            count = 1 + _checked_whole(values.get("virtual_count", values.get("slave_count", 0)))
            self._add_series(point, count)
            return
        self.points.append(PlacedPoint(point, Access.READ))
        if isinstance(values.get("target_temp_register"), int):
            target = _address(values, "target_temp_register")
            fields = {"name": f"{name} target", "address": target}
            self.points.append(PlacedPoint(_replaced(point, fields), Access.READ_WRITE))

    def _add_series(self, point: Point, count: int) -> None:
        """Add `count` points with consecutive addresses; `point` is the first of them.

        Raises ValueError if the addresses go beyond 65535, or if there are too many points.
        """
        if point.address + count * point.words > ADDRESSES:
            raise ValueError("leaves the addresses that there are")
        if len(self.points) + count > MAX_VALUES:
            raise ValueError(f"would be more than {MAX_VALUES} values")
        for number in range(count):
            name = point.name if count == 1 else f"{point.name} {number + 1}"
            fields = {"name": name, "address": point.address + number * point.words}
            self.points.append(PlacedPoint(_replaced(point, fields), Access.READ))


def _with_entry_keys(point: Point, values: dict[str, Any]) -> Point:
    """Return the point with the scale, unit, word order and byte order in the keys of its entry,
    `values`.

    Raises ValueError if one of them is impossible.
    """
    swap = str(values.get("swap", "none"))
    if swap not in _SWAPS:
        raise ValueError(f"has the swap {swap}")
    words, byte = _SWAPS[swap]
    fields: dict[str, Any] = {"byte_order": byte}
    if point.words > 1 and point.type is not PointType.STRING:
        fields["word_order"] = words
    if point.type.is_number:
        scale, precision = float(values.get("scale", 1)), values.get("precision")
        if not scale:
            raise ValueError("has the scale 0")
        fields |= {"scale": scale, "offset": float(values.get("offset", 0))}
        fields["unit"] = _text(values.get("unit_of_measurement"))
        fields["decimals"] = None if precision is None else _checked_whole(precision, 15)
    if "nan_value" in values and point.type.whole_numbers is not None:
        fields["no_value"] = _no_value(values["nan_value"], point.type.whole_numbers)
    return _replaced(point, fields)


def _replaced(point: Point, fields: dict[str, Any]) -> Point:
    return replace(point, **fields)


def _table(word: object) -> Table:
    if not isinstance(word, str) or word not in _TABLES:
        raise ValueError(f"is in a table {word}")
    return _TABLES[word]


def _address(values: dict[str, Any], key: str) -> int:
    address = values.get(key)
    if isinstance(address, bool) or not isinstance(address, int) or not 0 <= address < ADDRESSES:
        raise ValueError(f"has no {key} from 0 to {ADDRESSES - 1}")
    return address


def _checked_whole(number: object, greatest: int = MAX_VALUES) -> int:
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number <= greatest:
        raise ValueError(f"has {number!r} where a number up to {greatest} is right")
    return number


def _no_value(told: object, allowed: range) -> int:
    """Return the number in the register that means "no value", from `told`, the value of the key
    `nan_value`.

    `told` may be a number, or hexadecimal digits as text. Raises ValueError if the number is not in
    `allowed`, also when read as two's complement.
    """
    number = told
    with suppress(ValueError):
        number = int(told, 16) if isinstance(told, str) else told
    if isinstance(number, bool) or not isinstance(number, int):
        raise ValueError(f"has {told!r} where a number is right")
    if number not in allowed:
        number += 2 * min(allowed.start, 0)  # Two's complement.
    if number not in allowed or number > _LARGEST_IN_TOML:
        raise ValueError(f"has a nan_value {told!r}, which its type cannot have")
    return number


def _length(values: dict[str, Any]) -> int:
    length = _checked_whole(values.get("count", 0), READ_LIMIT)
    if not length:
        raise ValueError("is a text without a count of registers")
    return length


def _text(value: object) -> str | None:
    """Return a value as a text on one line, at most 200 characters; None if it is empty.

    Parentheses replace braces, because a brace in a point's name begins a placeholder such as {n}.
    """
    if value is None:
        return None
    text = "".join(one if one.isprintable() else " " for one in str(value))
    return " ".join(text.replace("{", "(").replace("}", ")").split())[:200] or None
