"""Parses ranges of registers or bits: `HR400010..400020`, `holding 7..9`."""

# A range is in the notation of one of the profiles, or in the neutral notation (references.py): a
# word for the table, or a short form of it (`hr 16`), and an address. The address is decimal, or
# hexadecimal as in `0x10`. The last address of a range may lack its prefix: `D16..17` is
# `D16..D17`.

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core.errors import UsageError
from mbtool.devices.references import parse_reference, write_reference
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.devices.model import Profile

_NEUTRAL = {write_reference(None, table, 0).split()[0]: table for table in Table}
_SHORT = {
    "co": Table.COILS,
    "di": Table.DISCRETE_INPUTS,
    "hr": Table.HOLDING_REGISTERS,
    "ir": Table.INPUT_REGISTERS,
}
"""Short words for the tables. A space or a colon must follow such a word, because `HR1` may be a
vendor's reference."""
_NUMBER = r"(\d{1,5}|0x[0-9a-f]{1,4})"
_FIVE_DIGITS = re.compile(r"[0134]\d{4}(?:\.\.[0134]?\d{1,4})?")
_NEUTRAL_SPAN = re.compile(
    rf"(?:({'|'.join(_NEUTRAL)})[ :]?|({'|'.join(_SHORT)})[ :]){_NUMBER}(?:\.\.{_NUMBER})?",
    re.ASCII,
)
_LAST_ADDRESS = 0xFFFF


@dataclass(frozen=True, slots=True)
class Span:
    """A range of addresses in one table, from `first` to `last`, both included."""

    table: Table
    first: int
    last: int

    def __contains__(self, address: int) -> bool:
        return self.first <= address <= self.last


def parse_span(text: str, profiles: Iterable[Profile] = ()) -> Span:
    """Parse a reference or a range: `HR400010..400020` as one of the profiles writes it, or
    `holding 7..9`.

    Raises UsageError if the text is neither, or a range ends before it begins or after 65535.
    """
    span = find_span(text, profiles)
    if span is not None:
        return span
    raise UsageError(
        f"{text!r} is no range of registers; write 'holding 10..20' (or coil, discrete, input), or "
        f"HR400010..400020 as the device's manual does, with --device"
    )


def find_span(text: str, profiles: Iterable[Profile] = ()) -> Span | None:
    """Parse a reference or a range, as `parse_span` does; None if the text is neither.

    Raises UsageError for a range that ends before it begins or after 65535, and for a number of
    five digits, because vendors mean different registers by it.
    """
    neutral = _NEUTRAL_SPAN.fullmatch(text.strip().lower())
    if neutral is not None:
        word, short, first, last = neutral.groups()
        table = _NEUTRAL[word] if word else _SHORT[short]
        return _span(text, table, _number(first), _number(last or first))
    for profile in profiles:
        span = _in_notation(text, profile)
        if span is not None:
            return span
    if _FIVE_DIGITS.fullmatch(text.strip()):
        raise UsageError(
            f"{text!r}: vendors mean different registers by five digits; write 'holding 0' (from "
            "0, as on the wire), or six digits: 400001"
        )
    return None


def names_table(text: str) -> bool:
    """True if a text begins with a word for a table, such as `holding` or `hr`."""
    word = text.strip().lower().partition(" ")[0]
    return word in _NEUTRAL or word in _SHORT


def _in_notation(text: str, profile: Profile) -> Span | None:
    begin, dots, end = text.strip().partition("..")
    try:
        table, first = parse_reference(profile, begin)
        if not dots:
            return Span(table, first, first)
    except UsageError:
        return None
    area = profile.area(table, first)
    spellings = (end, f"{area.prefix}{end}{area.suffix}", f"{area.prefix}{end}") if area else (end,)
    for spelling in spellings:
        try:
            other, last = parse_reference(profile, spelling)
        except UsageError:
            continue
        if other is table:
            return _span(text, table, first, last)
    return None


def _number(digits: str) -> int:
    return int(digits, 16 if digits.startswith("0x") else 10)


def _span(text: str, table: Table, first: int, last: int) -> Span:
    if not first <= last <= _LAST_ADDRESS:
        raise UsageError(f"{text!r}: a range runs from the lower to the higher, up to 65535")
    return Span(table, first, last)
