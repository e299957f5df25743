"""Addresses in the vendor's notation, both ways."""

# Where no profile tells, an address is written as it stands on the wire, 0-based, behind the
# field's word for its table: `holding 107..109`, `coil 0`. So `holding 107` is what older documents
# call 40108, and no vendor's reference can be mistaken for it.
#
# A range that leaves its area keeps the vendor's notation if it ends in an area of the same one, or
# if the table has only one; else nothing says which would be meant, and it is written the neutral
# way.

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
        area = profile.area(table, address, last - address + 1, writing=writing)
        area = area or _shared_notation(profile, table, (address, last), writing=writing)
        if area is not None and area.base + address >= 0:
            return area.span(address, last)
    word = _NEUTRAL[table]
    return f"{word} {address}..{last}" if last > address else f"{word} {address}"


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


def _shared_notation(
    profile: Profile, table: Table, ends: tuple[int, int], *, writing: bool
) -> Area | None:
    """An area with the notation of both ends of a range, else with the only one of its table."""
    first, last = (profile.area(table, end, writing=writing) for end in ends)
    if first is not None and last is not None and first.notation == last.notation:
        return first
    areas = [area for area in profile.areas if area.table is table]
    return areas[0] if len({area.notation for area in areas}) == 1 else None


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
