"""The spellings that register lists have for types, and for the order of registers and bytes."""

# A type may bring its order along (`FLOAT32 CDAB`, `32BIT_UINT_3412`, `REAL (swapped)`), its length
# (`STRING[16]`) or nothing but its family (`INT`, `float`), where the number of registers decides.
# What is not known whole is not guessed at: `FLOTE` is an error, not a float.

from __future__ import annotations

import re
from dataclasses import dataclass

from mbtool.devices.model import ByteOrder, PointType, WordOrder

HIGH_LOW = (WordOrder.HIGH_FIRST, ByteOrder.HIGH_FIRST)  # ABCD
LOW_HIGH = (WordOrder.LOW_FIRST, ByteOrder.HIGH_FIRST)  # CDAB
HIGH_SWAPPED = (WordOrder.HIGH_FIRST, ByteOrder.LOW_FIRST)  # BADC
LOW_SWAPPED = (WordOrder.LOW_FIRST, ByteOrder.LOW_FIRST)  # DCBA

Order = tuple[WordOrder, ByteOrder]


@dataclass(frozen=True, slots=True)
class TypeSpelling:
    """What a type's spelling says."""

    type: PointType
    order: Order | None = None
    """None where the spelling says nothing of it."""
    length: int | None = None
    """Of a string, where the spelling has a number."""
    length_is_registers: bool = False
    """Else it counts characters, two in each register."""
    is_switch: bool = False
    """A yes or no, wherever it stands."""
    is_bits: bool = False
    """Bits that have meanings of their own."""


_LETTERS = {
    "abcd": HIGH_LOW, "cdab": LOW_HIGH, "badc": HIGH_SWAPPED, "dcba": LOW_SWAPPED,
    "1234": HIGH_LOW, "3412": LOW_HIGH, "2143": HIGH_SWAPPED, "4321": LOW_SWAPPED,
    "0123": HIGH_LOW, "2301": LOW_HIGH, "1032": HIGH_SWAPPED, "3210": LOW_SWAPPED,
    "abcdefgh": HIGH_LOW, "ghefcdab": LOW_HIGH, "badcfehg": HIGH_SWAPPED, "hgfedcba": LOW_SWAPPED,
    "ab": HIGH_LOW, "ba": HIGH_SWAPPED,
}  # fmt: skip

# "Little endian byte swap" is CDAB and "big endian byte swap" BADC in the masters that most people
# check a list with; of a swap without an endianness the big one is meant.
_PHRASES = (
    (r"little ?endian byte ?swap(?:ped)?|mid(?:dle)? ?little ?endian", LOW_HIGH),
    (r"little ?endian word ?swap(?:ped)?|(?:big ?endian )?byte ?swap(?:ped)?", HIGH_SWAPPED),
    (r"mid(?:dle)? ?big ?endian", HIGH_SWAPPED),
    (r"(?:byte ?word|word ?byte|word ?(?:and|&) ?byte)(?: ?swap(?:ped)?)?", LOW_SWAPPED),
    (r"(?:big ?endian )?(?:word ?swap(?:ped)?|swap(?:ped)? ?words?)", LOW_HIGH),
    (r"swap(?:ped)?|inverse|inverted|reversed?", LOW_HIGH),
    (r"(?:ls[wr]|low(?:er)? ?words?|least significant word)(?: ?first)?|lo ?hi", LOW_HIGH),
    (r"(?:ms[wrb]|high(?:er)? ?words?|most significant word)(?: ?first)?|hi ?lo", HIGH_LOW),
    (r"(?:big|be|msb ?first) ?(?:endian)?|none|no(?:rmal)?(?: ?swap)?|standard", HIGH_LOW),
)
_LITTLE = re.compile(r"(?:little|le|lsb ?first) ?(?:endian)?")
_ORDER_IN_TYPE = re.compile(
    r"(?<![a-z0-9])(?:abcdefgh|ghefcdab|badcfehg|hgfedcba|abcd|cdab|badc|dcba|1234|3412|2143|4321)"
    r"(?![a-z0-9])"
    r"|(?:(?:big|little)[ -]?endian[ -]?)?(?:word|byte)[ -]?swap(?:ped)?"
    r"|(?:mid[ -]?)?(?:big|little)[ -]?endian|(?<![a-z])swap(?:ped)?|inverse|reversed"
    r"|(?<=[0-9 _-])(?:be|le)(?![a-z0-9])|[lm]sw(?:[ -]?first)?",
)

_BITS = r"(?:(?P<bits{n}>8|16|32|64)[ -]?(?:bits?)?)?"
_INTEGER = re.compile(
    rf"{_BITS.format(n=1)}(?P<sign1>unsigned|signed|u|s)?{_BITS.format(n=2)}"
    r"(?P<word>int(?:eger)?|i|short|long(?:long)?|num(?:ber)?)?"
    rf"{_BITS.format(n=3)}(?P<sign2>unsigned|signed|u|s)?t?"
)
_FLOAT = re.compile(
    rf"{_BITS.format(n=1)}(?:ieee(?:754)?)?"
    r"(?P<word>float(?:ing)?(?:point)?|real|lreal|single|double|fp|f)?(?:precision)?(?:float)?"
    rf"(?:ieee(?:754)?)?{_BITS.format(n=2)}(?:ieee(?:754)?)?"
)
_BCD = re.compile(rf"{_BITS.format(n=1)}(?:packed)?bcd(?P<number>4|8|16|32)?(?:bits?|digits?)?")
_STRING = re.compile(
    r"(?:string|str|ascii(?:string)?|char(?:acter)?s?|text|utf8|octetstring|visiblestring)"
    r"(?P<length>\d{1,3})?(?P<unit>bytes?|chars?|characters?|b|reg(?:ister)?s?|words?)?"
)
_FLAGS = re.compile(
    rf"{_BITS.format(n=1)}(?:bit(?:field|map|mask|string|array|s)|flags?|status)"
    rf"{_BITS.format(n=2)}"
)
_NAMED = {
    "byte": (8, False), "usint": (8, False), "sint": (8, True),
    "word": (16, False), "dint": (32, True), "udint": (32, False), "dword": (32, False),
    "lint": (64, True), "ulint": (64, False), "lword": (64, False), "qword": (64, False),
    "doubleword": (32, False), "longword": (32, False), "doubleint": (32, True),
    "enum": (16, False), "enum16": (16, False), "enum32": (32, False), "enumeration": (16, False),
    "acc16": (16, False), "acc32": (32, False), "acc64": (64, False), "count": (16, False),
    "sunssf": (16, True), "counter": (None, False), "percent": (16, False),
}  # fmt: skip
_SWITCHES = frozenset(
    ("bool", "boolean", "bit", "1bit", "bit1", "binary", "digital", "coil", "onoff", "discrete",
     "yesno", "switch")
)  # fmt: skip
_HEX = frozenset(("hex", "hex16", "hexadecimal", "raw", "raw16"))

_INTEGERS = {
    (16, False): PointType.UINT16, (16, True): PointType.INT16,
    (32, False): PointType.UINT32, (32, True): PointType.INT32,
    (64, False): PointType.UINT64, (64, True): PointType.INT64,
}  # fmt: skip
_CODES = {
    8: PointType.HEX16, 16: PointType.HEX16, 32: PointType.UINT32, 64: PointType.UINT64,
}  # fmt: skip


def parse_order(text: str) -> Order | None:
    """The order that a cell names: `CDAB`, `big-endian word swap`, `LSW first`; None if none."""
    letters = re.sub(r"[^a-z0-9]", "", text.lower())
    if letters in _LETTERS:
        return _LETTERS[letters]
    phrase = " ".join(re.sub(r"[^a-z0-9&]", " ", text.lower()).split())
    for pattern, order in _PHRASES:
        if re.fullmatch(pattern, phrase):
            return order
    return LOW_SWAPPED if _LITTLE.fullmatch(phrase) else None


def parse_type(text: str, registers: int | None = None) -> TypeSpelling | None:
    """What a spelling stands for; `registers` is how many the list gives the value, if it does."""
    lowered = text.lower().strip()
    order: Order | None = None
    found = _ORDER_IN_TYPE.search(lowered)
    if found is not None:
        order = parse_order(found[0])
        lowered = f"{lowered[: found.start()]} {lowered[found.end() :]}"
    name = re.sub(r"[^a-z0-9]", "", lowered)
    if not name:
        return None
    bits = 16 * registers if registers in (1, 2, 4) else None
    return (
        _plain(name, bits, order)
        or _string(name, order)
        or _float(name, bits, order)
        or _bcd(name, bits, order)
        or _flags(name, bits, order)
        or _integer(name, bits, order)
    )


def _plain(name: str, bits: int | None, order: Order | None) -> TypeSpelling | None:
    if name in _SWITCHES:
        return TypeSpelling(PointType.BIT, is_switch=True)
    if name in _HEX:
        return TypeSpelling(_CODES[bits or 16], order)
    return None


def _string(name: str, order: Order | None) -> TypeSpelling | None:
    match = _STRING.fullmatch(name)
    if match is None:
        return None
    length = int(match["length"]) if match["length"] else None
    return TypeSpelling(
        PointType.STRING, order, length, (match["unit"] or "").startswith(("reg", "word"))
    )


def _float(name: str, bits: int | None, order: Order | None) -> TypeSpelling | None:
    match = _FLOAT.fullmatch(name)
    if match is None or not (match["word"] or "ieee" in name):
        return None
    said = _width(match, bits, 64 if match["word"] in ("double", "lreal") else None)
    point_type = {32: PointType.FLOAT32, 64: PointType.FLOAT64}.get(said or 32)
    return None if point_type is None else TypeSpelling(point_type, order)


def _bcd(name: str, bits: int | None, order: Order | None) -> TypeSpelling | None:
    match = _BCD.fullmatch(name)
    if match is None:
        return None
    # A number of up to eight counts digits.
    number = {"4": 16, "8": 32, "16": 16, "32": 32}.get(match["number"] or "")
    said = number or _width(match, bits, None)
    point_type = {16: PointType.BCD16, 32: PointType.BCD32}.get(said or 16)
    return None if point_type is None else TypeSpelling(point_type, order)


def _flags(name: str, bits: int | None, order: Order | None) -> TypeSpelling | None:
    match = _FLAGS.fullmatch(name)
    if match is None:
        return None
    said = _width(match, bits, None) or 16
    return TypeSpelling(_CODES[said], order, is_bits=True)


def _integer(name: str, bits: int | None, order: Order | None) -> TypeSpelling | None:
    if name in _NAMED:
        width, signed = _NAMED[name]
        return TypeSpelling(_INTEGERS[max(width or bits or 16, 16), signed], order)
    match = _INTEGER.fullmatch(name)
    if match is None or (match["sign1"] and match["sign2"]):
        return None
    sign, word = match["sign1"] or match["sign2"], match["word"]
    if not word and name in ("u", "s", "t", *("8", "16", "32", "64")):
        return None
    widths = {match[key] for key in ("bits1", "bits2", "bits3")} - {None}
    if len(widths) > 1:
        return None
    usual = {"long": 32, "longlong": 64, "short": 16}.get(word or "")
    said = _width(match, bits if usual is None else None, usual) or 16
    signed = sign in ("s", "signed") or (sign is None and word is not None)
    # Eight bits stand in a register of their own.
    return TypeSpelling(_INTEGERS[max(said, 16), signed], order)


def _width(match: re.Match[str], bits: int | None, usual: int | None) -> int | None:
    """How many bits: by the spelling's number, else its word, else the list's registers."""
    for key in ("bits1", "bits2", "bits3"):
        if match.groupdict().get(key):
            return int(match[key])
    return usual or bits
