"""Finds the table, the address on the wire and the notation of each row of a register list."""

# The table of a row comes from the first of these sources that names one:
#
#     1  the row's address as the list writes it (4x0001, HR1, 40001)
#     2  the row's table column, or the heading above the row
#     3  the user (--table)
#     4  if no source names one, an on/off value is a coil, or a discrete input if the list says
#        that it can only be read; any other value is in holding registers
#
# If source 1 names a table, and source 2 (or 3, if 2 names none) names another one, the row is
# reported as a problem.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.devices.importing.addresses import decide_style, table_and_base
from mbtool.devices.importing.options import AddressStyle, ImportOptions, ImportReport
from mbtool.devices.model import Access, Area
from mbtool.modbus.functions import FUNCTIONS, READ_WRITE_REGISTERS
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.devices.importing.columns import Column
    from mbtool.devices.importing.rows import ListRow


class LocatedRow(NamedTuple):
    """A row whose table and address on the wire are known."""

    row: ListRow
    area: Area
    """An area that contains only the address of this row. Its prefix, base and other keys say how
    the list writes the address."""


def locate_rows(
    rows: Sequence[ListRow], column: Column, options: ImportOptions, report: ImportReport
) -> list[LocatedRow]:
    """Find the table and the address on the wire of each row. `column` is the column of addresses.

    A row is left out if its table or address is impossible. It becomes a problem in the report.
    """
    style = _style(rows, column, options, report)
    digits: dict[object, set[int]] = {}
    for row in rows:
        digits.setdefault(row.address.notation, set()).add(row.address.digits)
    located: list[LocatedRow] = []
    for row in rows:
        try:
            table, base = _place(row, style, options.table)
        except ValueError as problem:
            report.add_problem(row.row, column.heading, row.address.text, str(problem))
            continue
        if table is None:
            table = _usual_table(row)
            report.tell(f"no table named, taken as {table} (--table says otherwise)", row.row)
        access = row.access or _usual_access(row, table)
        if access is Access.READ_WRITE and row.access is None and not _functions(row):
            report.tell("no access named, taken as read and write", row.row)
        shown, at = row.address, row.address.number - base
        width = shown.digits if digits[shown.notation] == {shown.digits} else 0
        area = Area(
            name="", table=table, first=at, last=at, access=access,
            prefix=shown.prefix, base=base, radix=shown.radix, suffix=shown.suffix,
            width=width if shown.prefix or not shown.is_decimal else 0,
        )  # fmt: skip
        located.append(LocatedRow(row, area))
    return located


def _style(
    rows: Sequence[ListRow], column: Column, options: ImportOptions, report: ImportReport
) -> AddressStyle:
    """Return how the decimal addresses are counted: from 0, from 1, or as references (40001).

    It is what the user says in `options`, or else a guess, which becomes a remark in the report.
    """
    decimal = [
        (row.address, _said_table(row, options.table))
        for row in rows
        if row.address.is_decimal and not row.address.counts_from_1_always
    ]
    if options.addresses is not None or not decimal:
        return options.addresses or AddressStyle.ZERO_BASED
    style, why = decide_style(decimal, column.hint)
    first = decimal[0][0]
    _, base = table_and_base(first, style)
    report.tell(
        f"addresses are {style}, as {why}: {first.text} is address "
        f"{first.number - base} on the wire (--addresses says otherwise)"
    )
    return style


def _said_table(row: ListRow, table: Table | None) -> Table | None:
    return row.table.table if row.table is not None else table


def _place(row: ListRow, style: AddressStyle, table: Table | None) -> tuple[Table | None, int]:
    """Return the row's table (None if nothing names one), and the number that the list writes for
    address 0 on the wire.

    `table` is the table that the user names. Raises ValueError if the address is not 0 to 65535, if
    two different tables are named, or if the row can be written but its table cannot.
    """
    by_number, base = table_and_base(row.address, style)
    address = row.address.number - base
    if not 0 <= address <= 0xFFFF:
        raise ValueError(f"would be address {address} on the wire; addresses are 0 to 65535")
    by_row = _said_table(row, table)
    if by_number is not None and by_row is not None and by_number is not by_row:
        raise ValueError(f"is in {by_number} by its number, but in {by_row} by its row")
    found = by_number or by_row
    if found is not None and not found.is_writable and row.access not in (None, Access.READ):
        raise ValueError(f"is in {found}, which cannot be written, but its row says {row.access}")
    return found, base


def _usual_table(row: ListRow) -> Table:
    if row.type is None or not row.type.is_switch:
        return Table.HOLDING_REGISTERS
    return Table.DISCRETE_INPUTS if row.access is Access.READ else Table.COILS


def _functions(row: ListRow) -> tuple[int, ...]:
    return row.table.functions if row.table is not None else ()


def _usual_access(row: ListRow, table: Table) -> Access:
    """The access (read, write or both) of a row that does not state it.

    It follows from the functions that the row names; if it names none, from the table.
    """
    functions = _functions(row)
    if not table.is_writable:
        return Access.READ
    if not functions or READ_WRITE_REGISTERS in functions:
        return Access.READ_WRITE
    writes = {FUNCTIONS[code].writes for code in functions}
    return Access.READ_WRITE if len(writes) > 1 else Access("w" if writes.pop() else "r")
