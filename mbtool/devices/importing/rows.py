"""Reads the rows of a register list: each value with its type, scale, unit and rights."""

# A cell that cannot be read is reported as a problem of the row. The other cells of the row are
# still read, so that all problems are reported together. One decision is made for a whole column:
# its factors all multiply or all divide, unless a cell says otherwise.

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from mbtool.devices.importing.addresses import AddressCell
from mbtool.devices.importing.cells import (
    REGISTER_BITS,
    TableCell,
    is_nothing,
    parse_access,
    parse_bits,
    parse_factor,
    parse_number,
    parse_range,
    parse_table,
    parse_texts,
    parse_unit,
)
from mbtool.devices.importing.columns import Meaning, Sheet
from mbtool.devices.importing.options import ImportReport, Scaling
from mbtool.devices.importing.spellings import Order, TypeSpelling, parse_order, parse_type
from mbtool.devices.model import Access
from mbtool.devices.point_types import ByteOrder, PointType

T = TypeVar("T")

MAX_NAME = 120
"""A name has at most this many characters; longer names are cut."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ListRow:
    """One row of a register list, with the values of its cells."""

    row: int
    """The number of the row in the file; the first row is 1."""
    name: str
    address: AddressCell
    table: TableCell | None
    """The table that the row's own cell names. If the cell names none, the one that the heading
    above the row names; None if neither names one."""
    type: TypeSpelling | None
    registers: int | None
    order: Order | None
    access: Access | None
    unit: str | None
    scale: float
    offset: float
    decimals: int | None
    minimum: float | None
    maximum: float | None
    default: float | None
    texts: Mapping[int, str] = field(default_factory=dict)
    bits: Mapping[int, str] = field(default_factory=dict)
    note: str = ""


class RowReader:
    """Reads the cells of one register list (a Sheet), row by row."""

    def __init__(self, sheet: Sheet, report: ImportReport, scaling: Scaling | None) -> None:
        self._sheet = sheet
        self._report = report
        self._number = 0
        self._row: Sequence[str] = ()
        self._names = {self.name(row) for row in sheet.body} - {""}
        self._divides = self._factors_divide(scaling)

    def read(
        self, number: int, row: Sequence[str], address: AddressCell, section: TableCell | None
    ) -> ListRow:
        """Read the row with the number `number` in the file.

        `section` is the table that the heading above the row names; None if it names none.
        """
        self._number, self._row = number, row
        bit = self._number_of(Meaning.BIT)
        if bit is not None and address.bit is None:
            address = replace(address, bit=int(bit))
        if any("," in cell and _THOUSANDS.fullmatch(cell.strip()) for cell in row):
            self._report.tell("comma taken for a decimal comma: 1,000 is 1", number)
        registers = self._registers()
        wanted = _NO_TABLE if _known_table(self._text(Meaning.TYPE)) is not None else _TYPE_WANTED
        type_ = self._read(Meaning.TYPE, lambda text: parse_type(text, registers), wanted)
        scale, decimals, unit = self._scaled(type_)
        texts, bits, used = self._values()
        low, high = parse_range(self._text(Meaning.RANGE)) or (
            parse_number(self._text(Meaning.MINIMUM)),
            parse_number(self._text(Meaning.MAXIMUM)),
        )
        if low is not None and high is not None and low > high:
            self._problem(Meaning.MINIMUM, f"{low}", f"is more than {high}")
        return ListRow(
            row=number,
            name=self.name(row),
            address=address,
            table=self._read(Meaning.TABLE, _known_table, _TABLE_WANTED) or section,
            type=type_,
            registers=registers,
            order=self._order() or (type_.order if type_ is not None else None),
            access=self._access(),
            unit=unit,
            scale=scale,
            offset=self._number_of(Meaning.OFFSET) or 0.0,
            decimals=decimals,
            minimum=low,
            maximum=high,
            default=parse_number(self._text(Meaning.DEFAULT)),
            texts=texts,
            bits=bits,
            note="; ".join(dict.fromkeys(self._notes(used))),
        )

    def is_reserved(self, row: Sequence[str]) -> bool:
        """True if the row only says that its address is reserved or not used."""
        return self.name(row).lower().strip("().- ") in _RESERVED

    def name(self, row: Sequence[str]) -> str:
        # Replace braces, because in a point's name they mark a number that mbtool fills in: {n}.
        name = next(iter(self._words(row)), "").replace("{", "(").replace("}", ")")
        return name[:MAX_NAME].strip()

    def _words(self, row: Sequence[str]) -> list[str]:
        """The row's texts in all columns of names, then those in all columns of descriptions."""
        columns = [*self._sheet.all(Meaning.NAME), *self._sheet.all(Meaning.DESCRIPTION)]
        texts = (" ".join(column.of(row).split()) for column in columns)
        return [text for text in texts if not is_nothing(text)]

    def _text(self, meaning: Meaning) -> str:
        """The text of the row's cell in the column with a meaning; empty if there is none."""
        column = self._sheet.column(meaning)
        text = column.of(self._row) if column is not None else ""
        return "" if is_nothing(text) else text

    def _problem(self, meaning: Meaning, text: str, problem: str) -> None:
        column = self._sheet.column(meaning)
        heading = column.heading if column is not None else None
        self._report.add_problem(self._number, heading, text, problem)

    def _read(self, meaning: Meaning, parse: Callable[[str], T | None], problem: str) -> T | None:
        """Read the row's cell in the column with a meaning, using `parse`; None if the cell is
        empty.

        If `parse` returns None, the text `problem` is reported as what is wrong with the cell.
        """
        text = self._text(meaning)
        value = parse(text) if text else None
        if text and value is None:
            self._problem(meaning, text, problem)
        return value

    def _number_of(self, meaning: Meaning) -> float | None:
        return self._read(meaning, parse_number, "is no number")

    def _registers(self) -> int | None:
        for meaning, per_register in _UNITS_OF_LENGTH.items():
            length = self._number_of(meaning)
            if length is not None and 0 < length <= 125 * per_register:
                return math.ceil(length / per_register)
            if length is not None:
                self._problem(meaning, self._text(meaning), "is not 1 to 125 registers")
        return None

    def _order(self) -> Order | None:
        order = self._read(Meaning.WORD_ORDER, parse_order, _ORDER_WANTED)
        column = self._sheet.column(Meaning.WORD_ORDER)
        if order is None or column is None or "word" not in column.hint:
            return order
        # In a column headed "word order", "little" means the order of the words only. The bytes of
        # each word are then in the usual order.
        return order[0], ByteOrder.HIGH_FIRST

    def _access(self) -> Access | None:
        column = self._sheet.column(Meaning.ACCESS)
        if column is not None and column.hint.startswith("writ"):
            answer = _YES_OR_NO.get(self._text(Meaning.ACCESS).lower())
            if answer is not None:
                return answer
        return self._read(Meaning.ACCESS, parse_access, _ACCESS_WANTED)

    def _scaled(self, type_: TypeSpelling | None) -> tuple[float, int | None, str | None]:
        """Return the scale, the number of decimals, and the unit of measure of the row's value; the
        last two are None if unknown. `type_` is the type of the value, None if the row names none.

        The scale is the product of the row's factors. If the row has no factor, the scale is the
        factor in the cell of the unit (0.1 in `0.1 V`). If that cell has none, it follows from the
        number of decimals.
        """
        unit_factor, unit = parse_unit(self._text(Meaning.UNIT))
        places = self._number_of(Meaning.DECIMALS)
        decimals = int(places) if places is not None and 0 <= places <= 15 else None
        is_float = type_ is not None and type_.type.is_float
        usual = 10.0**-decimals if decimals and not is_float else 1.0
        factors = [self._factor(Meaning.SCALE), self._factor(Meaning.DIVISOR)]
        said = [factor for factor in factors if factor is not None]
        scale = math.prod(said) if said else unit_factor or usual
        if not said and not unit_factor and usual != 1:
            self._report.tell("whole numbers are divided as their decimals say", self._number)
        if not math.isfinite(scale) or scale == 0:
            self._problem(Meaning.SCALE, self._text(Meaning.SCALE), _SCALE_WANTED)
            scale = 1.0
        return scale, decimals, unit

    def _factor(self, meaning: Meaning) -> float | None:
        text = self._text(meaning)
        if text in self._names and parse_factor(text) is None:
            self._report.tell("scaled by another register, kept as a note", self._number)
            return 1.0  # The cell names a register that holds a power of ten, as in SunSpec.
        factor = self._read(meaning, parse_factor, _SCALE_WANTED)
        if factor is None:
            return None
        divides = meaning is Meaning.DIVISOR or self._divides
        divides = divides if factor.divides is None else factor.divides
        return 1 / factor.number if divides else float(factor.number)

    def _values(self) -> tuple[dict[int, str], dict[int, str], str | None]:
        """Return the meanings of the value's numbers, the names of its bits, and the text of the
        cell that lists them (None if no cell does).

        The cell may be in a column of values, of ranges or of descriptions. In a column of ranges
        or descriptions, a single number with a text does not count, because it may be prose.
        """
        for meaning in (Meaning.TEXTS, Meaning.RANGE, Meaning.DESCRIPTION):
            for text in (column.of(self._row) for column in self._sheet.all(meaning)):
                texts, bits = parse_texts(text) or {}, parse_bits(text) or {}
                if bits or len(texts) > 1 or (texts and meaning is Meaning.TEXTS):
                    if meaning is not Meaning.TEXTS:
                        self._report.tell(
                            f"values listed in the {meaning}, taken as texts", self._number
                        )
                    return texts, bits, " ".join(text.split())
        return {}, {}, None

    def _notes(self, used: str | None) -> list[str]:
        """The row's texts that are kept as notes of the point.

        They are all texts of the row except its name and `used`, the text of the cell that lists
        the meanings of numbers or bits (None if there is no such cell).
        """
        notes = [
            text for text in self._words(self._row) if text not in (self.name(self._row), used)
        ]
        prose = [
            f"{prefix}{text}"
            for meaning, parse, prefix in _PROSE
            if (text := " ".join(self._text(meaning).split())) and text != used
            if parse(text) is None
        ]
        if prose:
            self._report.tell("range or values in words, kept as a note", self._number)
        factor = self._text(Meaning.SCALE)
        if factor in self._names and parse_factor(factor) is None:
            notes.append(f"scaled by the power of ten in {factor}")
        return [*notes, *prose]

    def _factors_divide(self, scaling: Scaling | None) -> bool:
        """True if a factor without a mark such as x or / divides the number in the register.

        `scaling` is what the user says; None if the headings and the factors must decide.
        """
        column = self._sheet.column(Meaning.SCALE)
        if scaling is not None or column is None:
            return scaling is Scaling.DIVIDE
        factors = [parse_factor(column.of(row)) for row in self._sheet.body]
        bare = [abs(one.number) for one in factors if one and one.divides is None]
        if column.is_named:
            divides, why = False, "--column scale says"
        elif any(word in column.hint for word in _MULTIPLIERS):
            divides, why = False, "its heading says"
        else:
            divides = min(bare, default=0) >= 1
            why = f"{'no factor is' if divides else 'some factors are'} less than 1"
        if any(one != 1 for one in bare):
            verb = "divided" if divides else "multiplied"
            self._report.tell(
                f'numbers are {verb} by "{column.heading}", as {why} (--scaling says otherwise)'
            )
        return divides


def merge_bits(rows: Sequence[ListRow], report: ImportReport) -> list[ListRow]:
    """Merge all rows that name bits of one register into one row.

    If the list has a row for the whole register, the bits are added to that row. If it has none, a
    new row without a name gets them.
    """
    merged = [row for row in rows if row.address.bit is None]
    places = {_register(row): at for at, row in enumerate(merged)}
    for row in rows:
        bit = row.address.bit
        if bit is None:
            continue
        at = places.get(_register(row))
        if bit not in REGISTER_BITS or (at is not None and bit in merged[at].bits):
            which = (
                "a bit that another row names" if bit in REGISTER_BITS else "no bit from 0 to 15"
            )
            report.add_problem(row.row, None, row.address.text, f"names {which}")
            continue
        if at is None:
            at = places[_register(row)] = len(merged)
            address, type_ = replace(row.address, bit=None), TypeSpelling(PointType.UINT16)
            whole = replace(row, name="", note="", address=address, type=type_, texts={}, bits={})
            merged.append(whole)
        access = merged[at].access
        if row.access is not access:
            access = None if None in (row.access, access) else Access.READ_WRITE
        bits = {**merged[at].bits, bit: row.name or f"bit {bit}"}
        merged[at] = replace(merged[at], bits=bits, access=access)
    return merged


def _register(row: ListRow) -> tuple[object, ...]:
    table = row.table.table if row.table is not None else None
    return row.address.number, row.address.notation, table


def _known_table(text: str) -> TableCell | None:
    cell = parse_table(text)
    return cell if cell is not None and cell.table is not None else None


_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
"""Matches a number whose comma may be a decimal comma or a thousands separator: 1,000."""

_UNITS_OF_LENGTH = {Meaning.LENGTH: 1, Meaning.LENGTH_IN_BYTES: 2, Meaning.LENGTH_IN_BITS: 16}
"""For each kind of length column, the number of its units that make one register: 1 register, 2
bytes or 16 bits."""

_PROSE: tuple[tuple[Meaning, Callable[[str], object], str], ...] = (
    (Meaning.TEXTS, lambda _: None, ""),
    (Meaning.RANGE, parse_range, "range: "),
    (Meaning.MINIMUM, parse_number, "minimum: "),
    (Meaning.MAXIMUM, parse_number, "maximum: "),
    (Meaning.DEFAULT, parse_number, "default: "),
)
"""Columns whose cells may contain prose in place of a value. Each has its meaning, the function
that reads a value, and the word to write before the prose in a note."""

_MULTIPLIERS = ("multipl", "factor", "faktor", "facteur", "resolution", "coefficient", "lsb",
                "accuracy", "precision", "step", "auflosung", "conversion")  # fmt: skip
_YES_OR_NO = {
    **dict.fromkeys(("yes", "y", "true", "1", "x", "ja", "oui"), Access.READ_WRITE),
    **dict.fromkeys(("no", "n", "false", "0", "nein", "non"), Access.READ),
}
_RESERVED = frozenset(
    ("reserved", "reserve", "spare", "not used", "unused", "future use", "for future use",
     "reserved for future use", "reserviert", "frei", "nicht belegt", "réservé", "pad", "padding")
)  # fmt: skip
_TYPE_WANTED = "is no type, as UINT16, INT32, FLOAT32, BCD, BOOL or STRING[16] are"
_NO_TABLE = "is a table, not a type; --column table=HEADING says that the column has tables"
_ORDER_WANTED = "is no order, as ABCD, CDAB, low word first or big-endian word swap are"
_ACCESS_WANTED = "is no access, as R, W or RW are"
_TABLE_WANTED = "names no table, as holding register, 4x, HR, 03, FC04 or coil do"
_SCALE_WANTED = "is no factor, as 0.1, /10 or x0.1 are"
