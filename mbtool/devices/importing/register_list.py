"""Makes a profile from a register list: the CSV that a vendor's table of registers becomes."""

# What a list leaves open is decided from its data and said in a remark; the remarks also stand in
# the profile's head. What is wrong in it is told cell by cell, and then there is no profile: a list
# that is half understood would name registers wrongly.
#
# Rows without an address are headings between the rows, or text; a heading that names a table
# ("Input registers") holds for the rows below it where no column does.
#
# Limits: a file of at most MAX_BYTES, at most MAX_ROWS rows, MAX_COMPLAINTS complaints kept.

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import TYPE_CHECKING

from mbtool.core.errors import UsageError
from mbtool.core.wording import plural
from mbtool.devices.dumping import dump_profile
from mbtool.devices.importing.addresses import (
    Written,
    has_tables_in_front,
    is_bare_hex,
    parse_address,
    without_false_bits,
)
from mbtool.devices.importing.cells import CellAccess, is_nothing, parse_table
from mbtool.devices.importing.columns import Column, Meaning, Sheet, find_sheet, meaning_of
from mbtool.devices.importing.layout import MAX_HOLE, lay_areas, lay_points
from mbtool.devices.importing.placing import ImportOptions, Placer
from mbtool.devices.importing.rows import Complaints, Item, RowReader
from mbtool.devices.importing.spellings import TypeSpelling, parse_type
from mbtool.devices.loading import MAX_FILE_BYTES
from mbtool.devices.model import PointType, Profile
from mbtool.devices.profile_template import name_for
from mbtool.devices.validation import validate
from mbtool.modbus.adu import Transport

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MAX_BYTES = 4 << 20
MAX_ROWS = 20_000
_SHOWN_ROWS = 8


class WrongCellsError(UsageError):
    """Cells of a list that cannot be read; `lines` tells each."""

    def __init__(self, file: str, complaints: Complaints) -> None:
        count = complaints.count
        more = count - len(complaints.lines)
        also = f" ({more} more not shown)" if more else ""
        what = "cell is wrong" if count == 1 else f"cells are wrong{also}"
        super().__init__(f"{file}: {count} {what}, so no profile was made")
        self.lines = complaints.lines


@dataclass(frozen=True, slots=True)
class Imported:
    """A profile made from a list."""

    profile: Profile
    text: str
    """The profile as TOML."""
    remarks: tuple[str, ...]
    """What was decided, and what was left out."""


def import_register_list(
    data: bytes, file: str, options: ImportOptions | None = None, name: str | None = None
) -> Imported:
    """Make a profile of a register list; `file` names it in errors.

    Raises WrongCellsError for cells that cannot be read, UsageError for what is no list.
    """
    return _Import(file, options or ImportOptions()).run(data, name)


class _Import:
    def __init__(self, file: str, options: ImportOptions) -> None:
        self._file = file
        self._options = options
        self._remarks: list[str] = []
        self._complaints = Complaints(file)

    def run(self, data: bytes, name: str | None) -> Imported:
        text = self._decode(data)
        sheet = find_sheet(text, self._file)
        if len(sheet.rows) > MAX_ROWS:
            raise UsageError(f"{self._file}: more than {MAX_ROWS} rows are no register list")
        sheet, addresses = self._with_addresses(_with_table(sheet))
        reader = RowReader(sheet, self._complaints, self._options.scaling)
        items = self._items(sheet, addresses, reader)
        column = addresses[0]
        placer = Placer(items, column, self._options, self._complaints)
        laid = lay_points(placer.place_all(), self._complaints, column)
        self._remarks += [*placer.remarks, *reader.remarks]
        self._tell_types(items)
        self._tell_limits(items, reader)
        self._tell_unused(sheet)
        if self._complaints.count:
            raise WrongCellsError(self._file, self._complaints)
        if not laid:
            raise UsageError(
                f'{self._file}: no row below its headings has an address in "{column.heading}"'
            )
        areas, points, functions = lay_areas(laid)
        profile = Profile(
            name=name or name_for(self._file),
            title=PurePath(self._file).stem or self._file,
            vendor="unknown",
            transports=[Transport.RTU, Transport.TCP],
            source=f"register list {PurePath(self._file).name}",
            areas=areas,
            functions=functions,
            points=points,
        )
        validate(profile, self._file)
        written = _text(profile, self._remarks)
        if len(written.encode()) > MAX_FILE_BYTES:
            raise UsageError(
                f"{self._file}: its profile would have more than {MAX_FILE_BYTES} bytes; "
                "import a part of the list"
            )
        return Imported(profile, written, tuple(self._remarks))

    def _decode(self, data: bytes) -> str:
        if len(data) > MAX_BYTES:
            raise UsageError(f"{self._file}: more than {MAX_BYTES} bytes are no register list")
        if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
            raise UsageError(f"{self._file}: a spreadsheet; export it as CSV and import that")
        for mark, encoding in (
            (b"\xff\xfe", "utf-16"),
            (b"\xfe\xff", "utf-16"),
            (b"", "utf-8-sig"),
        ):
            if data.startswith(mark):
                try:
                    return _with_plain_ends(data.decode(encoding))
                except UnicodeDecodeError:
                    continue
        self._remarks.append("not UTF-8, so read as Latin-1: look at \u00b0, \u00b5 and umlauts")
        return _with_plain_ends(data.decode("cp1252", errors="replace"))

    def _with_addresses(self, sheet: Sheet) -> tuple[Sheet, list[Column]]:
        """The one or two columns that have addresses; others of that heading are names."""
        have: list[Column] = []
        columns: list[Column] = []
        for column in sheet.columns:
            if column.meaning is not Meaning.ADDRESS:
                columns.append(column)
                continue
            cells = [cell for row in sheet.body if not is_nothing(cell := column.of(row))]
            read = _read_all(cells)
            if len(have) < 2 and (
                not cells or 2 * sum(one is not None for one in read) >= len(cells)
            ):
                have.append(column)
            else:
                columns.append(replace(column, meaning=Meaning.NAME))
        have = have or [next(one for one in sheet.columns if one.meaning is Meaning.ADDRESS)]
        return replace(sheet, columns=tuple(columns)), have

    def _items(self, sheet: Sheet, addresses: Sequence[Column], reader: RowReader) -> list[Item]:
        read = [_read_all([column.of(row) for row in sheet.body]) for column in addresses]
        width = len(sheet.headings)
        section: CellAccess | None = None
        items: list[Item] = []
        left_out: dict[str, list[int]] = {_WITHOUT: [], _RESERVED: [], _REPEATED: []}
        for number, (row, *written) in enumerate(
            zip(sheet.body, *read, strict=True), sheet.heading_row + 2
        ):
            texts = [cell for cell in row if not is_nothing(cell)]
            if not texts:
                continue
            if any(one.strip() for one in row[width:]):
                self._complaints.add(number, None, row[-1], _TOO_LONG.format(width))
            elif written[0] is not None:
                if reader.is_reserved(row):
                    left_out[_RESERVED].append(number)
                else:
                    other = written[1] if len(written) > 1 else None
                    items.append(reader.item(number, row, written[0], other, section))
            elif _is_heading_again(row, sheet, addresses):
                left_out[_REPEATED].append(number)
            elif is_nothing(cell := addresses[0].of(row)) or len(texts) == 1:
                section = _section(texts) or section
                left_out[_WITHOUT].append(number)
            else:
                self._complaints.add(number, addresses[0], cell, _ADDRESS_WANTED)
        if any(cell.strip() for row in sheet.rows[: sheet.heading_row] for cell in row):
            self._remarks.append(f"rows 1 to {sheet.heading_row}, above the headings, are left out")
        for why, rows in left_out.items():
            self._tell_rows(why, rows)
        return items

    def _tell_types(self, items: Sequence[Item]) -> None:
        untyped = [item.row for item in items if item.kind is None and item.written.bit is None]
        if untyped and len(untyped) == len(items):
            self._remarks.append(
                "without a type all is taken as uint16, of two registers as uint32"
            )
        else:
            self._tell_rows("without a type, taken as uint16, of two registers as uint32", untyped)
        kinds = [(item, item.kind) for item in items if item.kind is not None]
        endless = [item.row for item, kind in kinds if _has_no_length(item, kind)]
        self._tell_rows("with a text without a length, taken as 1 register", endless)
        wide = [item.row for item, kind in kinds if kind.is_bits and kind.type.words > 1]
        self._tell_rows(
            "with bits in several registers, taken as a whole number, since only one register can "
            "have named bits",
            wide,
        )

    def _tell_limits(self, items: Sequence[Item], reader: RowReader) -> None:
        scaled = [
            item.row
            for item in items
            if (item.scale, item.offset) != (1, 0)
            and not item.minimum is item.maximum is item.default is None
        ]
        self._tell_rows(
            "with a range or default that is kept as a note, since the list does not say whether "
            "it is before or after scaling",
            scaled,
        )
        self._tell_rows("with a range or values that cannot be read, kept as a note", reader.unread)

    def _tell_unused(self, sheet: Sheet) -> None:
        nameless = [
            index + 1
            for index, heading in enumerate(sheet.headings)
            if not heading.strip() and any("".join(row[index : index + 1]) for row in sheet.body)
        ]
        if nameless:
            which = ", ".join(map(str, nameless[:_SHOWN_ROWS]))
            self._remarks.append(f"columns without a heading, so not used: number {which}")
        if sheet.unused:
            names = ", ".join(f'"{name}"' for name in sheet.unused[:_SHOWN_ROWS])
            more = len(sheet.unused) - _SHOWN_ROWS
            also = f" and {more} more" if more > 0 else ""
            self._remarks.append(f"columns that are not used: {names}{also}")

    def _tell_rows(self, what: str, rows: Sequence[int]) -> None:
        if rows:
            shown = ", ".join(map(str, rows[:_SHOWN_ROWS]))
            more = f" and {len(rows) - _SHOWN_ROWS} more" if len(rows) > _SHOWN_ROWS else ""
            self._remarks.append(f"{plural(len(rows), 'row')} {what}: {shown}{more}")


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
_WITHOUT = "without an address, so left out"
_RESERVED = "called reserved or unused, so left out"
_REPEATED = "repeating the headings, so left out"
_TOO_LONG = (
    "stands behind the last of {} headings; a delimiter within a cell needs quotes around it"
)
_ADDRESS_WANTED = "is no address; 40001, 4x0001, 12, 0x0102, 0102H and HR12 are"


def _has_no_length(item: Item, kind: TypeSpelling) -> bool:
    return (
        kind.type is PointType.STRING and kind.length is item.registers is item.written.last is None
    )


def _with_plain_ends(text: str) -> str:
    """Lines as Python ends them, without control characters, which no profile can have."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text if text.isprintable() else _CONTROL.sub("", text)


def _read_all(cells: Sequence[str]) -> list[Written | None]:
    there = [cell for cell in cells if not is_nothing(cell)]
    hexadecimal, in_front = is_bare_hex(there), has_tables_in_front(there)
    return without_false_bits(
        [parse_address(one, bare_hex=hexadecimal, tables_in_front=in_front) for one in cells]
    )


def _with_table(sheet: Sheet) -> Sheet:
    """A "type" may be the table, a "register type" the type: what stands in the cells tells."""
    columns = list(sheet.columns)
    for index, column in enumerate(columns):
        if column.meaning not in (Meaning.TYPE, Meaning.TABLE):
            continue
        cells = {cell for row in sheet.body if not is_nothing(cell := column.of(row))}
        swapped = Meaning.TABLE if column.meaning is Meaning.TYPE else Meaning.TYPE
        free = not any(one.meaning is swapped for one in columns)
        types = sum(parse_type(cell) is not None for cell in cells)
        tables = sum(parse_table(cell) is not None for cell in cells)
        right, other = (types, tables) if column.meaning is Meaning.TYPE else (tables, types)
        if free and right < other == len(cells):
            columns[index] = replace(column, meaning=swapped)
    return replace(sheet, columns=tuple(columns))


def _is_heading_again(row: Sequence[str], sheet: Sheet, addresses: Iterable[Column]) -> bool:
    known = [*sheet.columns, *addresses]
    return sum(meaning_of(one.of(row)) is not None for one in known) * 2 > len(known)


def _section(texts: Sequence[str]) -> CellAccess | None:
    """The table that a heading between the rows names."""
    return parse_table(texts[0]) if len(texts) == 1 and not texts[0].strip().isdigit() else None


def _text(profile: Profile, remarks: Sequence[str]) -> str:
    """The profile as TOML, with what was decided in its head."""
    return dump_profile(
        profile,
        {
            "": [
                f"Made by mbtool devices import from the {profile.source}.",
                "What was decided where the list leaves it open; look at it:",
                *(f"- {remark}" for remark in remarks),
                f"- an area goes on over up to {MAX_HOLE - 1} addresses that the list leaves out",
                "- limits of quantities, exceptions and timing are the standard's",
                "The keys of a profile are explained in docs/devices.md of mbtool.",
            ]
        },
    )
