"""Reads the rows below the headings of a register list."""

# A row with an address describes a value. A row without an address is one of these:
#
# - a heading that names a table ("Input registers", "Eingangsregister (FC 04)"): the rows below it
#   that name no table are in this table
# - a bit or value with its meaning, such as `Bit 3: Alarm` or `1 = Auto`: it belongs to the row
#   above
# - any other text, which is left out

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.devices.importing.addresses import read_addresses
from mbtool.devices.importing.cells import is_nothing, parse_bits, parse_table, parse_texts
from mbtool.devices.importing.columns import Sheet, fold
from mbtool.devices.importing.rows import ListRow, RowReader, merge_bits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.importing.addresses import AddressCell
    from mbtool.devices.importing.cells import TableCell
    from mbtool.devices.importing.options import ImportOptions, ImportReport

_MAX_SECTION = 80
"""A heading between the rows has at most so many characters. A longer text is no heading."""

_TOO_LONG = "stands behind the last heading; a delimiter within a cell needs quotes around it"
_ADDRESS_WANTED = "is no address, as 40001, 4x0001, 12, 0x0102, 0102H and HR12 are"


def tell_columns(sheet: Sheet, report: ImportReport) -> None:
    """Tell the user the row of headings, the guessed meanings of columns, and unused columns."""
    if any(cell.strip() for row in sheet.rows[: sheet.heading_row] for cell in row):
        row = sheet.heading_row + 1
        report.tell(f"row {row} is taken for the headings, and the rows above it are left out")
    for column in sheet.columns:
        if not column.is_named:
            report.tell(f'column "{column.heading}" is taken for the {column.meaning}')
    used = {column.index for column in sheet.columns}
    filled = {at for row in sheet.body for at, cell in enumerate(row) if cell.strip()}
    unused = [at for at in range(len(sheet.headings)) if at not in used]
    names = [f'"{sheet.headings[at]}"' for at in unused if sheet.headings[at]]
    if names:
        report.tell(f"columns that are not used: {', '.join(names)}")
    nameless = [str(at + 1) for at in unused if not sheet.headings[at] and at in filled]
    if nameless:
        report.tell(f"columns without a heading, so not used: number {', '.join(nameless)}")


class BodyReader:
    """Reads the rows below the headings, from the first to the last."""

    def __init__(self, sheet: Sheet, options: ImportOptions, report: ImportReport) -> None:
        self._sheet = sheet
        self._report = report
        self._reader = RowReader(sheet, report, options.scaling)
        self._style = options.addresses
        self._section: TableCell | None = None
        self._rows: list[ListRow] = []
        self._follows_row = False
        """True if the row read before has a value, or adds bits or texts to a value. Then the next
        row may add to that value, too."""

    def read(self) -> list[ListRow]:
        """Return the rows that have an address.

        A row that cannot be read is left out, and becomes a problem in the report.
        """
        column = self._sheet.addresses
        cells = [column.of(row) for row in self._sheet.body]
        addresses = read_addresses(cells, column.hint, self._style, self._report)
        for number, (row, address) in enumerate(
            zip(self._sheet.body, addresses, strict=True), self._sheet.heading_row + 2
        ):
            if any(not is_nothing(cell) for cell in row):
                self._follows_row = self._read(number, row, address)
        # Leave out the rows with a problem, so that merge_bits() does not report them again.
        good = [row for row in self._rows if row.row not in self._report.bad_rows]
        return merge_bits(good, self._report)

    def _read(self, number: int, row: Sequence[str], address: AddressCell | None) -> bool:
        """Read the row with the number `number` in the file. `address` is the address in its cell,
        None if the cell has none.

        Returns True if the row has a value, or adds bits or texts to the value in the row above.
        """
        column, report = self._sheet.addresses, self._report
        cell = column.of(row)
        texts = [each.strip() for each in row if not is_nothing(each)]
        bit = re.fullmatch(r"bit\s*(\d{1,2})", cell, re.IGNORECASE)
        if bit is not None and self._follows_row:
            address = replace(self._rows[-1].address, bit=int(bit[1]), last=None)
        if any(each.strip() for each in row[len(self._sheet.headings) :]):
            report.add_problem(number, None, row[-1], _TOO_LONG)
        elif (section := _section(texts, cell, is_address=address is not None)) is not None:
            self._enter(number, section, " ".join(texts))
        elif address is not None and self._reader.is_reserved(row):
            report.tell("reserved or unused, left out", number)
        elif address is not None:
            self._rows.append(self._reader.read(number, row, address, self._section))
            return True
        elif cell == column.heading:
            report.tell("the headings again, left out", number)
        elif not is_nothing(cell) and len(texts) > 1:
            report.add_problem(number, column.heading, cell, _ADDRESS_WANTED)
        elif self._follows_row and self._add_to_row_above(": ".join(texts)):
            report.tell("no address, taken for values of the row above", number)
            return True
        else:
            report.tell("no address, left out", number)
        return False

    def _enter(self, number: int, section: TableCell, text: str) -> None:
        if section.table is None:
            self._section = None
            problem = "names functions of several tables"
            self._report.add_problem(number, None, text, problem)
            return
        self._section = section
        table = section.table.value.replace("_", " ")
        self._report.tell(f'"{text}": the rows below are {table}', number)

    def _add_to_row_above(self, text: str) -> bool:
        """Add the text of a row such as `Bit 3: Alarm` or `1 = Auto` to the row above.

        Returns False if `text` is something else.
        """
        bits = parse_bits(text) or {}
        texts = (parse_texts(text) or {}) if re.match(r"-?\w+\s*=", text) else {}
        if not bits and not texts:
            return False
        last = self._rows[-1]
        self._rows[-1] = replace(last, bits={**last.bits, **bits}, texts={**last.texts, **texts})
        return True


def _section(texts: Sequence[str], cell: str, *, is_address: bool) -> TableCell | None:
    """Return the table that a row names as a heading for the rows below it; None if it is no such
    heading.

    `texts` are the texts of all cells of the row that are not empty; `cell` is the text in the
    address column. `is_address` is True if that text is an address. A heading has only one cell
    with text, or a second one with function codes.
    """
    distinct = list(dict.fromkeys(texts))
    text = " ".join(distinct)
    if len(distinct) > 2 or len(text) > _MAX_SECTION or not re.search("[A-Za-z]", text):
        return None
    found = parse_table(text)
    if found is None or (found.table is None and not found.functions):
        return None
    if found.functions:
        by_code = not is_address or fold(text).startswith(("fc", "fu", "fk"))
        return found if by_code and (len(distinct) == 1 or not re.search(r"\d", cell)) else None
    return found if len(distinct) == 1 and not is_address else None
