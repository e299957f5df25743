"""Addresses in the vendor's notation, both ways."""

# Where no profile tells, an address is written as it stands on the wire, 0-based, behind the
# field's word for its table: `holding 107..109`, `coil 0`. So `holding 107` is what older documents
# call 40108, and no vendor's reference can be mistaken for it.
#
# A range that leaves the areas of its profile keeps the vendor's notation if the table has only
# one; else nothing says which would be meant, and it is written the neutral way.

from __future__ import annotations

from mbtool.core.errors import UsageError
from mbtool.devices.model import Area, Profile, Radix
from mbtool.modbus.tables import Table

_NEUTRAL = {
    Table.COILS: "coil",
    Table.DISCRETE_INPUTS: "discrete",
    Table.HOLDING_REGISTERS: "holding",
    Table.INPUT_REGISTERS: "input",
}


def write_reference(
    profile: Profile | None, table: Table, address: int, quantity: int | None = 1
) -> str:
    """A range in the notation of its device: `HR400001..400002`, `X0..XF`, `holding 107..109`.

    A quantity of 0 or None is written as the address alone.
    """
    last = address + max(quantity or 1, 1) - 1
    area = _area_to_write_with(profile, table, address, last) if profile is not None else None
    if area is not None:
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
    ranges = ", ".join(area.span(area.first, area.last) for area in profile.areas)
    example = profile.areas[0].reference(profile.areas[0].first) if profile.areas else "none"
    raise UsageError(
        f"reference {text!r}: {profile.name} has {ranges or 'no areas'}; "
        f"write one of them, for example {example}"
    )


def _area_to_write_with(profile: Profile, table: Table, first: int, last: int) -> Area | None:
    areas = [area for area in profile.areas if area.table is table]
    for area in areas:
        if area.holds(table, first, last - first + 1):
            return area
    return areas[0] if len({area.notation for area in areas}) == 1 else None


def _address_in(area: Area, wanted: str) -> int | None:
    prefix, suffix = area.prefix.upper(), area.suffix.upper()
    if not (wanted.startswith(prefix) and wanted.endswith(suffix)):
        return None
    digits = wanted[len(prefix) : len(wanted) - len(suffix)]
    valid = "0123456789ABCDEF" if area.radix is Radix.HEX else "0123456789"
    # No reference has more digits; int() of thousands of them would be slow.
    if not 0 < len(digits) <= 8 or not set(digits) <= set(valid):
        return None
    address = int(digits, 16 if area.radix is Radix.HEX else 10) - area.base
    return address if area.first <= address <= area.last else None
