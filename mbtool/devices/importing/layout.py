"""Lays the rows of a register list out: tables, addresses, areas and points."""

# Rows that name bits of one register become one point whose bits have names. A row with more
# registers than its type takes is a series of values. Two rows at one address are a complaint.
#
# Areas are the ranges that the list names. Where less than MAX_HOLE addresses are not listed the
# area goes on, since masters read over such holes and most devices let them; the profile says so.

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import msgspec

from mbtool.devices.importing.rows import Item
from mbtool.devices.importing.spellings import HIGH_LOW, TypeSpelling
from mbtool.devices.model import Access, Area, FunctionRule, Point, PointType, Radix
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from mbtool.devices.importing.columns import Column
    from mbtool.devices.importing.rows import Complaints

MAX_HOLE = 16
_TABLES = list(Table)
_READ_FUNCTIONS = {
    known.table: code
    for code, known in FUNCTIONS.items()
    if known.table is not None and not known.writes
}
_WRITE_FUNCTIONS = {Table.COILS: (0x05, 0x0F), Table.HOLDING_REGISTERS: (0x06, 0x10)}

REGISTER_BITS = range(16)

Notation = tuple[str, int, Radix, int, str]
"""Prefix, base, radix, width and suffix of an area."""


@dataclass(frozen=True, slots=True)
class PlacedRow:
    """A row whose table and address are known."""

    item: Item
    table: Table
    address: int
    notation: Notation
    access: Access


@dataclass(frozen=True, slots=True)
class Laid:
    """A point, and the row that it came from."""

    point: Point
    placed: PlacedRow


def lay_points(
    rows: Sequence[PlacedRow], complaints: Complaints, column: Column | None
) -> list[Laid]:
    """Make the points, in the order of their tables and addresses; `column` has the addresses."""
    bits: dict[tuple[Table, int], list[PlacedRow]] = {}
    laid: list[Laid] = []
    for row in rows:
        if row.item.written.bit is not None and not row.table.is_bits:
            bits.setdefault((row.table, row.address), []).append(row)
        else:
            laid += _laid(row, complaints, column)
    singles = {
        (one.point.table, one.point.address): one
        for one in laid
        if one.point.words == one.point.count == 1
    }
    for place, members in bits.items():
        laid += _flags(members, singles.get(place), complaints, column)
    covered = {id(singles[place]) for place in bits if place in singles}
    laid = [one for one in laid if id(one) not in covered]
    laid = _without_overlaps(laid, complaints, column)
    laid.sort(key=lambda one: (_TABLES.index(one.point.table), one.point.address))
    return _named_apart(laid)


def _laid(row: PlacedRow, complaints: Complaints, column: Column | None) -> list[Laid]:
    item = row.item
    kind = _kind(row, complaints, column)
    if kind is None:
        return []
    words = kind.type.words or _string_words(item, kind)
    count = _count(row, words, complaints, column)
    if row.address + words * count > 1 << 16:
        complaints.add(
            item.row, column, str(item.written.number), f"leaves no room for its {words} registers"
        )
        return []
    order = item.order or HIGH_LOW
    is_number = kind.type.is_number
    if not is_number and item.scale != 1:
        complaints.add(item.row, None, item.name, f"has a factor, but {kind.type} is no number")
    texts, note = _texts(row, kind)
    is_plain = is_number and (item.scale, item.offset) == (1, 0)
    limits, extra = _limits(item, is_plain=is_plain, is_bit=kind.type is PointType.BIT, words=words)
    point = Point(
        name=item.name,
        table=row.table,
        address=row.address,
        type=kind.type,
        count=count,
        stride=words if count > 1 else 1,
        length=words if kind.type is PointType.STRING else None,
        word_order=order[0] if words > 1 and kind.type is not PointType.STRING else HIGH_LOW[0],
        byte_order=order[1] if kind.type is not PointType.BIT else HIGH_LOW[1],
        unit=item.unit,
        scale=item.scale if is_number else 1.0,
        offset=item.offset if is_number else 0.0,
        decimals=item.decimals if is_number else None,
        texts=texts,
        note="; ".join(part for part in (item.note, note, extra) if part) or None,
    )
    return [Laid(_with(point, **limits), row)]


def _kind(row: PlacedRow, complaints: Complaints, column: Column | None) -> TypeSpelling | None:
    """The type as it stands in its table."""
    kind, item = row.item.kind, row.item
    if row.table.is_bits:
        if kind is not None and not kind.is_switch:
            complaints.add(
                item.row, column, str(item.written.number),
                f"is in {row.table}, which hold bits, not {kind.type}; BOOL would be right",
            )  # fmt: skip
            return None
        return TypeSpelling(PointType.BIT)
    if kind is None:
        types = {None: PointType.UINT16, 1: PointType.UINT16, 2: PointType.UINT32}
        return TypeSpelling(types.get(item.registers, PointType.UINT16))
    # A yes or no that has a register to itself.
    return replace(kind, type=PointType.UINT16) if kind.type is PointType.BIT else kind


def _string_words(item: Item, kind: TypeSpelling) -> int:
    if item.registers is not None:
        return item.registers
    if item.written.last is not None:
        return item.written.last - item.written.number + 1
    if kind.length is None:
        return 1
    return kind.length if kind.length_is_registers else -(-kind.length // 2)


def _count(row: PlacedRow, words: int, complaints: Complaints, column: Column | None) -> int:
    item = row.item
    last = item.written.last
    size = last - item.written.number + 1 if last is not None else item.registers
    if size is None or (row.table.is_bits and last is None):
        return 1
    if size % words:
        complaints.add(
            item.row, column, str(item.written.number),
            f"has {size} registers, where its type takes {words}",
        )  # fmt: skip
        return 1
    return size // words


def _texts(row: PlacedRow, kind: TypeSpelling) -> tuple[dict[int, str], str]:
    """The texts that fit the type, else a note."""
    texts = dict(row.item.texts)
    if row.item.kind is not None and row.item.kind.is_switch and not row.table.is_bits:
        texts = texts or {0: "off", 1: "on"}
    allowed = range(2) if kind.type is PointType.BIT else kind.type.whole_numbers
    if kind.type is PointType.HEX16:
        allowed = range(1 << 16)
    if not texts or (allowed is not None and all(value in allowed for value in texts)):
        return texts, ""
    return {}, ", ".join(f"{value} = {text}" for value, text in texts.items())


def _limits(
    item: Item, *, is_plain: bool, is_bit: bool, words: int
) -> tuple[dict[str, float], str]:
    """Range and default where they cannot be misunderstood, else as a note.

    A list does not say whether they are before or after scaling.
    """
    low, high, default = item.minimum, item.maximum, item.default
    if is_bit:
        low, high = None, None  # A bit is 0 or 1, as it is.
    limits: dict[str, float] = {}
    said = []
    if is_plain:
        limits = {
            key: value for key, value in (("minimum", low), ("maximum", high)) if value is not None
        }
    elif low is not None or high is not None:
        said.append(
            f"range in the list: {'' if low is None else low}..{'' if high is None else high}"
        )
    within = (low is None or default is None or default >= low) and (
        high is None or default is None or default <= high
    )
    fits = default is not None and default == int(default) and 0 <= default <= 0x7FFF
    if is_plain and words == 1 and fits and within and default is not None:
        limits["default"] = int(default)
    elif default is not None:
        said.append(f"default in the list: {default}")
    return limits, "; ".join(said)


def _flags(
    rows: Sequence[PlacedRow], whole: Laid | None, complaints: Complaints, column: Column | None
) -> list[Laid]:
    """One point for the bits of one register; a row for the whole register gives it its name."""
    names: dict[int, str] = {}
    for row in rows:
        bit = row.item.written.bit or 0
        is_none = bit not in REGISTER_BITS
        if is_none or bit in names:
            problem = "a register has bits 0 to 15" if is_none else f"bit {bit} has a row already"
            complaints.add(row.item.row, column, f"{row.item.written.number}.{bit}", f": {problem}")
        names.setdefault(bit, row.item.name)
    first = whole.placed if whole is not None else rows[0]
    shared = _shared_words(list(names.values()))
    point = Point(
        name=whole.point.name if whole is not None else shared,
        table=first.table,
        address=first.address,
        type=PointType.FLAGS,
        bits={bit: name for bit, name in sorted(names.items()) if bit in REGISTER_BITS},
        note=whole.point.note if whole is not None else None,
    )
    written = any(row.access is not Access.READ for row in (*rows, first))
    access = Access.READ_WRITE if written else Access.READ
    return [Laid(point, replace(first, access=access))] if point.bits else []


def _shared_words(names: Sequence[str]) -> str:
    """The words that all names begin with, unless it is one alone: "Pump 3 alarm", not "Too"."""
    shared: list[str] = []
    for words in zip(*(name.split() for name in names), strict=False):
        if len(set(words)) > 1:
            break
        shared.append(words[0])
    return " ".join(shared) if len(names) > 1 and len(shared) > 1 else ""


def _without_overlaps(
    laid: Sequence[Laid], complaints: Complaints, column: Column | None
) -> list[Laid]:
    kept: list[Laid] = []
    taken: dict[tuple[Table, int], Laid] = {}
    for one in sorted(laid, key=lambda each: each.placed.item.row):
        end = one.point.address + one.point.words * one.point.count
        places = [(one.point.table, address) for address in range(one.point.address, end)]
        other = next((taken[place] for place in places if place in taken), None)
        if other is None:
            kept.append(one)
            taken.update(dict.fromkeys(places, one))
            continue
        size = other.point.words * other.point.count
        takes = f", which takes {size} registers" if size > 1 else ""
        complaints.add(
            one.placed.item.row, column, _as_written(one),
            f'lies on row {other.placed.item.row}, '
            f'"{other.point.name or _as_written(other)}"{takes}',
        )  # fmt: skip
    return kept


def _as_written(one: Laid) -> str:
    prefix, base, radix, width, suffix = one.placed.notation
    number = radix.write(one.placed.address + base).rjust(width, "0")
    return f"{prefix}{number}{suffix}"


def _named_apart(laid: Sequence[Laid]) -> list[Laid]:
    """Every name once: a second one has its reference behind it."""
    taken: set[str] = set()
    named = []
    for one in laid:
        reference = _as_written(one)
        name = one.point.name or reference
        if one.point.count > 1:
            name = f"{name} {{n}}"
        if name in taken:
            name = f"{name} ({reference})"
        while name in taken:
            name = f"{name}'"
        taken.add(name)
        named.append(replace(one, point=_with(one.point, name=name)))
    return named


def _with(point: Point, **fields: object) -> Point:
    return msgspec.structs.replace(point, **fields)


def lay_areas(laid: Sequence[Laid]) -> tuple[list[Area], list[Point], dict[str, FunctionRule]]:
    """The areas, the points with the rights that differ from their area's, and the functions.

    Functions are those that the list names, and those by which its tables are read and written.
    """
    areas: list[Area] = []
    points: list[Point] = []
    codes: set[int] = set()
    run: list[Laid] = []
    for one in (*laid, None):
        if run and (one is None or not _goes_on(run, one)):
            area = _area(run, {each.name for each in areas})
            areas.append(area)
            points += [_with_access(member, area) for member in run]
            codes |= _functions(run, area)
            run = []
        if one is not None:
            run.append(one)
    return areas, points, {f"{code:02X}": FunctionRule() for code in sorted(codes)}


def _end(one: Laid) -> int:
    return one.point.address + one.point.words * one.point.count


def _goes_on(run: Sequence[Laid], one: Laid) -> bool:
    last = run[-1]
    return (
        last.point.table is one.point.table
        and last.placed.notation == one.placed.notation
        and one.point.address - _end(last) < MAX_HOLE
    )


def _area(run: Sequence[Laid], taken: Collection[str]) -> Area:
    """The area of a run; where another is called like it, since numbers repeat, its address too."""
    first, last = run[0], run[-1]
    rights = {member.placed.access for member in run}
    prefix, base, radix, width, suffix = first.placed.notation
    area = Area(
        name="",
        table=first.point.table,
        first=first.point.address,
        last=_end(last) - 1,
        access=next(iter(rights)) if len(rights) == 1 else Access.READ_WRITE,
        prefix=prefix,
        base=base,
        radix=radix,
        width=width,
        suffix=suffix,
    )
    span = area.span(area.first, area.last)
    words = area.table.value.replace("_", " ")
    name = f"{words if area.last > area.first else words.removesuffix('s')} {span}"
    if name in taken:
        name = f"{name}, from address {area.first}"
    return msgspec.structs.replace(area, name=name)


def _with_access(laid: Laid, area: Area) -> Point:
    access = laid.placed.access
    return laid.point if access is area.access else _with(laid.point, access=access)


def _functions(run: Sequence[Laid], area: Area) -> set[int]:
    named = {
        code
        for one in run
        if one.placed.item.reach is not None
        for code in one.placed.item.reach.functions
    }
    if area.access.allows(writing=False):
        named.add(_READ_FUNCTIONS[area.table])
    if area.access.allows(writing=True) and not any(FUNCTIONS[code].writes for code in named):
        named.update(_WRITE_FUNCTIONS[area.table])
    return named
