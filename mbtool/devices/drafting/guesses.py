"""Guesses the types of registers from sampled values, with a reason for each guess."""

# The user can judge each guess by its reason. The types are tried in this order:
#
#   string        at least _MIN_TEXT_WORDS registers with printable ASCII characters, mostly letters
#                 and digits, that never change
#   float32       two registers whose values as floats, in one word order, are all 0 or within
#                 MAGNITUDES; in addition, the floats have few decimal digits (32 random bits have
#                 them in 1 of 500 cases), or the low word changes much more often than the high
#                 one, or a request asks for just these two, or they follow another float32
#   32 bits       one register goes up by one when the other starts again from a lower value; or a
#                 request asks for just these two registers
#   int16         values near 0 and near FFFFH
#   uint16        everything else; this is not a guess, and the reason gives the sampled values

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from mbtool.devices.point_types import PointType, WordOrder
from mbtool.modbus.functions import READ_LIMIT

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from mbtool.devices.observed_slave import Samples

MAGNITUDES = (1e-4, 1e8)
"""A measurement, except 0, usually has an absolute value from the first number up to the second. If
two registers, read as a float, have another value, they are probably no float."""
_FEW_DIGITS = 5
_MIN_TEXT_WORDS = 4
_NEAR_ZERO = 0x1000
_MAX_LISTED = 6
_UNAVAILABLE = (0x7FFF, 0x8000, 0xFFFF)
"""Numbers in a register that often mean "no value"."""


@dataclass(frozen=True, slots=True)
class Guess:
    """A guess of the type of the value that begins at `address`."""

    address: int
    type: PointType
    reason: str
    word_order: WordOrder = WordOrder.HIGH_FIRST
    length: int | None = None
    """The length of a string in registers; None for other types."""

    @property
    def words(self) -> int:
        return self.length or self.type.words

    def is_float(self, order: WordOrder) -> bool:
        return self.type is PointType.FLOAT32 and self.word_order is order


def guess_registers(
    first: int, samples: Samples, pairs: Collection[int], plural: str = "answers"
) -> list[Guess]:
    """Guess the types of all registers of a range that begins at the address `first`.

    `samples` has observed values of these registers. `pairs` are the addresses from which some
    request asked for exactly two registers. `plural` says in the reasons where the values come
    from: "answers" or "writes".
    """
    columns = list(zip(*samples.rows, strict=False))
    guesses: list[Guess] = []
    at = 0
    while at < len(columns):
        before = guesses[-1] if guesses else None
        guess = (
            _text(first, columns, at, samples)
            or _pair(first, columns, at, pairs, before)
            or _single(first, columns, at, samples, plural)
        )
        guesses.append(guess)
        at += guess.words
    return guesses


def _text(first: int, columns: Sequence[Sequence[int]], at: int, samples: Samples) -> Guess | None:
    end = at
    while end < len(columns) and not samples.changes[end] and _is_letters(columns[end][0]):
        end += 1
    if end - at < _MIN_TEXT_WORDS:
        return None
    data = b"".join(columns[index][0].to_bytes(2) for index in range(at, end))
    letters = sum(chr(byte).isalnum() for byte in data)
    if letters * 10 < len(data) * 6:
        return None
    # Zeros or spaces in the registers after a text are padding, so these registers belong to the
    # string.
    while end < len(columns) and not samples.changes[end] and columns[end][0] in (0, 0x2020):
        end += 1
    words = min(end - at, READ_LIMIT)
    text = data.rstrip(b"\x00 ").decode("ascii")
    return Guess(first + at, PointType.STRING, f'the text "{text}"', length=words)


def _is_letters(word: int) -> bool:
    high, low = divmod(word, 256)
    return 0x20 <= high < 0x7F and (0x20 <= low < 0x7F or low == 0)


def _pair(
    first: int,
    columns: Sequence[Sequence[int]],
    at: int,
    pairs: Collection[int],
    before: Guess | None,
) -> Guess | None:
    if at + 1 >= len(columns):
        return None
    is_alone = first + at in pairs
    as_read = list(zip(columns[at], columns[at + 1], strict=True))
    swapped = [(low, high) for high, low in as_read]
    in_order = {WordOrder.HIGH_FIRST: as_read, WordOrder.LOW_FIRST: swapped}
    for order, values in in_order.items():
        is_beside = before is not None and before.is_float(order)
        reason = _float_reason(values, is_alone=is_alone, is_beside=is_beside)
        if reason is not None:
            return Guess(first + at, PointType.FLOAT32, reason, order)
    for order, values in in_order.items():
        if _carries(values):
            reason = "one register goes up by one when the other starts again"
            return Guess(first + at, PointType.UINT32, reason, order)
    return _requested_alone(first + at, as_read) if is_alone else None


def _float_reason(
    pairs: Sequence[tuple[int, int]], *, is_alone: bool, is_beside: bool
) -> str | None:
    """Return the reason, for a comment, to guess that two registers hold a 32-bit float; None if
    there is no reason.

    `pairs` has the observed values of the two registers, as (high word, low word). `is_alone` is
    True if a request asked for just these two registers; `is_beside` is True if another float comes
    right before them.
    """
    values = [_float(*pair) for pair in pairs]
    low, high = MAGNITUDES
    nonzero = [value for value in values if value != 0]
    if not nonzero or not all(math.isfinite(one) and low <= abs(one) < high for one in nonzero):
        return None
    span = (
        f"{min(values):.5g}" if len(set(values)) == 1 else f"{min(values):.5g} to {max(values):.5g}"
    )
    if all(_has_few_digits(value) for value in nonzero):
        return f"as a float {span}, of few digits"
    highs, lows = ({pair[index] for pair in pairs} for index in (0, 1))
    if len(lows) >= 4 and 2 * len(highs) <= len(lows):
        return f"as a float {span}; the low word changes more often than the high one"
    if is_alone:
        return f"asked for as two registers; as a float {span}"
    return f"as a float {span}, beside another float" if is_beside else None


def _float(high: int, low: int) -> float:
    (value,) = struct.unpack(">f", struct.pack(">HH", high & 0xFFFF, low & 0xFFFF))
    return float(value)


def _has_few_digits(value: float) -> bool:
    try:
        return struct.pack(">f", float(f"{value:.{_FEW_DIGITS}g}")) == struct.pack(">f", value)
    except OverflowError:
        return False


def _carries(pairs: Sequence[tuple[int, int]]) -> bool:
    """True if two registers look like a 32-bit counter; `pairs` has their observed values as (high
    word, low word), in the order of time.

    That is so if the high word goes up by one exactly when the low word goes down, and does so at
    least once.
    """
    carries = 0
    for (high, low), (next_high, next_low) in pairwise(pairs):
        if next_high == high:
            if next_low < low:
                return False
        elif next_high == high + 1 and next_low < low:
            carries += 1
        else:
            return False
    return carries > 0


def _requested_alone(address: int, pairs: Sequence[tuple[int, int]]) -> Guess:
    firsts, seconds = ({pair[index] for pair in pairs} for index in (0, 1))
    if firsts == seconds == {0}:
        return Guess(address, PointType.UINT32, "asked for as two registers, always 0")
    reason = "asked for as two registers"
    if firsts <= {0, 0xFFFF} and seconds - {0}:
        type_ = PointType.INT32 if 0xFFFF in firsts else PointType.UINT32
        return Guess(address, type_, f"{reason}, the first of them {_listed(firsts)}")
    if seconds <= {0, 0xFFFF} and firsts - {0}:
        type_ = PointType.INT32 if 0xFFFF in seconds else PointType.UINT32
        reason += f", the second of them {_listed(seconds)}"
        return Guess(address, type_, reason, WordOrder.LOW_FIRST)
    high, low = pairs[-1]
    reason += f": last {high << 16 | low}, or low word first {low << 16 | high}"
    return Guess(address, PointType.UINT32, reason)


def _single(
    first: int, columns: Sequence[Sequence[int]], at: int, samples: Samples, plural: str
) -> Guess:
    column = columns[at]
    values = set(column)
    if _crosses_zero(values):
        signed = [value - 0x10000 if value & 0x8000 else value for value in values]
        reason = f"{min(signed)} to {max(signed)}: goes below zero"
        return Guess(first + at, PointType.INT16, reason)
    if not samples.changes[at]:
        reason = f"{column[0]} in all {samples.count} {plural}"
        if samples.count == 1:
            reason = f"{column[0]} in the only one of the {plural}"
        if column[0] in _UNAVAILABLE:
            reason += f" ({column[0]:04X}H, which often says that there is no value)"
    elif len(values) <= _MAX_LISTED:
        reason = f"{_listed(values)} in {samples.count} {plural}"
    elif all(one <= two for one, two in pairwise(column)):
        reason = f"{column[0]} to {column[-1]} in {samples.count} {plural}: counts up"
    else:
        reason = f"{min(values)} to {max(values)} in {samples.count} {plural}"
    return Guess(first + at, PointType.UINT16, reason)


def _crosses_zero(values: Collection[int]) -> bool:
    """True if 16-bit values, read as signed, are both small positive and small negative numbers.

    FFFFH does not count as -1, because it may mean that there is no value.
    """
    near, far = _NEAR_ZERO, 0x10000 - _NEAR_ZERO
    return (
        any(value < near for value in values)
        and any(far <= value < 0xFFFF for value in values)
        and all(value < 2 * near or value >= far - near for value in values)
    )


def _listed(values: Collection[int]) -> str:
    return ", ".join(map(str, sorted(values)))
