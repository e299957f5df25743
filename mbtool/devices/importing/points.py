"""Makes points of a profile from the rows of a register list, whose addresses are known."""

# If a row has more registers than one value of its type takes, it is a series of values. Two rows
# with the same address are reported as a problem.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import msgspec

from mbtool.devices.importing.rows import ListRow
from mbtool.devices.importing.spellings import HIGH_LOW, TypeSpelling
from mbtool.devices.model import Area, Point
from mbtool.devices.point_types import PointType, WordOrder
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.devices.importing.locating import LocatedRow
    from mbtool.devices.importing.options import ImportReport

_TABLES = list(Table)
_WORD_ORDERS = {WordOrder.HIGH_FIRST: "high word first", WordOrder.LOW_FIRST: "low word first"}


@dataclass(frozen=True, slots=True)
class RowPoint:
    """A point, and the row of the register list from which it was made."""

    point: Point
    row: ListRow
    area: Area
    """An area that contains only the first address of the point. Its prefix, base and other keys
    say how the list writes the address."""

    @property
    def reference(self) -> str:
        return self.area.reference(self.point.address)

    @property
    def end(self) -> int:
        """The first address after the point (after all values if it is a series)."""
        return self.point.address + self.point.words * self.point.count


def make_points(
    rows: Sequence[LocatedRow], word_order: WordOrder | None, report: ImportReport
) -> list[RowPoint]:
    """Make the points of the rows, sorted by table and address.

    `word_order` is the one that the user names for values for which the list names none; None
    stands for the high word first. A row that cannot be a point is left out, and becomes a problem
    in the report.
    """
    made: list[RowPoint] = []
    is_named = False
    for row, area in rows:
        try:
            point = _point(row, area, word_order, report)
        except ValueError as problem:
            report.add_problem(row.row, None, row.address.text, str(problem))
            continue
        made.append(RowPoint(point, row, area))
        if row.order is not None and point.words > 1 and point.type is not PointType.STRING:
            report.tell("word order as named there", row.row)
            is_named = True
    order = _WORD_ORDERS[word_order or WordOrder.HIGH_FIRST]
    why = "--word-order says" if word_order else "nothing says otherwise (--word-order)"
    others = " of the others" if is_named else ""
    report.tell(f"word order{others}: {order}, as {why}")
    made = _without_overlaps(made, report)
    made.sort(key=lambda one: (_TABLES.index(one.point.table), one.point.address))
    return _with_unique_names(made)


def _point(row: ListRow, area: Area, word_order: WordOrder | None, report: ImportReport) -> Point:
    """Make the point of a row.

    `area` has the row's table and address; `word_order` is the user's, or None. Raises ValueError
    if the row's type, number of registers, factor and table do not fit together.
    """
    type_ = _type(row, area.table, report)
    kind = type_.type
    words = kind.words or _string_words(row, type_, report)
    size = _size(row, area, words)
    if not kind.is_number and row.scale != 1:
        raise ValueError(f"has a factor, but {kind} is no number")
    if size > words:
        report.tell("more registers than the type takes, so a series of values", row.row)
    texts, other_texts = _texts(row, type_)
    limits, other_limits = _limits(row, kind, words)
    if other_limits:
        report.tell("range or default kept as a note: it may be before or after scaling", row.row)
    point = Point(
        name=row.name,
        table=area.table,
        address=area.first,
        type=kind,
        count=size // words,
        stride=words if size > words else 1,
        length=words if kind is PointType.STRING else None,
        unit=row.unit,
        texts=texts,
        bits=dict(sorted(row.bits.items())) if kind is PointType.FLAGS else {},
        note="; ".join(part for part in (row.note, *other_texts, *other_limits) if part) or None,
    )
    fields: dict[str, object] = dict(limits)
    if kind.is_number:
        fields |= {"scale": row.scale, "offset": row.offset, "decimals": row.decimals}
    order = row.order or (word_order or HIGH_LOW[0], HIGH_LOW[1])
    if not area.table.is_bits:
        fields["byte_order"] = order[1]
    if words > 1 and kind is not PointType.STRING:
        fields["word_order"] = order[0]
    return msgspec.structs.replace(point, **fields)


def _size(row: ListRow, area: Area, words: int) -> int:
    """Return the number of addresses that a row takes; `words` is the number for one value of its
    type.

    Raises ValueError if the row's number of registers is no multiple of `words`, or if the row ends
    beyond address 65535.
    """
    size = row.address.registers or (None if area.table.is_bits else row.registers) or words
    if size % words:
        raise ValueError(f"has {size} registers, but its type takes {words}")
    if area.first + size > 1 << 16:
        raise ValueError(f"leaves no room for its {size} registers")
    return size


def _type(row: ListRow, table: Table, report: ImportReport) -> TypeSpelling:
    """Return the type of a row's value. Raises ValueError if `table` cannot hold values of this
    type.
    """
    type_ = row.type
    if table.is_bits:
        if type_ is not None and not type_.is_switch:
            raise ValueError(
                f"is in {table}, which hold bits, not {type_.type}; BOOL would be right"
            )
        return TypeSpelling(PointType.BIT)
    if type_ is None:
        kind = PointType.UINT32 if row.registers == 2 else PointType.UINT16
        report.tell(f"no type named, taken as {kind}", row.row)
        type_ = TypeSpelling(kind)
    elif type_.type is PointType.BIT:  # An on/off value in a register of its own.
        type_ = replace(type_, type=PointType.UINT16)
    if type_.type.words > 1 and (type_.is_bits or row.bits):
        report.tell("bits in several registers cannot have names, so a whole number", row.row)
    elif row.bits and type_.type in (PointType.UINT16, PointType.INT16, PointType.HEX16):
        type_ = replace(type_, type=PointType.FLAGS)
    return type_


def _string_words(row: ListRow, type_: TypeSpelling, report: ImportReport) -> int:
    if known := row.registers or row.address.registers:
        return known
    if type_.length is None:
        report.tell("a text without a length, taken as 1 register", row.row)
        return 1
    if type_.length_is_registers:
        return max(type_.length, 1)
    report.tell("the length of a text counts characters, two in a register", row.row)
    return max(-(-type_.length // 2), 1)


def _texts(row: ListRow, type_: TypeSpelling) -> tuple[dict[int, str], list[str]]:
    """Return the meanings of the value's numbers, and notes about the meanings that the point
    cannot have.

    If the type cannot have one of the numbers, all meanings become notes. The meanings of bits
    become notes if the point has no named bits.
    """
    kind, texts = type_.type, dict(row.texts)
    if type_.is_switch:
        texts = texts or {0: "off", 1: "on"}
    others = (
        [] if kind is PointType.FLAGS else [f"bit {at} = {one}" for at, one in row.bits.items()]
    )
    allowed = {PointType.BIT: range(2), PointType.HEX16: range(1 << 16)}.get(
        kind, kind.whole_numbers
    )
    if not texts or (allowed is not None and all(value in allowed for value in texts)):
        return texts, others
    return {}, others + [f"{value} = {text}" for value, text in texts.items()]


def _limits(row: ListRow, kind: PointType, words: int) -> tuple[dict[str, float], list[str]]:
    """Return the keys `minimum`, `maximum` and `default` of a point, and notes about those of them
    that the point cannot have. `words` is the number of registers of its value.

    If a value is scaled, the list does not say whether its range and default are before or after
    scaling. Then they become notes.
    """
    is_plain = kind.is_number and (row.scale, row.offset) == (1, 0)
    said = {"minimum": row.minimum, "maximum": row.maximum, "default": row.default}
    if kind is PointType.BIT:  # A bit is 0 or 1, whatever the list says.
        said = {"default": row.default}
    fits = dict.fromkeys(said, is_plain)
    fits["default"] = is_plain and words == 1 and _has_usable_default(row)
    values = {key: value for key, value in said.items() if value is not None}
    return (
        {key: value for key, value in values.items() if fits[key]},
        [f"{key} in the list: {value}" for key, value in values.items() if not fits[key]],
    )


def _has_usable_default(row: ListRow) -> bool:
    """True if a point can have the default value of the row.

    It must be a whole number from 0 to 7FFFH, and within the row's range.
    """
    default, low, high = row.default, row.minimum, row.maximum
    if default is None or default != int(default) or not 0 <= default <= 0x7FFF:
        return False
    return (low is None or default >= low) and (high is None or default <= high)


def _without_overlaps(made: Sequence[RowPoint], report: ImportReport) -> list[RowPoint]:
    kept: list[RowPoint] = []
    taken: dict[tuple[Table, int], RowPoint] = {}
    for one in sorted(made, key=lambda each: each.row.row):
        places = [(one.point.table, at) for at in range(one.point.address, one.end)]
        other = next((taken[place] for place in places if place in taken), None)
        if other is None:
            kept.append(one)
            taken.update(dict.fromkeys(places, one))
            continue
        size = other.end - other.point.address
        takes = f", which takes {size} registers" if size > 1 else ""
        problem = f'overlaps row {other.row.row}, "{other.point.name or other.reference}"{takes}'
        report.add_problem(one.row.row, None, one.row.address.text, problem)
    return kept


def _with_unique_names(made: Sequence[RowPoint]) -> list[RowPoint]:
    """Give every point a name of its own.

    If an earlier point has the same name, the point's reference (such as HR12) is appended to the
    name.
    """
    taken: set[str] = set()
    named = []
    for one in made:
        name = one.point.name or one.reference
        if one.point.count > 1:
            name = f"{name} {{n}}"
        if name in taken:
            name = f"{name} ({one.reference})"
        while name in taken:
            name = f"{name}'"
        taken.add(name)
        named.append(replace(one, point=msgspec.structs.replace(one.point, name=name)))
    return named
