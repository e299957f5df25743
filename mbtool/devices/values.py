"""Decodes the registers or the bit of a point into a number and a text, and encodes numbers."""

# Registers come in the order of their addresses. Where a point's keys say so, the two bytes of each
# register are swapped (`byte_order`) and then the registers reversed (`word_order`). The result is
# big-endian.
#
# value = number * scale + offset is computed in decimal, so that 3 * 0.1 is 0.3 and 64-bit numbers
# keep all digits. If a register of the device holds the scale as a power of ten (scale_from), a
# point has no value until scaled_by() gets the power.
#
# Strings are UTF-8, which includes ASCII; other bytes are shown as \xNN. NULs and spaces at the end
# of a string are padding.

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Literal

from msgspec.structs import replace

from mbtool.core.errors import UsageError
from mbtool.devices.model import WORD_BITS, Access, Point, Profile
from mbtool.devices.named_transaction import PointValue
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.devices.references import write_reference

if TYPE_CHECKING:
    from mbtool.modbus.tables import Table

_MAX_CACHED = 256
_BIT_TEXTS = {0: "off", 1: "on"}
NO_VALUE = "no value"

# The number of significant digits to show: a 32-bit float has 7, a 64-bit float at least 15.
_FLOAT32_DIGITS = 7
_DIGITS = 15


class PointInstance:
    """Decodes the values of one point.

    A Point of a profile can stand for a series of `count` points; this is one of the series.
    """

    # The values of a point often repeat, so each instance caches at most _MAX_CACHED decoded
    # values. For a plain number (one register, no scale, no texts), decoding is nearly as fast as a
    # cache. So only its last value is cached, which helps while the value does not change.

    __slots__ = (
        "_by_power",
        "_cache",
        "_is_plain",
        "_last",
        "_last_word",
        "_point",
        "_ratio",
        "_signed",
        "_suffix",
        "_unit",
        "address",
        "block",
        "name",
        "reference",
        "scale_from",
        "words",
    )

    def __init__(self, point: Point, address: int, reference: str) -> None:
        self._point = point
        self._cache: dict[int | tuple[int, ...], PointValue] = {}
        self._last: PointValue | None = None
        self._last_word = 0
        self._by_power: dict[int, PointInstance] = {}
        is_number = _is_number_of_one_register(point)
        self._ratio = _ratio(point) if is_number else None
        self._is_plain = is_number and self._ratio is None
        self._signed = point.type is PointType.INT16
        self._unit = point.unit
        self._suffix = f" {point.unit}" if point.unit else ""
        self.address = address
        self.words = point.words
        self.block = point.block
        self.scale_from = point.scale_from
        self.reference = reference
        number = point.counted_from + (address - point.address) // point.stride
        self.name = point.name.replace("{n}", str(number)).replace("{reference}", reference)

    def scaled_by(self, power: int | None) -> PointInstance:
        """Return the point with a fixed scale: its own scale times 10 to the power of `power`.

        `power` is the number in the register that `scale_from` names. If it is None, because it is
        unknown or there is no such register, the point is returned unchanged.
        """
        if power is None:
            return self
        scaled = self._by_power.get(power)
        if scaled is None:
            scale = float(Decimal(str(self._point.scale)).scaleb(power))
            point = replace(self._point, scale=scale, scale_from=None)
            scaled = self._by_power[power] = PointInstance(point, self.address, self.reference)
        return scaled

    def value(self, raw: Sequence[int]) -> PointValue:
        """Decode `raw`: the registers of this point, or its bit."""
        return point_values([(0, self)], raw)[0]

    def _value_in(self, values: Sequence[int], index: int) -> PointValue:
        key = values[index] if self.words == 1 else tuple(values[index : index + self.words])
        cached = self._cache.get(key)
        if cached is not None:
            return cached
        if self._ratio is not None and isinstance(key, int):
            value = self._decode_scaled(key, self._ratio)
        else:
            value = self._decode((key,) if isinstance(key, int) else key)
        if len(self._cache) >= _MAX_CACHED:
            self._cache.clear()
        self._cache[key] = value
        return value

    def _decode_scaled(self, word: int, ratio: tuple[int, int, int]) -> PointValue:
        """Decode a scaled number from the register `word`. For such points, this is faster than
        `_decode`.

        `ratio` has three integers (a, b, c) for value = (number * a + b) / c.
        """
        factor, summand, divisor = ratio
        number = word - 0x10000 if self._signed and word & 0x8000 else word
        # Divide integers only at the end: that rounds once, and is as exact as decimal numbers.
        scaled = (number * factor + summand) / divisor
        return PointValue(
            name=self.name,
            reference=self.reference,
            value=scaled,
            text=f"{scaled:.{_DIGITS}g}{self._suffix}",
            unit=self._unit,
        )

    def _decode(self, raw: tuple[int, ...]) -> PointValue:
        number = _number(self._point, raw)
        return PointValue(
            name=self.name,
            reference=self.reference,
            value=_scaled(self._point, number),
            text=_text(self._point, raw, number),
            unit=self._unit,
        )


def point_values(
    points: Iterable[tuple[int, PointInstance]], values: Sequence[int]
) -> list[PointValue]:
    """Decode points from `values`, the registers or bits of a request or response.

    `points` has each point with the index in `values` at which it begins. Points that are not
    completely in `values` are left out, because a response can be too short.
    """
    count = len(values)
    decoded = []
    for index, point in points:
        if index + point.words > count:
            continue
        if not point._is_plain:
            decoded.append(point._value_in(values, index))
            continue
        # Decode a plain number (one register, no scale, no texts) here, without a function call,
        # because most values that change often are plain numbers.
        word = values[index]
        last = point._last
        if last is None or word != point._last_word:
            number = word - 0x10000 if point._signed and word & 0x8000 else word
            point._last_word = word
            last = point._last = PointValue(
                name=point.name,
                reference=point.reference,
                value=number,
                text=f"{number}{point._suffix}",
                unit=point._unit,
            )
        decoded.append(last)
    return decoded


def point_instances(
    profile: Profile, table: Table, *, writing: bool = False
) -> list[PointInstance]:
    """Return the points of a table that a read can contain (a write if `writing`), sorted by
    address.

    A read has no points that can only be written. A write has a point that can only be read, if no
    writable point has its address: a master may try to write it. A write has no points in blocks
    (registers that are only read, from the block's first address on).
    """
    points = [point for point in profile.points if point.table is table]
    if writing:
        points = [point for point in points if point.block is None]
    else:
        points = [point for point in points if point.access is not Access.WRITE]
    points.sort(key=lambda point: not point.allows(writing=writing))
    instances: list[PointInstance] = []
    taken: set[tuple[int | None, int]] = set()
    for point in points:
        for address in point.addresses:
            words = [(point.block, word) for word in range(address, address + point.words)]
            if taken.isdisjoint(words):
                taken.update(words)
                reference = write_reference(profile, table, address, point.words, writing=writing)
                instances.append(PointInstance(point, address, reference))
    return sorted(instances, key=lambda instance: instance.address)


def registers_of(point: Point, value: float | str) -> list[int]:
    """Encode a value into registers or a bit: the inverse of PointInstance.value.

    `value` is in the unit of the point, after scale and offset. For a string it is the text; for
    other types, it can be one of the point's texts. Raises UsageError if the point's type cannot
    hold the value, or if a register of the device holds the scale.
    """
    if point.scale_from is not None:
        raise UsageError(
            f"the device holds the scale of {point.name} in {point.scale_from}; give the number of "
            f"its register, at '{_table_word(point)} {point.address}'"
        )
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


def _table_word(point: Point) -> str:
    return point.table.value.partition("_")[0]


def _is_number_of_one_register(point: Point) -> bool:
    return (
        point.type in (PointType.UINT16, PointType.INT16)
        and point.byte_order is ByteOrder.HIGH_FIRST
        and not point.texts
        and point.decimals is None
        and point.scale_from is None
        and point.no_value is None
    )


def _ratio(point: Point) -> tuple[int, int, int] | None:
    """Return three integers (a, b, c) with which value = (number * a + b) / c, where `number` is
    the one in the register; None if value = number.
    """
    if point.scale == 1 and point.offset == 0:
        return None
    scale, offset = (Fraction(Decimal(str(one))) for one in (point.scale, point.offset))
    divisor = math.lcm(scale.denominator, offset.denominator)
    return int(scale * divisor), int(offset * divisor), divisor


def _number(point: Point, raw: Sequence[int]) -> float | None:
    """Return the number in the registers `raw`, before scale and offset. None if they hold no
    number: a string, or digits that are not BCD.
    """
    if point.type is PointType.BIT:
        return raw[0]
    return point.type.number(_bytes(point, raw))


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
    if point.scale_from is not None or number == point.no_value:
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
    if point.type.is_float:
        try:
            return struct.pack(f">{point.type.struct_code}", number)
        except OverflowError:
            raise UsageError(f"{value} is too large for {point.type}") from None
    allowed = point.type.whole_numbers or range(1 << WORD_BITS)
    if not math.isfinite(number) or number != int(number) or int(number) not in allowed:
        low, high = (_scaled(point, end) for end in (allowed[0], allowed[-1]))
        raise UsageError(f"{value} does not fit {point.type}, which holds {low}..{high}")
    number = int(number)
    if point.type.is_bcd:
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
    if number == point.no_value:
        return NO_VALUE
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
        return f"{number} x 10^{point.scale_from}" if point.scale_from else str(number)
    if point.decimals is not None:
        return f"{scaled:z.{point.decimals}f}"  # `z` writes 0.00, not -0.00.
    if isinstance(scaled, int):
        return str(scaled)
    return f"{scaled:.{_FLOAT32_DIGITS if point.type is PointType.FLOAT32 else _DIGITS}g}"


def _string(data: bytes) -> str:
    text = data.rstrip(b"\0 ").decode(errors="backslashreplace")
    shown = "".join(one if one.isprintable() else f"\\x{ord(one):02x}" for one in text)
    return shown or "(empty)"


def _flags_text(point: Point, word: int) -> str:
    """The names of the bits of a register that are 1: `READY, ALARM`."""
    names = [name for bit, name in sorted(point.bits.items()) if word >> bit & 1]
    unnamed = word & ~sum(1 << bit for bit in point.bits)
    if unnamed:
        names.append(f"unassigned bits {unnamed:04X}H")
    return ", ".join(names) or "none"


def _field_text(point: Point, word: int) -> str:
    """Return the text for a register with one or four bits for each channel. Channels whose bits
    have the same meaning stand together.

    Examples: `CH1 CH2 CH6 enabled`, `CH1 HOLD, CH2 CLEAR`.
    """
    bits = point.type.channel_bits
    texts = point.texts or ({1: "on"} if bits == 1 else {})
    channels = point.channels or WORD_BITS // bits
    by_text: dict[str, list[str]] = {}
    for index in range(channels):
        value = word >> index * bits & (1 << bits) - 1
        # If each channel has one bit, and only one of its two values has a text, leave out the
        # channels with the other value.
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
