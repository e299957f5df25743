"""Places the points of SunSpec models at their addresses."""

# A model is a group of points. Groups may contain groups. A group may repeat; a point of the
# device, or the length of the model, tells how often. SunSpec's types become these types of points:
#
#     int16 .. float64, string, enum16, enum32, bitfield16   as they are
#     count, acc16, acc32, acc64, bitfield32, bitfield64,
#     ipaddr, eui48                                          unsigned numbers
#     sunssf                                                 int16, the scale_from of other points
#     pad                                                    no point
#     ipv6addr                                               left out
#
# For most types, the SunSpec Device Information Model Specification defines a number that means "no
# value". Those of unsigned 64-bit types are left out, because they are too large for TOML.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal

import msgspec
from msgspec.structs import replace

from mbtool.core.errors import UsageError
from mbtool.devices.importing.assembling import PlacedPoint
from mbtool.devices.model import Access, Point
from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import ADDRESSES, Table

MARK = "SunS"
MAX_DEPTH = 8
MAX_POINTS = 20_000
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
NO_VALUES = {
    "int16": -0x8000, "sunssf": -0x8000, "int32": -0x8000_0000, "int64": -0x8000_0000_0000_0000,
    "uint16": 0xFFFF, "enum16": 0xFFFF, "bitfield16": 0xFFFF,
    "uint32": 0xFFFF_FFFF, "enum32": 0xFFFF_FFFF, "bitfield32": 0xFFFF_FFFF,
}  # fmt: skip
"""For each SunSpec type, the number in the registers that means "no value"."""
_PAD = "pad"
_SCALE_FACTOR = "sunssf"
_WORD_BITS = range(16)


class SunSymbol(msgspec.Struct, frozen=True):
    """The name of one value of an enumeration, or of one bit, in a SunSpec model."""

    name: str
    value: int
    label: str | None = None


class SunPoint(msgspec.Struct, frozen=True):
    """A point of a SunSpec model, with the keys of its JSON file."""

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
    """A group of points in a SunSpec model, which may contain further groups after the points."""

    name: str
    count: int | str | None = None
    label: str | None = None
    points: list[SunPoint] = []
    groups: list[SunGroup] = []


class SunModel(msgspec.Struct, frozen=True):
    """A SunSpec model: its number and its outermost group of points."""

    id: int
    group: SunGroup


def words_of(file: str, model: SunModel, repeat: int) -> int:
    """Return the number of registers of a SunSpec model that has `repeat` copies of each group
    whose count only the device knows. `file` is the name of the model's file, for messages.
    """
    layout = ModelLayout(0)
    begin = layout.at
    layout.add_model(file, model, "", repeat)
    return layout.at - begin


@dataclass(slots=True)
class _Unscaled:
    """A point that needs a scale factor from another point, which may come later in the model."""

    index: int
    factor: str
    scopes: tuple[str, ...]
    """For each group that contains the point, the prefix of the names in this group, from the
    outermost group to the innermost."""


@dataclass(slots=True)
class ModelLayout:
    """Gives the points of SunSpec models their addresses, one model after the other.

    The map begins with the text "SunS" at the address `base`.
    """

    base: int
    at: int = 0
    """The address that the next point gets."""
    points: list[PlacedPoint] = field(default_factory=list)
    _told: dict[str, list[str]] = field(default_factory=dict)
    _unscaled: list[_Unscaled] = field(default_factory=list)
    _factors: set[str] = field(default_factory=set)
    """The names of the scale factors in the current model."""
    _end: int = ADDRESSES
    """The first address after the current model, if the device tells its length; else 65536."""

    def __post_init__(self) -> None:
        mark = Point(
            name=MARK,
            table=Table.HOLDING_REGISTERS,
            address=self.base,
            type=PointType.STRING,
            length=2,
        )
        self.points.append(PlacedPoint(mark, Access.READ))
        self.at = self.base + 2

    def begin(self, address: int) -> None:
        """Let the next model begin at `address`."""
        self.at = address

    def add_model(
        self, file: str, model: SunModel, prefix: str, repeat: int, words: int | None = None
    ) -> None:
        """Give the points of a model their addresses, from the current address on.

        `file` is the name of the model's file, for messages. `prefix` begins the name of each
        point. `repeat` is the number of copies of each group whose count only the device knows.
        `words` is the number of registers that the model has in the device; points beyond it are
        left out. It is None if the device was not read.
        """
        self._end = ADDRESSES if words is None else min(self.at + words, ADDRESSES)
        self._add_group(_Place(file, repeat, words is not None), model.group, (prefix,))
        self._scale(self._unscaled)
        self._unscaled = []
        self._factors = set()

    def remarks(self) -> Iterator[str]:
        for what, names in self._told.items():
            few, more = ", ".join(names[:6]), len(names) - 6
            yield f"{what}: {few}{f' and {more} more' if more > 0 else ''}"

    def _add_group(self, place: _Place, group: SunGroup, scopes: tuple[str, ...]) -> None:
        """Give the points of a group their addresses, then the points of the groups in it.

        `scopes` has the prefix of names in each group from the outermost one to this one.
        """
        if len(scopes) > MAX_DEPTH + 1:
            raise UsageError(f"{place.file}: groups in more than {MAX_DEPTH} groups")
        for point in group.points:
            self._add_point(place.file, point, scopes)
        prefix = scopes[-1]
        for inner in group.groups:
            if inner.count is None:
                self._add_group(place, inner, (*scopes, f"{prefix}{inner.name}."))
                continue
            count = inner.count
            if isinstance(count, str) or count <= 0:
                count = place.repeat
                self._note_remark(place.repeat_told, f"{prefix}{inner.name}")
            for number in range(1, count + 1):
                self._add_group(place, inner, (*scopes, f"{prefix}{inner.name}[{number}]."))

    def _add_point(self, file: str, one: SunPoint, scopes: tuple[str, ...]) -> None:
        address, name = self.at, f"{scopes[-1]}{one.name}"
        self.at += one.size * max(one.count, 1)
        if not 0 < one.size <= ADDRESSES or self.at > ADDRESSES or len(self.points) > MAX_POINTS:
            raise UsageError(f"{file}: {one.name}: {one.size} registers do not fit at {address}")
        kind = _TYPES.get(one.type)
        if kind is PointType.FLAGS and not one.symbols:
            kind = PointType.HEX16
        if kind is None:
            if one.type != _PAD:
                self._note_remark(f"left out, as a profile has no type {one.type}", name)
            return
        words = kind.words or one.size
        if words != one.size:
            raise UsageError(
                f"{file}: {one.name}: {one.size} registers, but {one.type} has {words}"
            )
        if self.at > self._end:
            self._note_remark("left out, as the device's model is shorter", name)
            return
        if one.type == _SCALE_FACTOR:
            self._factors.add(name)
        if isinstance(one.sf, str) and kind.is_number:
            self._unscaled.append(_Unscaled(len(self.points), one.sf, scopes))
        access = Access.READ_WRITE if one.access == "RW" else Access.READ
        self.points.append(PlacedPoint(self._point(one, name, address, kind), access))

    def _point(self, one: SunPoint, name: str, address: int, kind: PointType) -> Point:
        symbols = {each.value: each.name for each in one.symbols}
        texts, bits = {}, {}
        if kind is PointType.FLAGS:
            bits = {bit: text for bit, text in symbols.items() if bit in _WORD_BITS}
        elif one.type.startswith("enum"):
            texts = symbols
        elif symbols:
            self._note_remark("without the names of their bits, as they have more than 16", name)
        scale = 1.0
        if isinstance(one.sf, int):
            scale = float(Decimal(10) ** max(min(one.sf, 10), -10))
        default = one.value if isinstance(one.value, int) and kind is PointType.UINT16 else None
        is_number = kind.is_number
        return Point(
            name=name,
            table=Table.HOLDING_REGISTERS,
            address=address,
            type=kind,
            length=one.size if kind is PointType.STRING else None,
            unit=_one_line_without_braces(one.units) if is_number else None,
            scale=scale if is_number else 1.0,
            no_value=NO_VALUES.get(one.type),
            texts={number: _one_line_without_braces(text) or "" for number, text in texts.items()},
            bits={bit: _one_line_without_braces(text) or "" for bit, text in sorted(bits.items())},
            default=default,
            note=_one_line_without_braces(one.label or one.desc),
        )

    def _scale(self, points: Sequence[_Unscaled]) -> None:
        """Set `scale_from` of points whose scale factor is in another point.

        That point is in the same group, or in a group that contains it.
        """
        for one in points:
            names = (f"{scope}{one.factor}" for scope in reversed(one.scopes))
            factor = next((name for name in names if name in self._factors), None)
            placed = self.points[one.index]
            if factor is None:
                self._note_remark("not scaled, as the scale factor is not there", placed.point.name)
                continue
            point = replace(placed.point, scale_from=factor)
            self.points[one.index] = PlacedPoint(point, placed.access)

    def _note_remark(self, what: str, name: str) -> None:
        names = self._told.setdefault(what, [])
        if name not in names:
            names.append(name)


@dataclass(frozen=True, slots=True)
class _Place:
    """Facts about the model that hold for all its groups."""

    file: str
    repeat: int
    has_length: bool

    @property
    def repeat_told(self) -> str:
        if self.has_length:
            return f"groups that are there {self.repeat} times, as the length of their model says"
        return f"the device tells how often a group is there, taken as {self.repeat} (--repeat)"


def _one_line_without_braces(text: str | None) -> str | None:
    """A text on one line, with parentheses in place of braces; None if it is empty.

    A brace in a point's name would begin a placeholder such as {n}.
    """
    return " ".join(text.replace("{", "(").replace("}", ")").split()) or None if text else None
