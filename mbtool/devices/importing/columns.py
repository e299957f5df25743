"""Finds the delimiter, the row of headings and the meanings of the columns of a register list."""

# The row of headings is the one, among the first MAX_PREAMBLE rows, with the most headings that the
# user names; if several are equal, the one with the most headings that this module knows. It knows
# a heading as a whole, or by its last words: a "register description" is a description. Headings
# are English, German or French.
#
# Several columns may have names or descriptions. For any other meaning, only the first column is
# used. If the user names a column for a meaning, only this column is used.

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from mbtool.core.errors import UsageError

MAX_PREAMBLE = 40
MAX_COLUMNS = 1000
DELIMITERS = ";\t,|"


class Meaning(StrEnum):
    """The meaning of a column: the kind of value that it holds."""

    ADDRESS = "address"
    NAME = "name"
    DESCRIPTION = "description"
    TYPE = "type"
    LENGTH = "length"
    LENGTH_IN_BYTES = "length-in-bytes"
    LENGTH_IN_BITS = "length-in-bits"
    WORD_ORDER = "word-order"
    BIT = "bit"
    TABLE = "table"
    ACCESS = "access"
    UNIT = "unit"
    SCALE = "scale"
    DIVISOR = "divisor"
    OFFSET = "offset"
    DECIMALS = "decimals"
    MINIMUM = "minimum"
    MAXIMUM = "maximum"
    RANGE = "range"
    DEFAULT = "default"
    TEXTS = "texts"


SYNONYMS = {
    "bits": Meaning.TEXTS, "byte-order": Meaning.WORD_ORDER, "factor": Meaning.SCALE,
    "function": Meaning.TABLE, "max": Meaning.MAXIMUM, "min": Meaning.MINIMUM,
    "order": Meaning.WORD_ORDER, "quantity": Meaning.LENGTH, "values": Meaning.TEXTS,
}  # fmt: skip
"""Other words that the user may write for a column's meaning in the option --column."""

_HEADINGS = {
    Meaning.ADDRESS: "address, addr, adr, adresse, register, registers, reg, registre, reference, "
    "registeradresse, start, from",
    Meaning.NAME: "name, signal, tag, tagname, parameter, variable, point, label, item, symbol, "
    "bezeichnung, signalname, designation, nom, measurement, datapoint, field, messwert, "
    "parametername, element, libelle, quantity name, value name, object name",
    Meaning.DESCRIPTION: "description, desc, comment, comments, remark, remarks, note, notes, "
    "info, beschreibung, bemerkung, kommentar, explanation, details, meaning, bedeutung, content",
    Meaning.TYPE: "type, datatype, format, datentyp, encoding, data, typ",
    Meaning.LENGTH: "length, len, size, words, count, quantity, qty, anzahl, laenge, lange, width, "
    "taille, longueur, regs, bytes, characters, chars, number of registers, registers count, "
    "no of registers, of registers",
    Meaning.WORD_ORDER: "order, endian, endianness, endianess, wordorder, byteorder, swap, "
    "wortreihenfolge",
    Meaning.BIT: "bit, bit number, bit position, bitnr, bit index",
    Meaning.TABLE: "function, functions, function code, function codes, fc, fct, func, table, "
    "area, object, object type, register type, registertype, reg type, register class, kind, "
    "block, register kind, address type, input type, modbus type, funktion, funktionscode, "
    "fonction",
    Meaning.ACCESS: "access, rw, r/w, rights, mode, access type, permission, permissions, action, "
    "zugriff, acces, read/write, read write, writable, writeable, attribute, attr, direction, "
    "lesen/schreiben",
    Meaning.UNIT: "unit, units, uom, unit measurement, unit measure, einheit, unite, dimension",
    Meaning.SCALE: "scale, scaling, factor, multiplier, resolution, faktor, skalierung, facteur, "
    "skalierungsfaktor, coefficient, accuracy, multiply, lsb, auflosung, step, conversion, gain, "
    "magnification",
    Meaning.DIVISOR: "divisor, divider, divide by, divide, teiler, division, diviseur",
    Meaning.OFFSET: "offset, bias, verschiebung",
    Meaning.DECIMALS: "decimals, decimal places, precision, decimal, dp, nachkommastellen, digits",
    Meaning.MINIMUM: "min, minimum, low, lower limit, min value, low limit, minimum value",
    Meaning.MAXIMUM: "max, maximum, high, upper limit, max value, high limit, maximum value",
    Meaning.RANGE: "range, limits, wertebereich, plage",
    Meaning.DEFAULT: "default, default value, factory setting, initial value, voreinstellung, "
    "standardwert, factory, preset",
    Meaning.TEXTS: "values, enum, enumeration, options, states, coding, value, codes, selection, "
    "werte, choices, valeurs",
}
_MEANINGS = {
    heading.strip(): meaning
    for meaning, headings in _HEADINGS.items()
    for heading in headings.split(",")
}
_OF_THE_SLAVE = re.compile(r"\b(?:slave|device|unit|node|station) (?:id|addr(?:ess)?|no|number)\b")
_FILLER = frozenset(
    ("modbus", "mb", "the", "no", "nr", "number", "num", "start", "starting", "first", "begin",
     "plc", "dec", "decimal", "hex", "hexadecimal", "hexa", "pdu", "base", "based", "zero", "one",
     "0", "1", "offset", "protocol", "wire", "in", "of", "holding", "input", "id", "raw", "16bit")
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a register list whose meaning is known."""

    index: int
    heading: str
    meaning: Meaning
    is_named: bool = False
    """True if the user says what the column contains; False if its heading tells it."""

    @property
    def hint(self) -> str:
        """The heading in lower case, without accents and marks, for a search for words in it."""
        return fold(self.heading)

    def of(self, row: Sequence[str]) -> str:
        """The text of this column's cell in a row; empty if the row is too short."""
        return row[self.index].strip() if self.index < len(row) else ""


@dataclass(frozen=True, slots=True)
class Sheet:
    """A register list, split into rows of cells."""

    rows: Sequence[Sequence[str]]
    heading_row: int
    """The index of the row of headings in `rows`."""
    columns: tuple[Column, ...]

    @property
    def headings(self) -> list[str]:
        return [_one_line(heading) for heading in self.rows[self.heading_row]]

    @property
    def body(self) -> Sequence[Sequence[str]]:
        """The rows below the headings."""
        return self.rows[self.heading_row + 1 :]

    @property
    def addresses(self) -> Column:
        """The column of addresses, which every list has."""
        return self.all(Meaning.ADDRESS)[0]

    def column(self, meaning: Meaning) -> Column | None:
        return next((column for column in self.columns if column.meaning is meaning), None)

    def all(self, meaning: Meaning) -> list[Column]:
        return [column for column in self.columns if column.meaning is meaning]


def find_sheet(text: str, file: str, named: Mapping[Meaning, str] | None = None) -> Sheet:
    """Split the text of a CSV file into cells and find its columns.

    `named` are the headings that the user names, by meaning; None if the user names none. Raises
    UsageError if the text is no CSV, has no column of addresses or several, or lacks a column that
    the user names.
    """
    named = named or {}
    problems: list[str] = []
    sheets: list[Sheet] = []
    for delimiter in DELIMITERS:
        reader = csv.reader(io.StringIO(text), delimiter=delimiter, strict=True)
        try:
            rows = list(reader)
        except csv.Error as error:
            problems.append(
                f"{file}: not CSV: {error}, up to line {reader.line_num}; "
                "a quote that opens a cell must close it"
            )
            continue
        first = rows[:MAX_PREAMBLE]
        if any(len(row) > MAX_COLUMNS for row in first):
            raise UsageError(f"{file}: more than {MAX_COLUMNS:,} columns are no register list")
        sheets += [Sheet(rows, at, _columns(row, named)) for at, row in enumerate(first) if row]
    # If several delimiters are equally likely, max() takes the first. DELIMITERS has the semicolon
    # before the comma, because a comma is more often part of a cell's text.
    best = max(sheets, key=_likeness, default=None)
    if problems and (best is None or best.column(Meaning.ADDRESS) is None):
        raise UsageError(problems[0])
    if best is None:
        raise UsageError(f"{file}: is empty")
    _check(best, file, named)
    return best


def _likeness(sheet: Sheet) -> tuple[int, int, bool, int]:
    """Return a measure of how likely the sheet's row of headings is the right one. The greatest
    measure, compared element by element, is the most likely.

    The elements: the number of headings that the user names, the number of known headings, True if
    one of these heads a column of addresses, and the number of cells.
    """
    named = sum(column.is_named for column in sheet.columns)
    has_address = sheet.column(Meaning.ADDRESS) is not None
    return named, len(sheet.columns), has_address, len(sheet.headings)


def _check(sheet: Sheet, file: str, named: Mapping[Meaning, str]) -> None:
    shown = ", ".join(f"'{heading[:40]}'" for heading in sheet.headings if heading)
    there = f"row {sheet.heading_row + 1} has {shown or 'nothing'}"
    headings = [heading.casefold() for heading in sheet.headings]
    for heading in named.values():
        count = headings.count(_one_line(heading).casefold())
        if count != 1:
            many = f"{count} columns are headed" if count else "no column is headed"
            raise UsageError(f"{file}: {many} '{heading}'; {there}")
    if sheet.column(Meaning.ADDRESS) is None or (len(sheet.columns) < 2 and not named):
        raise UsageError(
            f"{file}: no row of headings in its first {MAX_PREAMBLE} rows names a column of "
            f"addresses; say which it is with --column address=HEADING; {there}"
        )
    if len(several := sheet.all(Meaning.ADDRESS)) > 1:
        names = " and ".join(f"'{column.heading}'" for column in several)
        raise UsageError(
            f"{file}: {names} may be columns of addresses; say which counts, as with "
            f"--column 'address={several[0].heading}'"
        )


def _columns(row: Sequence[str], named: Mapping[Meaning, str]) -> tuple[Column, ...]:
    meanings = {_one_line(heading).casefold(): meaning for meaning, heading in named.items()}
    columns: list[Column] = []
    taken = set(named)
    for index, cell in enumerate(row):
        heading = _one_line(cell)
        if (said := meanings.get(heading.casefold())) is not None:
            columns.append(Column(index, heading, said, is_named=True))
            continue
        meaning = meaning_of(heading)
        if meaning is not None and meaning not in taken:
            columns.append(Column(index, heading, meaning))
            if meaning not in (Meaning.ADDRESS, Meaning.NAME, Meaning.DESCRIPTION):
                taken.add(meaning)
    return tuple(columns)


def meaning_of(heading: str) -> Meaning | None:
    """The meaning of a column with this heading, such as `unit`; None if it is not known."""
    plain = fold(heading)
    if not plain or len(plain) > 60 or _OF_THE_SLAVE.search(plain):
        return None
    words = [word for word in plain.replace("/", " ").split() if word not in _FILLER]
    parts = [
        " ".join(words[start : start + count])
        for count in (len(words), 3, 2, 1)
        for start in range(len(words) - count, -1, -1)
    ]
    meaning = next((_MEANINGS[part] for part in [plain, *parts] if part in _MEANINGS), None)
    if meaning is Meaning.LENGTH and re.search("byte|char", plain):
        return Meaning.LENGTH_IN_BYTES
    return Meaning.LENGTH_IN_BITS if meaning is Meaning.LENGTH and "bit" in plain else meaning


def fold(text: str) -> str:
    """Return a text in lower case, without accents and marks and with single spaces.

    So different spellings of a heading become equal.
    """
    lowered = text.lower().translate(str.maketrans("äöüéèêà", "aoueeea")).replace("ß", "ss")
    return " ".join(re.sub(r"[^a-z0-9/]+", " ", lowered).split())


def _one_line(text: str) -> str:
    return " ".join(text.split())
