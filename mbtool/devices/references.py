"""Addresses in the vendor's notation, both ways."""

# Where no profile tells, an address is written as it stands on the wire, 0-based, behind the
# field's word for its table: `holding 107..109`, `coil 0`. So `holding 107` is what older documents
# call 40108, and no vendor's reference can be mistaken for it.
#
# An address outside the areas goes on in the notation of the one that ends nearest below it, else
# of one above: behind M1277 comes M1280. But no reference is made that stands for another address
# (where coils are 1 to 9999, the one at 10000 is not 10001, a discrete input); then the next area
# counts, and where none is left, the neutral way. A range has the notations of both its ends.

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


def write_reference(
    profile: Profile | None,
    table: Table,
    address: int,
    quantity: int | None = 1,
    *,
    writing: bool = False,
) -> str:
    """A range in the notation of its device: `HR400001..400002`, `X0..XF`, `holding 107..109`.

    A quantity of 0 or None is written as the address alone. `writing` chooses between two areas at
    one address, of which one is read and the other written.
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
    """Whether it names its table itself, since no vendor's notation fits: `holding 107`."""
    return reference.partition(" ")[0] in _NEUTRAL.values()


def parse_reference(profile: Profile, text: str) -> tuple[Table, int]:
    """The table and address of one reference, in any case: `HR400001`, `x1f`. Raises UsageError."""
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
    """The area that an address lies in, else one whose notation can go on to it."""
    area = profile.area(table, address, writing=writing)
    if area is not None:
        return area
    there = [area for area in profile.areas if area.table is table]
    # Of areas that end alike, the one for what is asked.
    there.sort(key=lambda area: not area.access.allows(writing=writing))
    below = sorted((area for area in there if area.last < address), key=lambda area: -area.last)
    above = sorted((area for area in there if area.first > address), key=lambda area: area.first)
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
    # No reference has more digits; int() of thousands of them would be slow.
    if len(digits) > 8:
        return None
    try:
        address = area.radix.read(digits) - area.base
    except ValueError:
        return None
    return address if area.first <= address <= area.last else None
