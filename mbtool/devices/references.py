"""Writes and parses addresses in the vendor's notation, such as HR400001 or X1F."""

# Without a profile, an address is written in the neutral notation: a word for the table and the
# 0-based address on the wire, as in `holding 107..109` or `coil 0`. Older documents call
# `holding 107` 40108; the word prevents confusion with a vendor's reference.
#
# An address outside all areas is written in the notation of the nearest area below it, or, if there
# is none, of the nearest area above: if the last digit is octal there, the address after M1277 is
# M1280. An area is not used if the result would be the reference of another address: if coils are 1
# to 9999 and discrete inputs 10001 to 19999, the coil at address 10000 must not be written 10001.
# If no area is left, the neutral notation is used. The two ends of a range may be in two areas with
# different notations.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.errors import UsageError
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.devices.model import Area, Profile

_NEUTRAL = {
    Table.COILS: "coil",
    Table.DISCRETE_INPUTS: "discrete",
    Table.HOLDING_REGISTERS: "holding",
    Table.INPUT_REGISTERS: "input",
}


SHORT_WORDS = {
    Table.COILS: "C",
    Table.DISCRETE_INPUTS: "DI",
    Table.HOLDING_REGISTERS: "HR",
    Table.INPUT_REGISTERS: "IR",
}
"""For each table, the letters before the address on the wire in a name that mbtool gives: HR10."""


MAX_NOTATIONS = 16_384
"""For at most so many addresses, a profile remembers the area in whose notation it is written."""


def write_reference(
    profile: Profile | None,
    table: Table,
    address: int,
    quantity: int | None = 1,
    *,
    writing: bool = False,
) -> str:
    """Write a range of addresses in the notation of its device: `HR400001..400002`, `X0..XF`;
    without a profile as `holding 107`.

    If `quantity` is 0 or None, only the address is written. If one area at an address is for
    reading and another for writing, `writing` chooses between them.
    """
    last = address + max(quantity or 1, 1) - 1
    if profile is not None:
        area = _notation(profile, table, address, writing=writing)
        end = area
        if last > address and not (area is not None and area.holds(table, last)):
            end = _notation(profile, table, last, writing=writing)
        if area is not None and end is not None:
            if area.notation == end.notation:
                return area.span(address, last)
            return f"{area.reference(address)}..{end.reference(last)}"
    word = _NEUTRAL[table]
    return f"{word} {address}..{last}" if last > address else f"{word} {address}"


def is_neutral(reference: str) -> bool:
    """True if a reference is in the neutral notation, such as `holding 107`, and not in a
    vendor's.
    """
    return reference.partition(" ")[0] in _NEUTRAL.values()


def parse_reference(profile: Profile, text: str) -> tuple[Table, int]:
    """Return the table and address of a reference, in upper or lower case: HR400001, x1f.

    Raises UsageError if no area of the profile has the reference.
    """
    wanted = text.strip().upper()
    for area in profile.areas:
        address = _address_in(area, wanted)
        if address is not None:
            return area.table, address
    spans = dict.fromkeys(area.span(area.first, area.last) for area in profile.areas)
    ranges = ", ".join(spans)
    example = profile.areas[0].reference(profile.areas[0].first) if profile.areas else "none"
    raise UsageError(
        f"reference {text!r}: {profile.name} has {ranges or 'no areas'}; "
        f"write one of them, for example {example}"
    )


def _notation(profile: Profile, table: Table, address: int, *, writing: bool) -> Area | None:
    """Return the area in whose notation to write an address; None for the neutral notation, such as
    `holding 107`.

    It is the area that contains the address. If none does, it is the nearest area whose notation
    can be extended to the address. If one area is for reading and another for writing, `writing`
    chooses between them.
    """
    notations, key = profile.notations, (table, address, writing)
    if key not in notations:
        if len(notations) >= MAX_NOTATIONS:
            notations.clear()
        notations[key] = _find_notation(profile, table, address, writing=writing)
    return notations[key]


def _find_notation(profile: Profile, table: Table, address: int, *, writing: bool) -> Area | None:
    area = profile.area(table, address, writing=writing)
    if area is not None:
        return area
    areas = [area for area in profile.areas if area.table is table]
    # Put areas that allow the access first. The sorts by distance below keep this order among areas
    # at the same distance.
    areas.sort(key=lambda area: not area.access.allows(writing=writing))
    below = sorted((area for area in areas if area.last < address), key=lambda area: -area.last)
    above = sorted((area for area in areas if area.first > address), key=lambda area: area.first)
    for area in (*below, *above):
        if area.base + address >= 0:
            reference = area.reference(address).upper()
            if all(_address_in(other, reference) is None for other in profile.areas):
                return area
    return None


def _address_in(area: Area, wanted: str) -> int | None:
    prefix, suffix = area.prefix.upper(), area.suffix.upper()
    if not (wanted.startswith(prefix) and wanted.endswith(suffix)):
        return None
    digits = wanted[len(prefix) : len(wanted) - len(suffix)]
    # No reference has more than 8 digits, and int() of thousands of digits would be slow.
    if len(digits) > 8:
        return None
    try:
        address = area.radix.read(digits) - area.base
    except ValueError:
        return None
    return address if area.first <= address <= area.last else None
