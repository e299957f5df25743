"""Reads references with a type, such as `hr10:f32cdab`, as points of a profile."""

#     [NAME=]REFERENCE:TYPE[ORDER]     hr10:f32cdab, 'holding 0..9:i16', 400011:u32, Flow=hr4:f32
#
# The reference is one of questions.py. A type is a letter and the bits (u16 i16 u32 i32 u64 i64 f32
# f64), bcd16, bcd32, hex, str and the number of characters (str8), or a name that register lists
# use (uint32, float). The order is ABCD, CDAB, BADC or DCBA; ABCD if none is given. A range has as
# many values as fit into it.
#
# The points are added to the profile of the slave, in place of those at their registers. A slave
# without a profile gets one of these points alone, which states no rules.

from __future__ import annotations

import re
from collections.abc import Sequence

import msgspec

from mbtool.core import UsageError
from mbtool.devices import ByteOrder, Point, PointType, Profile, WordOrder, write_reference
from mbtool.devices.importing.spellings import parse_order, parse_type
from mbtool.devices.references import SHORT_WORDS
from mbtool.modbus.tables import Table
from mbtool.workflows.shared.questions import Wording

_SHORT = re.compile(r"([uif])(16|32|64)([a-d]{4})?")
_STRING = re.compile(r"(?:str|string|s)(\d{1,3})")
_TYPES = {
    "u16": PointType.UINT16, "i16": PointType.INT16, "u32": PointType.UINT32,
    "i32": PointType.INT32, "f32": PointType.FLOAT32, "u64": PointType.UINT64,
    "i64": PointType.INT64, "f64": PointType.FLOAT64,
}  # fmt: skip
_ORDER = re.compile(r"(.*\d)([a-d]{4})")


def typed_references(
    texts: Sequence[str],
    profile: Profile | None,
    function: int | None = None,
    *,
    writes: bool = False,
) -> tuple[list[str], Profile | None]:
    """Take the types out of what a user wrote to read or write.

    With `writes`, a text is `REFERENCE=VALUE:TYPE`; without it, it may be `NAME=REFERENCE:TYPE`.
    Returns the texts as questions.py understands them, and the profile with the typed points: the
    given one if no text has a type. Raises UsageError for a text with a type that is wrong.
    """
    plain: list[str] = []
    points: list[Point] = []
    for text in texts:
        typed = _reference_and_type(text)
        if typed is None:
            plain.append(text)
            continue
        reference, type_text = typed
        before, equals, behind = reference.partition("=")
        name, value = "", ""
        if writes:
            reference, value = before.strip(), f"{equals}{behind}"
        elif equals:
            name, reference = before.strip(), behind
        own = _points(reference, type_text, name, profile, function, text)
        points += own
        if value and len(own) > 1:
            raise UsageError(f"{text!r}: name the first register of the value to write")
        if "," in value and own[0].type is not PointType.STRING:
            raise UsageError(
                f"{text!r}: a type is that of one value; write each value with a reference of its "
                "own, and decimals with a point: hr40=1.5:f32 hr42=5:f32"
            )
        last = own[-1].address + own[-1].words - 1
        whole = write_reference(None, own[0].table, own[0].address, last - own[0].address + 1)
        plain.append(whole if len(own) > 1 else f"{own[0].name}{value}")
    return plain, with_points(profile, points) if points else profile


def typed_points(texts: Sequence[str]) -> list[Point]:
    """Return the points that the values of --types name. Raises UsageError for another text."""
    found: list[Point] = []
    for text in texts:
        typed = _reference_and_type(text)
        if typed is None:
            raise UsageError(f"--types {text!r}: write REFERENCE:TYPE, such as hr10:f32cdab")
        name, equals, reference = typed[0].rpartition("=")
        found += _points(reference, typed[1], name.strip() if equals else "", None, None, text)
    return found


def with_points(profile: Profile | None, points: Sequence[Point]) -> Profile:
    """Return a profile with some points more, in place of those at their registers."""
    base = profile or Profile(
        name="typed",
        title="a device with typed registers",
        vendor="unknown",
        transports=[],
        source="types that the user gave",
        areas=[],
        functions={},
    )
    taken = {(point.table, at) for point in points for at in point.all_addresses}
    if len(taken) < sum(len(point.all_addresses) for point in points):
        raise UsageError("a register has two types; ask twice, with one type each")
    rest = [
        point
        for point in base.points
        if not any((point.table, at) in taken for at in point.all_addresses)
    ]
    return msgspec.structs.replace(base, points=[*rest, *points])


def _reference_and_type(text: str) -> tuple[str, str] | None:
    """Divide a text into the reference and the type; None if it ends in no type."""
    reference, colon, type_text = text.rpartition(":")
    type_text = type_text.strip()
    if not colon or not reference.strip() or type_text.isdigit():
        return None
    return reference.strip(), type_text


def _points(
    reference: str,
    type_text: str,
    name: str,
    profile: Profile | None,
    function: int | None,
    text: str,
) -> list[Point]:
    table, span = Wording(profile, function).addresses(reference)
    if table.is_bits:
        raise UsageError(f"{text!r}: a coil or discrete input has no type")
    point = _typed(type_text, text)
    words = point.words
    if words == 1 and point.word_order is WordOrder.LOW_FIRST:
        raise UsageError(
            f"{text!r}: {point.type} has one register; write no order behind it, or BADC if its "
            "bytes are swapped"
        )
    count = 1 if ".." not in reference else len(span) // words
    if count < 1 or (".." in reference and len(span) % words):
        raise UsageError(f"{text!r}: {len(span)} registers are no whole number of {words} each")
    last = span.start + count * words - 1
    if last > 0xFFFF:
        raise UsageError(f"{text!r}: the value would end after register 65535")
    return [
        msgspec.structs.replace(
            point,
            name=_point_name(
                name, table, span.start + number * words, number + 1 if count > 1 else 0
            ),
            table=table,
            address=span.start + number * words,
        )
        for number in range(count)
    ]


def _point_name(name: str, table: Table, address: int, number: int) -> str:
    """The name of a point: the user's, or a short one such as HR10; `number` is 0 for the only
    one.
    """
    if not name:
        return f"{SHORT_WORDS[table]}{address}"
    return f"{name} {number}" if number else name


def _typed(type_text: str, text: str) -> Point:
    """Return a point of this type, which lacks its name and place yet."""

    def made(
        type_: PointType,
        order: tuple[WordOrder, ByteOrder] | None = None,
        length: int | None = None,
    ) -> Point:
        words, bytes_ = order or (WordOrder.HIGH_FIRST, ByteOrder.HIGH_FIRST)
        return Point(
            name="",
            table=Table.HOLDING_REGISTERS,
            address=0,
            type=type_,
            word_order=words,
            byte_order=bytes_,
            length=length,
        )

    low = type_text.lower().replace(" ", "")
    if short := _SHORT.fullmatch(low):
        key = f"{short[1]}{short[2]}"
        if key in _TYPES:
            return made(_TYPES[key], _order(short[3], key, text) if short[3] else None)
    elif string := _STRING.fullmatch(low):
        if (length := (int(string[1]) + 1) // 2) > 0:
            return made(PointType.STRING, length=length)
    else:
        match = _ORDER.fullmatch(low)
        spelled = parse_type(match[1] if match else low)
        if spelled is not None and spelled.type is not PointType.STRING and not spelled.is_switch:
            order = _order(match[2], match[1], text) if match else spelled.order
            return made(spelled.type, order)
    if "=" in type_text:
        type_, _, value = type_text.partition("=")
        raise UsageError(
            f"{text!r}: write the value before the type: {text.split(':')[0]}={value}:{type_}"
        )
    raise UsageError(
        f"{text!r}: {type_text!r} is no type; write u16, i16, u32, i32, u64, i64, f32, f64 (with "
        "ABCD, CDAB, BADC or DCBA behind), bcd16, bcd32, hex or str8"
    )


def _order(letters: str, type_text: str, text: str) -> tuple[WordOrder, ByteOrder]:
    order = parse_order(letters)
    if order is None:
        raise UsageError(
            f"{text!r}: {letters.upper()} is no order; write ABCD (the highest byte first), CDAB, "
            f"BADC or DCBA behind {type_text}"
        )
    return order
