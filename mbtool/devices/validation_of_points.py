"""Checks that the keys of one point of a profile do not contradict one another."""

from __future__ import annotations

import math
import re
from typing import NoReturn

from mbtool.core.errors import ProfileError
from mbtool.devices.model import WORD_BITS, Point
from mbtool.devices.point_types import PointType, WordOrder
from mbtool.devices.values import PointInstance

_WITHOUT_NUMBER = (PointType.BIT, PointType.STRING, PointType.FLOAT32, PointType.FLOAT64)
_PLACEHOLDER = re.compile(r"\{(n|reference)\}")


class PartErrors:
    """Raises ProfileError for wrong keys of one part of a profile, such as one point.

    `file` and `key` name the profile's file and the part, for messages.
    """

    def __init__(self, file: str, key: str) -> None:
        self._file = file
        self._key = key

    def wrong(self, key: str, problem: str) -> NoReturn:
        raise ProfileError(self._file, f"{self._key}.{key}", problem)


def validate_point(point: Point, errors: PartErrors) -> None:
    """Check that the keys of a point fit together. Does not compare them with the areas of the
    profile.

    Raises ProfileError for the first mistake.
    """
    if point.table.is_bits != (point.type is PointType.BIT):
        right = "bit" if point.table.is_bits else "a type of registers like uint16"
        errors.wrong("type", f"{point.type} does not fit {point.table}; {right} would be right")
    if not point.name.strip():
        errors.wrong("name", "is empty; a point is found and shown by its name")
    _validate_length(point, errors)
    if point.count > 1 and point.stride < point.words:
        errors.wrong(
            "stride", f"{point.stride} is less than the {point.words} addresses that each takes"
        )
    if point.count == 1:
        for key in ("stride", "counted_from"):
            if getattr(point, key) != 1:
                errors.wrong(key, "there is only one such point; 'count' says how many there are")
        if "{n}" in point.name:
            errors.wrong("name", "{n} counts several points; 'count' says how many there are")
    if "{" in _PLACEHOLDER.sub("", point.name):
        errors.wrong("name", "only {n} and {reference} are filled in")
    if point.count > 1 and _PLACEHOLDER.search(point.name) is None:
        errors.wrong("name", f"{point.count} points need {{n}} or {{reference}} in their name")
    if point.words == 1 and point.word_order is WordOrder.LOW_FIRST:
        errors.wrong("word_order", f"{point.type} has one register; 'byte_order' swaps its bytes")
    _validate_scale(point, errors)
    _validate_joined(point, errors)
    _validate_no_value(point, errors)
    _validate_channels(point, errors)
    _validate_bits(point, errors)
    _validate_texts(point, errors)
    _validate_range(point, errors)


def _validate_length(point: Point, errors: PartErrors) -> None:
    if point.type is not PointType.STRING:
        if point.length is not None:
            errors.wrong("length", f"only a string has a length, not {point.type}")
        return
    if point.length is None:
        errors.wrong("length", "this key is missing; it says how many registers the string takes")
    if point.word_order is WordOrder.LOW_FIRST:
        errors.wrong(
            "word_order", "the registers of a string stand in order; swap bytes by 'byte_order'"
        )


def _validate_scale(point: Point, errors: PartErrors) -> None:
    if not math.isfinite(point.scale) or point.scale == 0:
        errors.wrong("scale", f"{point.scale:g} scales nothing; 0.1 would be right for tenths")
    if not math.isfinite(point.offset):
        errors.wrong("offset", f"{point.offset} is no number to add; -50 would be one")
    if point.type.is_number:
        return
    for key, neutral in (("scale", 1), ("scale_from", None), ("offset", 0), ("decimals", None)):
        if getattr(point, key) != neutral:
            errors.wrong(key, f"only numbers have it, for example int16, not {point.type}")


def _validate_no_value(point: Point, errors: PartErrors) -> None:
    if point.no_value is None:
        return
    allowed = point.type.whole_numbers or range(1 << WORD_BITS)
    if point.type in _WITHOUT_NUMBER:
        errors.wrong("no_value", f"only whole numbers have it, for example int16, not {point.type}")
    if point.no_value not in allowed:
        errors.wrong(
            "no_value",
            f"{point.no_value} does not fit {point.type}, which holds {allowed[0]}..{allowed[-1]}",
        )


def _validate_channels(point: Point, errors: PartErrors) -> None:
    bits = point.type.channel_bits
    if point.channels is None:
        return
    if bits == 0:
        errors.wrong("channels", f"only bit-field and nibble-field have channels, not {point.type}")
    if point.channels * bits > WORD_BITS:
        errors.wrong(
            "channels", f"{point.channels} do not fit a register; {WORD_BITS // bits} at most do"
        )


def _validate_joined(point: Point, errors: PartErrors) -> None:
    if (point.units_from is None) == bool(point.units):
        errors.wrong("units", "units_from says where the number is, units what it means: give both")
    if point.units_from is not None and point.type is not PointType.UINT16:
        errors.wrong("units_from", f"only uint16 has it, not {point.type}")
    if point.after is not None and point.type is not PointType.OCTETS:
        errors.wrong("after", f"only octets have it, not {point.type}")


def _validate_bits(point: Point, errors: PartErrors) -> None:
    if point.type is not PointType.FLAGS:
        if point.bits:
            errors.wrong("bits", f"only flags have named bits, not {point.type}")
        return
    if not point.bits:
        errors.wrong("bits", 'this key is missing; name the bits, for example { 0 = "ready" }')
    for bit in point.bits:
        if not 0 <= bit < WORD_BITS:
            errors.wrong("bits", f"a register has no bit {bit}, only 0 to {WORD_BITS - 1}")


def _validate_texts(point: Point, errors: PartErrors) -> None:
    if not point.texts:
        return
    bits = 1 if point.type is PointType.BIT else point.type.channel_bits
    allowed = range(1 << bits) if bits else point.type.whole_numbers
    if point.type is PointType.HEX16:
        allowed = range(1 << WORD_BITS)
    if allowed is None:
        is_flags = point.type is PointType.FLAGS
        advice = "'bits' name them" if is_flags else "only whole numbers have them"
        errors.wrong("texts", f"{point.type} has no texts; {advice}")
    for value in point.texts:
        if value not in allowed:
            each = f"the {bits} bit of each channel" if point.type.channel_bits else point.type
            errors.wrong(
                "texts", f"{value} does not fit {each}, which holds {allowed[0]}..{allowed[-1]}"
            )


def _validate_range(point: Point, errors: PartErrors) -> None:
    low, high = point.minimum, point.maximum
    for key, end in (("minimum", low), ("maximum", high)):
        if end is not None and not math.isfinite(end):
            errors.wrong(key, f"{end} is no limit; leave the key out")
    if low is not None and high is not None and low > high:
        errors.wrong("minimum", f"{low} is more than the maximum, {high}")
    if point.default is None:
        return
    if point.type is PointType.BIT and point.default > 1:
        errors.wrong("default", f"{point.default} is no bit; 0 or 1 would be right")
    if point.words > 1:
        errors.wrong(
            "default", f"only a point of one register has a default, not the {point.words} of this"
        )
    value = PointInstance(point, point.address, "").value([point.default]).value
    if value is None and point.type is PointType.BCD16:
        errors.wrong("default", f"0x{point.default:04X} is no {point.type}")
    if value is None:
        return
    shown = point.default if value == point.default else f"{point.default}, a value of {value},"
    if low is not None and value < low:
        errors.wrong("default", f"{shown} is less than the minimum, {low}")
    if high is not None and value > high:
        errors.wrong("default", f"{shown} is more than the maximum, {high}")
