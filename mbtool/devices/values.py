"""The value of a point, from its registers or bits, as a number and in the manual's words."""

# Registers come as they stand on the wire, the one at the lowest address first. `byte_order` turns
# each of them, then `word_order` their sequence, and what results is read high byte first.
#
# value = number * scale + offset is worked out in decimal, so that 3 * 0.1 is 0.3, and 64 bits keep
# all their digits. A string is UTF-8, of which ASCII is a part; what is not stands as \xNN. It
# ends before the NULs and spaces that fill its registers up.

from __future__ import annotations

import math
import struct
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Literal

from mbtool.core.errors import UsageError
from mbtool.devices.model import WORD_BITS, Access, ByteOrder, Point, PointType, WordOrder
from mbtool.devices.named_transaction import PointValue
from mbtool.devices.references import write_reference

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.devices.model import Profile
    from mbtool.modbus.tables import Table

_MAX_REMEMBERED = 256
_BIT_TEXTS = {0: "off", 1: "on"}

_FORMATS = {
    PointType.INT16: ">h",
    PointType.INT32: ">i",
    PointType.INT64: ">q",
    PointType.FLOAT32: ">f",
    PointType.FLOAT64: ">d",
}
"""The types that are not simply a number without sign."""
_BCD = (PointType.BCD16, PointType.BCD32)
# A 32-bit float has seven significant digits; fifteen are what a 64-bit one surely has.
_FLOAT32_DIGITS = 7
_DIGITS = 15


class PointInstance:
    """One named place of a device: one of the `count` that a point stands for."""

    # A plain number is said about as soon as it is looked up: of such a place only the last value
    # is kept, which a machine at rest repeats with every poll. What takes longer to say is seen
    # again and again, too: each place remembers the last of it, at most _MAX_REMEMBERED.

    __slots__ = (
        "_is_plain",
        "_last",
        "_last_word",
        "_point",
        "_ratio",
        "_remembered",
        "_signed",
        "_suffix",
        "_unit",
        "address",
        "block",
        "name",
        "reference",
        "words",
    )

    def __init__(self, point: Point, address: int, reference: str) -> None:
        self._point = point
        self._remembered: dict[int | tuple[int, ...], PointValue] = {}
        self._last: PointValue | None = None
        self._last_word = 0
        is_number = _is_number_of_one_register(point)
        self._ratio = _ratio(point) if is_number else None
        self._is_plain = is_number and self._ratio is None
        self._signed = point.type is PointType.INT16
        self._unit = point.unit
        self._suffix = f" {point.unit}" if point.unit else ""
        self.address = address
        self.words = point.words
        self.block = point.block
        self.reference = reference
        number = point.counted_from + (address - point.address) // point.stride
        self.name = point.name.replace("{n}", str(number)).replace("{reference}", reference)

    def value(self, raw: Sequence[int]) -> PointValue:
        """Put the registers or the bit of this place into words."""
        return values_of([(0, self)], raw)[0]

    def _value_in(self, values: Sequence[int], index: int) -> PointValue:
        key = values[index] if self.words == 1 else tuple(values[index : index + self.words])
        known = self._remembered.get(key)
        if known is not None:
            return known
        if self._ratio is not None and isinstance(key, int):
            value = self._scaled(key, self._ratio)
        else:
            value = self._in_words((key,) if isinstance(key, int) else key)
        if len(self._remembered) >= _MAX_REMEMBERED:
            self._remembered.clear()
        self._remembered[key] = value
        return value

    def _scaled(self, word: int, ratio: tuple[int, int, int]) -> PointValue:
        """A number of one register without texts: what `_in_words` would say of it, sooner."""
        times, plus, by = ratio
        number = word - 0x10000 if self._signed and word & 0x8000 else word
        # The quotient of two integers is rounded once, as it is from a decimal number.
        scaled = (number * times + plus) / by
        return PointValue(
            name=self.name,
            reference=self.reference,
            value=scaled,
            text=f"{scaled:.{_DIGITS}g}{self._suffix}",
            unit=self._unit,
        )

    def _in_words(self, raw: tuple[int, ...]) -> PointValue:
        number = _number(self._point, raw)
        return PointValue(
            name=self.name,
            reference=self.reference,
            value=_scaled(self._point, number),
            text=_text(self._point, raw, number),
            unit=self._unit,
        )


def values_of(
    places: Iterable[tuple[int, PointInstance]], values: Sequence[int]
) -> list[PointValue]:
    """Put registers or bits into words; each place comes with the index of its first one.

    A response may bring less than was asked for: a place that is not all there says nothing.
    """
    count = len(values)
    said = []
    for index, place in places:
        if index + place.words > count:
            continue
        if not place._is_plain:
            said.append(place._value_in(values, index))
            continue
        # Most values that change with every poll are plain numbers, so theirs is the shortest way.
        word = values[index]
        last = place._last
        if last is None or word != place._last_word:
            number = word - 0x10000 if place._signed and word & 0x8000 else word
            place._last_word = word
            last = place._last = PointValue(
                name=place.name,
                reference=place.reference,
                value=number,
                text=f"{number}{place._suffix}",
                unit=place._unit,
            )
        said.append(last)
    return said


def places_of(profile: Profile, table: Table, *, writing: bool = False) -> list[PointInstance]:
    """The named places of a table, by address: what a request to write, or to read, can be about.

    A value that a master cannot write keeps its name where one tries, unless what it would write
    there has a name of its own. What is only written is never what is read, and blocks are for
    reading.
    """
    points = [point for point in profile.points if point.table is table]
    if writing:
        points = [point for point in points if point.block is None]
    else:
        points = [point for point in points if point.access is not Access.WRITE]
    points.sort(key=lambda point: not point.allows(writing=writing))
    places: list[PointInstance] = []
    taken: set[tuple[int | None, int]] = set()
    for point in points:
        for address in point.addresses:
            words = [(point.block, word) for word in range(address, address + point.words)]
            if taken.isdisjoint(words):
                taken.update(words)
                reference = write_reference(profile, table, address, point.words, writing=writing)
                places.append(PointInstance(point, address, reference))
    return sorted(places, key=lambda place: place.address)


def registers_of(point: Point, value: float | str) -> list[int]:
    """The registers or the bit that say a value: what Place.value reads, written.

    `value` is in the point's own measure, after scale and offset; of a string it is the text, and
    for other types one of the point's texts may stand for its number. Raises UsageError.
    """
    if point.type is PointType.STRING:
        return _registers(point, _string_bytes(point, value))
    if isinstance(value, str):
        number: float | None = next((n for n, text in point.texts.items() if text == value), None)
        if number is None:
            known = f"a number or one of {', '.join(point.texts.values())}"
            raise UsageError(f"{value!r}: expected {known if point.texts else 'a number'}")
    else:
        number = _unscaled(point, value)
    if point.type is PointType.BIT:
        if number not in (0, 1):
            raise UsageError(f"{value}: a bit is 0 or 1")
        return [int(number)]
    return _registers(point, _number_bytes(point, number, value))


def _is_number_of_one_register(point: Point) -> bool:
    return (
        point.type in (PointType.UINT16, PointType.INT16)
        and point.byte_order is ByteOrder.HIGH_FIRST
        and not point.texts
        and point.decimals is None
    )


def _ratio(point: Point) -> tuple[int, int, int] | None:
    """Integers so that value = (number * first + second) / third; None where it is the number."""
    if point.scale == 1 and point.offset == 0:
        return None
    scale, offset = (Fraction(Decimal(str(one))) for one in (point.scale, point.offset))
    by = math.lcm(scale.denominator, offset.denominator)
    return int(scale * by), int(offset * by), by


def _number(point: Point, raw: Sequence[int]) -> float | None:
    """What the registers hold, before scale and offset; None where that is no number."""
    if point.type is PointType.BIT:
        return raw[0]
    if point.type is PointType.STRING:
        return None
    data = _bytes(point, raw)
    if point.type in _BCD:
        digits = data.hex()
        return int(digits) if digits.isdecimal() else None
    form = _FORMATS.get(point.type)
    if form is None:
        return int.from_bytes(data, "big")
    (number,) = struct.unpack(form, data)
    return float(number) if isinstance(number, float) else int(number)


def _bytes(point: Point, raw: Sequence[int]) -> bytes:
    words = [(word & 0xFFFF).to_bytes(2, _byte_order(point)) for word in raw]
    if point.word_order is WordOrder.LOW_FIRST:
        words.reverse()
    return b"".join(words)


def _registers(point: Point, data: bytes) -> list[int]:
    order = _byte_order(point)
    words = [int.from_bytes(data[at : at + 2], order) for at in range(0, len(data), 2)]
    if point.word_order is WordOrder.LOW_FIRST:
        words.reverse()
    return words


def _byte_order(point: Point) -> Literal["big", "little"]:
    return "big" if point.byte_order is ByteOrder.HIGH_FIRST else "little"


def _scaled(point: Point, number: float | None) -> float | None:
    if number is None or not math.isfinite(number):
        return None
    if point.scale == 1 and point.offset == 0:
        return number
    scaled = float(Decimal(number) * Decimal(str(point.scale)) + Decimal(str(point.offset)))
    return scaled if math.isfinite(scaled) else None


def _unscaled(point: Point, value: float) -> float:
    if (point.scale == 1 and point.offset == 0) or not math.isfinite(value):
        return value
    number = (Decimal(str(value)) - Decimal(str(point.offset))) / Decimal(str(point.scale))
    return float(number) if point.type.whole_numbers is None else round(number)


def _number_bytes(point: Point, number: float, value: float | str) -> bytes:
    size = 2 * point.words
    if point.type in (PointType.FLOAT32, PointType.FLOAT64):
        try:
            return struct.pack(_FORMATS[point.type], number)
        except OverflowError:
            raise UsageError(f"{value} is too large for {point.type}") from None
    allowed = point.type.whole_numbers or range(1 << WORD_BITS)
    if not math.isfinite(number) or number != int(number) or int(number) not in allowed:
        low, high = (_scaled(point, end) for end in (allowed[0], allowed[-1]))
        raise UsageError(f"{value} does not fit {point.type}, which holds {low}..{high}")
    number = int(number)
    if point.type in _BCD:
        return bytes.fromhex(f"{number:0{2 * size}d}")
    return number.to_bytes(size, "big", signed=number < 0)


def _string_bytes(point: Point, value: float | str) -> bytes:
    size = 2 * point.words
    if not isinstance(value, str):
        raise UsageError(f"{value}: expected a text of at most {size} bytes")
    data = value.encode(errors="replace")
    if len(data) > size:
        raise UsageError(f"{value!r} is too long: its {point.words} registers hold {size} bytes")
    return data.ljust(size, b"\0")


def _text(point: Point, raw: Sequence[int], number: float | None) -> str:
    match point.type:
        case PointType.STRING:
            return _string(_bytes(point, raw))
        case PointType.BIT if number is not None:
            return (point.texts or _BIT_TEXTS).get(int(number), str(number))
    if number is None:
        return f"{_bytes(point, raw).hex().upper()}H, which is not BCD"
    match point.type:
        case PointType.BIT_FIELD | PointType.NIBBLE_FIELD:
            return _field_text(point, int(number))
        case PointType.FLAGS:
            return _flags_text(point, int(number))
        case PointType.OCTETS:
            return f"{int(number) >> 8}.{int(number) & 0xFF}"
        case PointType.HEX16:
            code, text = f"{int(number):04X}H", point.texts.get(int(number))
            return f"{code} {text}" if text else code
    if isinstance(number, int) and number in point.texts:
        return point.texts[number]
    text = _digits(point, number)
    return f"{text} {point.unit}" if point.unit else text


def _digits(point: Point, number: float) -> str:
    scaled = _scaled(point, number)
    if scaled is None:
        return str(number)
    if point.decimals is not None:
        return f"{scaled:z.{point.decimals}f}"  # No -0.00, which a little below 0 would be.
    if isinstance(scaled, int):
        return str(scaled)
    return f"{scaled:.{_FLOAT32_DIGITS if point.type is PointType.FLOAT32 else _DIGITS}g}"


def _string(data: bytes) -> str:
    text = data.rstrip(b"\0 ").decode(errors="backslashreplace")
    shown = "".join(one if one.isprintable() else f"\\x{ord(one):02x}" for one in text)
    return shown or "(empty)"


def _flags_text(point: Point, word: int) -> str:
    """`READY, ALARM`: the names of the bits that are 1."""
    names = [name for bit, name in sorted(point.bits.items()) if word >> bit & 1]
    unnamed = word & ~sum(1 << bit for bit in point.bits)
    if unnamed:
        names.append(f"unassigned bits {unnamed:04X}H")
    return ", ".join(names) or "none"


def _field_text(point: Point, word: int) -> str:
    """`CH1 CH2 CH6 CH8 enabled`, `CH1 CH3 HOLD, CH2 CH4 CLEAR`: channels by what they are."""
    bits = point.type.channel_bits
    texts = point.texts or ({1: "on"} if bits == 1 else {})
    channels = point.channels or WORD_BITS // bits
    by_text: dict[str, list[str]] = {}
    for index in range(channels):
        value = word >> index * bits & (1 << bits) - 1
        # A bit without a text is the other state of one that has a text, and goes without saying.
        text = texts.get(value, None if bits == 1 else str(value))
        if text is not None:
            by_text.setdefault(text, []).append(f"{point.channel}{point.first_channel + index}")
    phrases = [f"{' '.join(names)} {text}" for text, names in by_text.items()]
    if not phrases:
        phrases = [f"none {' '.join(texts.values())}"]
    unassigned = word >> channels * bits << channels * bits
    if unassigned:
        phrases.append(f"unassigned bits {unassigned:04X}H")
    return ", ".join(phrases)
