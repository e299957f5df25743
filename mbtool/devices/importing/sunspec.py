"""Makes a profile of SunSpec models in JSON, as github.com/sunspec/models has them."""

# The register map of a device begins with the two registers of the text "SunS", at 40000, 0 or
# 50000; the models follow one another. Each is a group of points; groups may hold groups, and a
# group may repeat as often as a point of the device tells, or as its length allows.
#
#     int16 .. float64, string, enum16, enum32, bitfield16   as they are
#     count, acc16, acc32, acc64, bitfield32, bitfield64,
#     ipaddr, eui48                                          unsigned numbers
#     sunssf                                                 int16
#     pad                                                    no point
#     ipv6addr                                               left out
#
# A scale factor that the device tells in a register cannot be said in a profile; one that the model
# states can.

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from typing import TYPE_CHECKING

import msgspec

from mbtool.core.errors import UsageError
from mbtool.devices.importing.assembling import ImportedDevice, PlacedPoint, assemble
from mbtool.devices.model import Access, Point
from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import ADDRESSES, Table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.devices.importing.register_list import ImportedList

BASE = 40000
MARK = "SunS"
MAX_DEPTH = 8
_TYPES = {
    "int16": PointType.INT16, "uint16": PointType.UINT16, "count": PointType.UINT16,
    "acc16": PointType.UINT16, "enum16": PointType.UINT16, "bitfield16": PointType.FLAGS,
    "sunssf": PointType.INT16, "raw16": PointType.HEX16,
    "int32": PointType.INT32, "uint32": PointType.UINT32, "acc32": PointType.UINT32,
    "enum32": PointType.UINT32, "bitfield32": PointType.UINT32, "ipaddr": PointType.UINT32,
    "float32": PointType.FLOAT32,
    "int64": PointType.INT64, "uint64": PointType.UINT64, "acc64": PointType.UINT64,
    "bitfield64": PointType.UINT64, "eui48": PointType.UINT64, "float64": PointType.FLOAT64,
    "string": PointType.STRING,
}  # fmt: skip
_PAD = "pad"
_WORD_BITS = range(16)


class SunSymbol(msgspec.Struct, frozen=True):
    """A value of an enumeration, or a bit, and its name."""

    name: str
    value: int
    label: str | None = None


class SunPoint(msgspec.Struct, frozen=True):
    """A point of a model."""

    name: str
    type: str
    size: int
    label: str | None = None
    desc: str | None = None
    units: str | None = None
    access: str = "R"
    sf: int | str | None = None
    symbols: list[SunSymbol] = []
    value: int | float | str | None = None
    count: int = 1


class SunGroup(msgspec.Struct, frozen=True):
    """A group of points, and of further groups behind them."""

    name: str
    count: int | str | None = None
    label: str | None = None
    points: list[SunPoint] = []
    groups: list[SunGroup] = []


class SunModel(msgspec.Struct, frozen=True):
    """A model: its number and its outermost group."""

    id: int
    group: SunGroup


def import_sunspec(
    files: Sequence[tuple[str, bytes]], name: str, *, base: int = BASE, repeat: int = 1
) -> ImportedList:
    """Make the profile of a device with these models, one behind the other from `base` on.

    `files` are names and contents. `repeat` is how often groups are there whose number the device
    tells. Raises UsageError if a file is no model, or if the models need too many addresses.
    """
    models = [_read(file, data) for file, data in files]
    layout = _ModelLayout(repeat)
    layout.add_mark(base)
    for (file, _), model in zip(files, models, strict=True):
        prefix = f"{model.group.name}." if len(models) > 1 else ""
        layout.add_group(file, model.group, prefix)
    titles = ", ".join(f"{one.id} {one.group.label or one.group.name}" for one in models)
    numbers = ", ".join(str(one.id) for one in models)
    device = ImportedDevice(
        name=name,
        title=f"SunSpec models {titles}"[:200],
        source=f"SunSpec model{'s' if len(models) > 1 else ''} {numbers}",
        points=layout.points,
        remarks=[f"the map begins at {base}; devices have it there, at 0 or at 50000 (--base)",
                 *layout.remarks()],
    )  # fmt: skip
    return assemble(device, files[0][0])


def _read(file: str, data: bytes) -> SunModel:
    try:
        model = msgspec.json.decode(data, type=SunModel)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{file}: is no SunSpec model in JSON: {error}") from error
    return model


@dataclass(slots=True)
class _ModelLayout:
    """Places points one behind the other."""

    repeat: int
    points: list[PlacedPoint] = field(default_factory=list)
    _at: int = 0
    _told: dict[str, list[str]] = field(default_factory=dict)

    def remarks(self) -> Iterator[str]:
        for what, names in self._told.items():
            few, more = ", ".join(names[:6]), len(names) - 6
            yield f"{what}: {few}{f' and {more} more' if more > 0 else ''}"

    def add_mark(self, base: int) -> None:
        mark = Point(
            name=MARK, table=Table.HOLDING_REGISTERS, address=base, type=PointType.STRING, length=2
        )
        self.points.append(PlacedPoint(mark, Access.READ))
        self._at = base + 2

    def add_group(self, file: str, group: SunGroup, prefix: str, depth: int = 0) -> None:
        """Place the points of a group, then those of the groups in it."""
        if depth > MAX_DEPTH:
            raise UsageError(f"{file}: groups in more than {MAX_DEPTH} groups")
        for point in group.points:
            self._add_point(file, point, prefix)
        for inner in group.groups:
            if inner.count is None:
                self.add_group(file, inner, f"{prefix}{inner.name}.", depth + 1)
                continue
            count = inner.count
            if isinstance(count, str) or count <= 0:
                count = self.repeat
                what = "the device tells how often a group is there, taken as"
                self._tell(f"{what} {count} (--repeat)", f"{prefix}{inner.name}")
            for number in range(1, count + 1):
                self.add_group(file, inner, f"{prefix}{inner.name}[{number}].", depth + 1)

    def _add_point(self, file: str, one: SunPoint, prefix: str) -> None:
        address, name = self._at, f"{prefix}{one.name}"
        self._at += one.size * max(one.count, 1)
        if not 0 < one.size <= ADDRESSES or self._at > ADDRESSES:
            raise UsageError(f"{file}: {one.name}: {one.size} registers do not fit at {address}")
        kind = _TYPES.get(one.type)
        if kind is PointType.FLAGS and not one.symbols:
            kind = PointType.HEX16
        if kind is None:
            if one.type != _PAD:
                self._tell(f"left out, as a profile has no type {one.type}", name)
            return
        words = kind.words or one.size
        if words != one.size:
            raise UsageError(
                f"{file}: {one.name}: {one.size} registers, but {one.type} has {words}"
            )
        point = self._point(one, name, address, kind)
        access = Access.READ_WRITE if one.access == "RW" else Access.READ
        self.points.append(PlacedPoint(point, access))

    def _point(self, one: SunPoint, name: str, address: int, kind: PointType) -> Point:
        symbols = {each.value: each.name for each in one.symbols}
        texts, bits = {}, {}
        if kind is PointType.FLAGS:
            bits = {bit: text for bit, text in symbols.items() if bit in _WORD_BITS}
        elif one.type.startswith("enum"):
            texts = symbols
        elif symbols:
            self._tell("without the names of their bits, as they have more than 16", name)
        scale = 1.0
        if isinstance(one.sf, int):
            scale = float(Decimal(10) ** max(min(one.sf, 10), -10))
        elif one.sf is not None:
            self._tell("not scaled, as the device tells the scale factor in a register", name)
        default = one.value if isinstance(one.value, int) and kind is PointType.UINT16 else None
        is_number = kind.is_number
        return Point(
            name=name,
            table=Table.HOLDING_REGISTERS,
            address=address,
            type=kind,
            length=one.size if kind is PointType.STRING else None,
            unit=_clean(one.units) if is_number else None,
            scale=scale if is_number else 1.0,
            texts={number: _clean(text) or "" for number, text in texts.items()},
            bits={bit: _clean(text) or "" for bit, text in sorted(bits.items())},
            default=default,
            note=_clean(one.label or one.desc),
        )

    def _tell(self, what: str, name: str) -> None:
        names = self._told.setdefault(what, [])
        if name not in names:
            names.append(name)


def _clean(text: str | None) -> str | None:
    """A text on one line; None if there is none."""
    return " ".join(text.replace("{", "(").replace("}", ")").split()) or None if text else None
