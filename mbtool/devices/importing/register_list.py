"""Makes a profile from a register list: a vendor's table of registers, saved as CSV."""

# The import guesses what neither the list nor the user states. A remark reports each guess; the
# remarks are also in a comment at the top of the profile. All unreadable rows are reported
# together. Then no profile is made, unless the user allows that such rows are left out.
#
# Limits: a file of at most MAX_BYTES bytes and MAX_ROWS rows.

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import TYPE_CHECKING

from mbtool.core.errors import UsageError
from mbtool.devices.dumping import dump_profile
from mbtool.devices.importing.addresses import AddressCell, read_addresses
from mbtool.devices.importing.areas import MAX_HOLE, make_areas
from mbtool.devices.importing.cells import is_nothing, parse_bits, parse_table, parse_texts
from mbtool.devices.importing.columns import Sheet, find_sheet, fold
from mbtool.devices.importing.locating import locate_rows
from mbtool.devices.importing.options import ImportOptions, ImportReport
from mbtool.devices.importing.points import make_points
from mbtool.devices.importing.rows import ListRow, RowReader, merge_bits
from mbtool.devices.loading import MAX_FILE_BYTES
from mbtool.devices.model import Profile
from mbtool.devices.profile_template import name_for
from mbtool.devices.validation import validate
from mbtool.modbus.adu import Transport

if TYPE_CHECKING:
    from mbtool.devices.importing.cells import TableCell

MAX_BYTES = 4 << 20
MAX_ROWS = 20_000


class BadRowsError(UsageError):
    """Raised if rows of a register list cannot be read; `lines` has the messages about them."""

    def __init__(self, file: str, report: ImportReport) -> None:
        count = len(report.bad_rows)
        rows = f"{count} rows are" if count > 1 else "1 row is"
        super().__init__(
            f"{file}: {rows} wrong, so no profile was made (--skip-bad leaves them out)"
        )
        self.lines = [f"{file}: {line}" for line in report.problem_lines]


@dataclass(frozen=True, slots=True)
class ImportedList:
    """A profile made from a register list, or from a file of another program."""

    profile: Profile
    text: str
    """The profile as the text of a TOML file."""
    remarks: tuple[str, ...]
    """Sentences for the user about each guess, and about everything that was left out."""


def import_register_list(
    data: bytes, file: str, options: ImportOptions | None = None, name: str | None = None
) -> ImportedList:
    """Make a profile from a register list. `data` is the file's content, `file` its name.

    If `name` is None, the profile is named after the file. Raises BadRowsError if rows cannot be
    read and the options do not skip them, and UsageError if the file is no register list.
    """
    options, report = options or ImportOptions(), ImportReport()
    sheet = find_sheet(_decode(data, file, report), file, options.columns)
    if len(sheet.rows) > MAX_ROWS:
        raise UsageError(f"{file}: more than {MAX_ROWS} rows are no register list")
    tell_columns(sheet, report)
    rows = BodyReader(sheet, options, report).read()
    located = locate_rows(rows, sheet.addresses, options, report)
    made = make_points(located, options.word_order, report)
    if report.bad_rows and not options.skip_bad:
        raise BadRowsError(file, report)
    for line in report.problem_lines:
        report.tell(f"left out: {line}")
    if not made:
        heading = sheet.addresses.heading
        raise UsageError(f'{file}: no row below its headings has an address in "{heading}"')
    areas, points, functions = make_areas(made)
    profile = Profile(
        name=name or name_for(file),
        title=PurePath(file).stem or file,
        vendor="unknown",
        transports=[Transport.RTU, Transport.TCP],
        source=f"register list {PurePath(file).name}",
        areas=areas,
        functions=functions,
        points=points,
    )
    validate(profile, file)
    text = _text(profile, report.remarks)
    if len(text.encode()) > MAX_FILE_BYTES:
        raise UsageError(
            f"{file}: its profile would have more than {MAX_FILE_BYTES} bytes; "
            "import a part of the list"
        )
    return ImportedList(profile, text, tuple(report.remarks))


def _decode(data: bytes, file: str, report: ImportReport) -> str:
    if len(data) > MAX_BYTES:
        raise UsageError(f"{file}: more than {MAX_BYTES} bytes are no register list")
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise UsageError(f"{file}: a spreadsheet; export it as CSV and import that")
    is_wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        return _plain_text(data.decode("utf-16" if is_wide else "utf-8-sig"))
    except UnicodeDecodeError:
        report.tell("not UTF-8, so read as Latin-1: check \u00b0, \u00b5 and umlauts")
        return _plain_text(data.decode("cp1252", errors="replace"))


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def _plain_text(text: str) -> str:
    """Return a text with line feeds as line ends, and without other control characters.

    No text of a profile may have control characters.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text if text.isprintable() else _CONTROL.sub("", text)


def _text(profile: Profile, remarks: Sequence[str]) -> str:
    """The profile as the text of a TOML file, with the remarks in a comment at the top."""
    return dump_profile(
        profile,
        {
            "": [
                f"Made by mbtool devices import from the {profile.source}.",
                "Check what it took for granted:",
                *(f"- {remark}" for remark in remarks),
                f"- an area goes on over up to {MAX_HOLE - 1} addresses that the list leaves out",
                "- limits of quantities, exceptions and timing are the standard's",
                "The keys of a profile are explained in docs/devices.md of mbtool.",
            ]
        },
    )


# The code below reads the rows below the headings of a register list.
#
# A row with an address describes a value. A row without an address is one of these:
#
# - a heading that names a table ("Input registers", "Eingangsregister (FC 04)"): the rows below it
#   that name no table are in this table
# - a bit or value with its meaning, such as `Bit 3: Alarm` or `1 = Auto`: it belongs to the row
#   above
# - any other text, which is left out

_MAX_SECTION = 80
"""A heading between the rows has at most this many characters. A longer text is no heading."""

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
