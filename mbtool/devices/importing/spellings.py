"""Reads types and word and byte orders as register lists spell them."""

# A type may be followed by its word and byte order (`FLOAT32 CDAB`, `32BIT_UINT_3412`, `UINT32 (low
# word first)`) or its length (`STRING[16]`). If a cell names only a family of types (`INT`,
# `float`), the number of registers decides. The whole word must be a known one: `FLOTE` is an
# error, not a float.

from __future__ import annotations

import re
from dataclasses import dataclass

from mbtool.devices.point_types import ByteOrder, PointType, WordOrder

HIGH_LOW = (WordOrder.HIGH_FIRST, ByteOrder.HIGH_FIRST)  # ABCD
LOW_HIGH = (WordOrder.LOW_FIRST, ByteOrder.HIGH_FIRST)  # CDAB
HIGH_SWAPPED = (WordOrder.HIGH_FIRST, ByteOrder.LOW_FIRST)  # BADC
LOW_SWAPPED = (WordOrder.LOW_FIRST, ByteOrder.LOW_FIRST)  # DCBA

Order = tuple[WordOrder, ByteOrder]


@dataclass(frozen=True, slots=True)
class TypeSpelling:
    """The type of a value as a cell of a register list names it."""

    type: PointType
    order: Order | None = None
    """The word and byte order; None if the cell names none."""
    length: int | None = None
    """The length of a string in the cell, in registers or characters; None if it has none."""
    length_is_registers: bool = False
    """True if `length` counts registers. False if it counts characters, two of which are in a
    register."""
    is_switch: bool = False
    """True if the value is only off or on, as a coil, a discrete input or a whole register."""
    is_bits: bool = False
    """True if the value is a set of bits, each with its own meaning."""


_LETTERS = {
    "abcd": HIGH_LOW, "cdab": LOW_HIGH, "badc": HIGH_SWAPPED, "dcba": LOW_SWAPPED,
    "1234": HIGH_LOW, "3412": LOW_HIGH, "2143": HIGH_SWAPPED, "4321": LOW_SWAPPED,
    "0123": HIGH_LOW, "2301": LOW_HIGH, "1032": HIGH_SWAPPED, "3210": LOW_SWAPPED,
    "abcdefgh": HIGH_LOW, "ghefcdab": LOW_HIGH, "badcfehg": HIGH_SWAPPED, "hgfedcba": LOW_SWAPPED,
    "ab": HIGH_LOW, "ba": HIGH_SWAPPED,
}  # fmt: skip

# Phrases for word and byte orders. In the programs that most people use to read registers, "little
# endian byte swap" means CDAB and "big endian byte swap" means BADC. A phrase that names a swap but
# no endianness means a swap of big endian.
_PHRASES = (
    (r"little ?endian byte ?swap(?:ped)?|mid(?:dle)? ?little ?endian", LOW_HIGH),
    (r"little ?endian word ?swap(?:ped)?|(?:big ?endian )?byte ?swap(?:ped)?", HIGH_SWAPPED),
    (r"mid(?:dle)? ?big ?endian", HIGH_SWAPPED),
    (r"(?:byte ?word|word ?byte|word ?(?:and|&) ?byte)(?: ?swap(?:ped)?)?", LOW_SWAPPED),
    (r"(?:big ?endian )?(?:word ?swap(?:ped)?|swap(?:ped)? ?words?)", LOW_HIGH),
    (r"swap(?:ped)?|inverse|inverted|reversed?", LOW_HIGH),
    (r"(?:ls[wr]|low(?:er)? ?words?|least significant word)(?: ?first)?|low? ?hi(?:gh)?", LOW_HIGH),
    (
        r"(?:ms[wrb]|high(?:er)? ?words?|most significant word)(?: ?first)?|hi(?:gh)? ?low?",
        HIGH_LOW,
    ),
    (r"niederwertiges wort zuerst", LOW_HIGH),
    (r"(?:big|be|msb ?first) ?(?:endian)?|none|no(?:rmal)?(?: ?swap)?|standard", HIGH_LOW),
    (r"(?:little|le|lsb ?first) ?(?:endian)?", LOW_SWAPPED),
)
_STRING = re.compile(
    r"(?:string|str|ascii(?:string)?|char(?:acter)?s?|text|utf8|octetstring|visiblestring)"
    r"(?P<length>\d{1,3})?(?P<unit>bytes?|chars?|characters?|b|reg(?:ister)?s?|words?)?"
)
_FLOAT = re.compile(
    r"ieee|(?:ieee)?(?P<word>float(?:ing)?(?:point)?|l?real|single|double|fp|f)"
    r"(?:precision)?(?:float)?(?:ieee)?"
)
_FLAGS = re.compile(r"bit(?:field|map|mask|string|array|s)|field|map|mask|flags?|status")
_INTEGER = re.compile(
    r"(?P<sign>unsigned|signed|u|s)?(?P<word>int(?:eger)?|i|short|long(?:long)?|num(?:ber)?)?"
    r"(?(sign)|(?P<last>unsigned|signed|u|s)?)t?"
)
_SWITCHES = frozenset(
    ("bool", "boolean", "bit", "1bit", "bit1", "binary", "digital", "coil", "onoff", "discrete",
     "yesno", "switch")
)  # fmt: skip
_HEX = frozenset(("hex", "hex16", "hexadecimal", "raw", "raw16"))

_UNSIGNED = {
    8: PointType.UINT16, 16: PointType.UINT16, 32: PointType.UINT32, 64: PointType.UINT64,
}  # fmt: skip
_SIGNED = {8: PointType.INT16, 16: PointType.INT16, 32: PointType.INT32, 64: PointType.INT64}
_CODES = {8: PointType.HEX16, 16: PointType.HEX16, 32: PointType.UINT32, 64: PointType.UINT64}
_FLOATS = {32: PointType.FLOAT32, 64: PointType.FLOAT64}
_BCD = {16: PointType.BCD16, 32: PointType.BCD32}
_USUAL_BITS = {"double": 64, "lreal": 64, "long": 32, "longlong": 64, "short": 16}
_NAMES = {
    "byte": (_UNSIGNED, 8), "usint": (_UNSIGNED, 8), "sint": (_SIGNED, 8),
    "word": (_UNSIGNED, 16), "percent": (_UNSIGNED, 16), "sunssf": (_SIGNED, 16),
    "enum": (_UNSIGNED, 16), "enumeration": (_UNSIGNED, 16), "count": (_UNSIGNED, 16),
    "acc": (_UNSIGNED, None), "counter": (_UNSIGNED, None),
    "dint": (_SIGNED, 32), "doubleint": (_SIGNED, 32), "udint": (_UNSIGNED, 32),
    "dword": (_UNSIGNED, 32), "doubleword": (_UNSIGNED, 32), "longword": (_UNSIGNED, 32),
    "lint": (_SIGNED, 64), "ulint": (_UNSIGNED, 64), "lword": (_UNSIGNED, 64),
    "qword": (_UNSIGNED, 64), "bcd": (_BCD, None), "packedbcd": (_BCD, None),
}  # fmt: skip


_MAX_TYPE = 100
"""A longer cell (characters) names no type."""


def parse_order(text: str) -> Order | None:
    """Read a word and byte order: `CDAB`, `big-endian word swap`, `LSW first`.

    Returns None if the text names no order.
    """
    words = re.findall(r"[a-z0-9&]+", text.lower())
    if (letters := "".join(words)) in _LETTERS:
        return _LETTERS[letters]
    phrase = " ".join(words)
    return next((order for pattern, order in _PHRASES if re.fullmatch(pattern, phrase)), None)


def parse_type(text: str, registers: int | None = None) -> TypeSpelling | None:
    """Read the type of a value, such as `FLOAT32 CDAB`; None if it is not known.

    `registers` is the number of registers that the list states for the value; None if it does not.
    """
    words = re.findall(r"[a-z0-9]+", text.lower()) if len(text) <= _MAX_TYPE else []
    orders = (parse_order(" ".join(words[at:])) for at in range(1, len(words)))
    at, order = next(((at, one) for at, one in enumerate(orders, 1) if one), (len(words), None))
    name = "".join(words[:at])
    if name in _SWITCHES:
        return TypeSpelling(PointType.BIT, is_switch=True)
    bits = 16 * registers if registers in (1, 2, 4) else None
    if name in _HEX:
        return TypeSpelling(_CODES[bits or 16], order)
    if string := _STRING.fullmatch(name):
        length = int(string["length"]) if string["length"] else None
        in_registers = (string["unit"] or "").startswith(("reg", "word"))
        return TypeSpelling(PointType.STRING, order, length, in_registers)
    return _number(name.replace("ieee754", "ieee"), bits, order)


def _number(name: str, bits: int | None, order: Order | None) -> TypeSpelling | None:
    """Read the name of a numeric type: `uint32`, `32bitfloat`, `dword`.

    `bits` is the size of the value in bits, if its number of registers is known; else None. This
    size decides if the name itself implies none. Returns None if the name is not known.
    """
    numbers = set(re.findall(r"\d+", name))
    letters = re.sub(r"\d+(?:bits?)?", "", name)
    if len(numbers) > 1 or not (letters or "bit" in name):
        return None
    said = int(numbers.pop()) if numbers else None
    types, usual = _family(letters, has_bits=said is not None)
    if types is _BCD and said in (4, 8):
        said *= 4  # `bcd4` counts decimal digits, of 4 bits each.
    known = bits if bits in types else None
    type_ = types.get(said or usual or known or min(types, default=0))
    return None if type_ is None else TypeSpelling(type_, order, is_bits=types is _CODES)


def _family(letters: str, *, has_bits: bool) -> tuple[dict[int, PointType], int | None]:
    """Return the types of a family (such as all signed integers) by their number of bits, and the
    usual number of bits for this name (None if it has none).

    `letters` is the name without digits; if it is not known, there are no types. `has_bits` is True
    if the name has a number of bits beside the letters.
    """
    if letters in _NAMES:
        return _NAMES[letters]
    if match := _FLOAT.fullmatch(letters):
        return _FLOATS, _USUAL_BITS.get(match["word"])
    if _FLAGS.fullmatch(letters):
        return _CODES, None
    match = _INTEGER.fullmatch(letters)
    if match is None:
        return {}, None
    sign, word = match["sign"] or match["last"] or "", match["word"]
    if not word and len(sign) < 2 and not has_bits:
        return {}, None
    is_signed = sign.startswith("s") or bool(word and not sign)
    return _SIGNED if is_signed else _UNSIGNED, _USUAL_BITS.get(word)
