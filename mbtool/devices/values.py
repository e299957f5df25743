"""The value of a point, from its registers or bits, as a number and in the manual's words."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from mbtool.devices.model import WORD_BITS, Point, PointType, WordOrder
from mbtool.devices.named import PointValue

if TYPE_CHECKING:
    from collections.abc import Sequence

_MAX_REMEMBERED = 256
_BIT_TEXTS = {0: "off", 1: "on"}


class Place:
    """One named place of a device: one of the `count` that a point stands for."""

    # Most values are seen again and again, so each place remembers the last ones it has put into
    # words: at most _MAX_REMEMBERED.

    __slots__ = ("_point", "_remembered", "address", "name", "reference", "words")

    def __init__(self, point: Point, address: int, reference: str) -> None:
        self._point = point
        self._remembered: dict[tuple[int, ...], PointValue] = {}
        self.address = address
        self.words = point.type.words
        self.reference = reference
        number = point.counted_from + (address - point.address) // point.stride
        self.name = point.name.replace("{n}", str(number)).replace("{reference}", reference)

    def value(self, raw: Sequence[int]) -> PointValue:
        """Put the registers or the bit of this place into words."""
        key = tuple(raw)
        known = self._remembered.get(key)
        if known is not None:
            return known
        number = _number(self._point, key)
        finite = math.isfinite(number)
        value = PointValue(
            name=self.name,
            reference=self.reference,
            value=_scaled(self._point, number) if finite else None,
            text=_text(self._point, number),
            unit=self._point.unit,
        )
        if len(self._remembered) >= _MAX_REMEMBERED:
            self._remembered.clear()
        self._remembered[key] = value
        return value


def _number(point: Point, raw: Sequence[int]) -> float:
    if point.type.words == 2:
        high, low = raw if point.word_order is WordOrder.HIGH_FIRST else reversed(raw)
        form = {PointType.UINT32: ">I", PointType.INT32: ">i"}.get(point.type, ">f")
        (number,) = struct.unpack(form, struct.pack(">HH", high & 0xFFFF, low & 0xFFFF))
        return float(number) if form == ">f" else int(number)
    word = raw[0]
    return word - 0x10000 if point.type is PointType.INT16 and word & 0x8000 else word


def _scaled(point: Point, number: float) -> float:
    # Twelve digits keep 32 bits whole and drop what a scale's binary fraction adds (0.1 x 3).
    return number if point.scale == 1 else float(f"{number * point.scale:.12g}")


def _text(point: Point, number: float) -> str:
    match point.type:
        case PointType.BIT:
            texts = point.texts or _BIT_TEXTS
            return texts.get(int(number), str(number))
        case PointType.BIT_FIELD | PointType.NIBBLE_FIELD:
            return _field_text(point, int(number))
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
    scaled = _scaled(point, number) if math.isfinite(number) else number
    if isinstance(scaled, int):
        return str(scaled)
    # A 32-bit float has seven significant digits.
    return f"{scaled:.7g}" if point.type is PointType.FLOAT32 else f"{scaled:.12g}"


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
