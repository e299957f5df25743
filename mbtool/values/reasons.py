"""Says what a number is to the device, and why its registers are taken for it."""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from enum import StrEnum
from itertools import pairwise

from mbtool.devices.point_types import PointType
from mbtool.values.number_costs import few_decimals
from mbtool.values.word_readings import WordReading, numbers_in

_MAX_LISTED = 6
"""A reason lists the values of a series if they are at most this many different ones."""
_MOST_STATES = 12
"""A series is called a state only if it has at most this many different numbers."""
_FEWEST_CHANGES = 3
"""A series with fewer changes than this is called a measurement."""
_UNAVAILABLE = (0x7FFF, 0x8000, 0xFFFF)
"""Numbers in a register that often mean "no value"."""
_SECOND_NS = 1_000_000_000
_CLOCK_ERROR_S = 5
"""A series is the seconds since 1970 only if its distance from the recording's time varies by less
than this (s)."""
_DAY_S = 86_400
_NAMES = {2: "two", 4: "four"}


class ValueRole(StrEnum):
    """What a value is to the device, by how it changes."""

    CONSTANT = "constant"
    MEASUREMENT = "measurement"
    COUNTER = "counter"
    STATE = "state"
    """One of a few numbers, from which it jumps to another."""
    FLAGS = "flags"
    """Bits that change one by one."""
    CLOCK = "clock"
    """The seconds since 1970."""
    TEXT = "text"


def role_of(numbers: Sequence[float], times_ns: Sequence[int], reading: WordReading) -> ValueRole:
    """Tell what a value is, from its numbers over time."""
    changes = [(before, now) for before, now in pairwise(numbers) if now != before]
    is_whole = not reading.type.is_float
    if is_whole and reading.words == 2 and is_clock(numbers, times_ns):
        return ValueRole.CLOCK
    if not changes:
        return ValueRole.CONSTANT
    if len(changes) < _FEWEST_CHANGES:
        return ValueRole.MEASUREMENT
    if all(now > before for before, now in changes):
        return ValueRole.COUNTER
    if reading.type is PointType.HEX16:
        return ValueRole.FLAGS
    if not is_whole or reading.words > 1 or min(numbers) < 0:
        return ValueRole.MEASUREMENT
    sizes = [abs(now - before) for before, now in changes]
    few = len(set(numbers)) <= _MOST_STATES and len(changes) * 2 < len(numbers)
    if few and max(numbers) < 256 and max(sizes) > 1:
        return ValueRole.STATE
    return ValueRole.MEASUREMENT


def is_clock(numbers: Sequence[float], times_ns: Sequence[int]) -> bool:
    """True if the numbers are the seconds since 1970, by the recording's own time."""
    if not times_ns or times_ns[0] < 365 * _DAY_S * _SECOND_NS:
        return False
    off = [number - at_ns / _SECOND_NS for number, at_ns in zip(numbers, times_ns, strict=False)]
    return max(map(abs, off)) < _DAY_S and max(off) - min(off) < _CLOCK_ERROR_S


def reason_for(
    reading: WordReading,
    columns: Sequence[Sequence[int]],
    numbers: Sequence[float],
    role: ValueRole,
    *,
    is_alone: bool,
    is_beside: bool,
    is_written: bool,
    count: int,
) -> str:
    """Say in a sentence why registers are taken for a value.

    `columns` has the words of each register over time, `numbers` the numbers that they make.
    `is_alone` is True if a request asked for just these; `is_beside` if the value before them is
    read in the same way. `count` is the number of answers, or of writes if `is_written`.
    """
    if reading.type is PointType.STRING:
        return f'the text "{text_of([column[0] for column in columns])}"'
    if reading.words == 1:
        return _word_reason(reading, columns[0], numbers, role, _answers(count, is_written))
    phrases = []
    if role is ValueRole.CLOCK:
        phrases.append("the seconds since 1970 by the recording's own time")
    elif reading.type.is_float:
        few = few_decimals(numbers, 16 * reading.words) is not None
        phrases.append(f"as a float {span_of(numbers)}" + (", of few digits" if few else ""))
        if not few and _moves_more(columns, reading):
            phrases.append("the low word changes more often than the high one")
    else:
        whole = "in decimal digits " if reading.type is PointType.BCD32 else ""
        counts = ": counts up" if role is ValueRole.COUNTER else ""
        phrases.append(f"as one number {whole}{span_of(numbers)}{counts}")
        phrases += _carries(columns, reading)
    if is_alone:
        phrases.append(f"asked for as {_NAMES[reading.words]} registers")
    if is_beside:
        phrases.append("beside another of the same kind")
    if reading.order.is_low_first or reading.order.is_swapped:
        phrases.append(f"bytes in the order {reading.order}")
    return "; ".join(phrases)


def _answers(count: int, is_written: bool) -> str:
    return f"{count} {'writes' if is_written else 'answers'}"


def _word_reason(
    reading: WordReading,
    column: Sequence[int],
    numbers: Sequence[float],
    role: ValueRole,
    answers: str,
) -> str:
    if reading.type is PointType.INT16:
        crosses = " goes below zero" if max(numbers) >= 0 else " always below zero"
        return f"{span_of(numbers)}:{crosses}"
    if reading.type is PointType.BCD16:
        return f"{span_of(numbers)} in decimal digits of four bits each"
    if role is ValueRole.CONSTANT:
        reason = f"{column[0]} in all {answers}"
        if answers.startswith("1 "):
            reason = f"{column[0]} in the only one of the {answers[2:]}"
        if column[0] in _UNAVAILABLE:
            reason += f" ({column[0]:04X}H, which often says that there is no value)"
        return reason
    values = set(column)
    if role is ValueRole.FLAGS:
        union = 0
        for word in values:
            union |= word ^ column[0]
        bits = ", ".join(str(bit) for bit in range(16) if union >> bit & 1)
        return f"bits {bits} change one by one in {answers}"
    if role is ValueRole.STATE:
        return f"{_listed(values)} in {answers}: a state"
    if len(values) <= _MAX_LISTED:
        return f"{_listed(values)} in {answers}"
    if all(one <= two for one, two in pairwise(column)):
        return f"{column[0]} to {column[-1]} in {answers}: counts up"
    return f"{min(values)} to {max(values)} in {answers}"


def text_of(words: Sequence[int]) -> str:
    """The text in registers, two characters in each, without its padding."""
    data = struct.pack(f">{len(words)}H", *words).rstrip(b"\x00 ")
    return data.decode("ascii", "backslashreplace")


def span_of(numbers: Sequence[float]) -> str:
    """The least and the greatest of some numbers."""
    low, high = min(numbers), max(numbers)
    if isinstance(low, int):
        return f"{low}" if low == high else f"{low} to {high}"
    return f"{low:.5g}" if low == high else f"{low:.5g} to {high:.5g}"


def _moves_more(columns: Sequence[Sequence[int]], reading: WordReading) -> bool:
    high, low = (
        (columns[-1], columns[0]) if reading.order.is_low_first else (columns[0], columns[-1])
    )
    return len(set(low)) >= 4 and 2 * len(set(high)) <= len(set(low))


def _carries(columns: Sequence[Sequence[int]], reading: WordReading) -> list[str]:
    """Say what ties the registers of one whole number together."""
    in_order = columns[::-1] if reading.order.is_low_first else columns
    tops = in_order[0]
    which = "last" if reading.order.is_low_first else "first"
    signs = {0, 0xFFFF}
    if set(tops) <= signs and 0xFFFF in tops:
        return [f"the {which} register is 0 or FFFFH, as the sign of the others"]
    numbers = numbers_in(columns, reading) or ()
    carries = sum(
        before_top != top and abs(now - before) < 1 << (16 * reading.words - 16)
        for (before_top, top), (before, now) in zip(pairwise(tops), pairwise(numbers), strict=True)
    )
    if carries:
        return ["one register goes up or down by one when the other starts again"]
    return []


def _listed(values: Collection[int]) -> str:
    return ", ".join(map(str, sorted(values)))
