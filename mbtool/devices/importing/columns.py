"""Finds the columns of a register list: its delimiter, its row of headings, and what each means."""

# The row of headings is the one, of the first MAX_PREAMBLE, in which most headings are known; one
# of them must speak of addresses. A heading is known by the whole of it, else by its last known
# word: a "register description" is a description, a "parameter address" an address. Headings are
# English, German or French.
#
# Several columns may speak of addresses (the address on the wire and the vendor's number), names
# and descriptions; of every other meaning the first column counts, and the rest is told as unused.

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from mbtool.core.errors import UsageError

MAX_PREAMBLE = 40
DELIMITERS = ";\t,|"


class Meaning(StrEnum):
    """What a column is about."""

    ADDRESS = "address"
    NAME = "name"
    DESCRIPTION = "description"
    TYPE = "type"
    LENGTH = "length"
    ORDER = "order"
    BIT = "bit"
    TABLE = "table"
    ACCESS = "access"
    UNIT = "unit"
    SCALE = "scale"
    GAIN = "gain"
    DIVISOR = "divisor"
    OFFSET = "offset"
    DECIMALS = "decimals"
    MINIMUM = "minimum"
    MAXIMUM = "maximum"
    RANGE = "range"
    DEFAULT = "default"
    TEXTS = "texts"


_HEADINGS = {
    Meaning.ADDRESS: (
        "address, addr, adr, adresse, register, registers, reg, registre, reference, register "
        "number, register no, mb address, adresse registre, registeradresse, start, from"
    ),
    Meaning.NAME: (
        "name, signal, tag, tagname, parameter, variable, point, label, item, quantity name, "
        "bezeichnung, signalname, designation, nom, measurement, datapoint, property, field, "
        "value name, symbol, messwert, parametername, element, data name, object name, libelle"
    ),
    Meaning.DESCRIPTION: (
        "description, desc, comment, comments, remark, remarks, note, notes, beschreibung, "
        "bemerkung, kommentar, explanation, details, meaning, content, contents, info"
    ),
    Meaning.TYPE: "type, data type, datatype, format, datentyp, encoding, data, typ, data format",
    Meaning.LENGTH: (
        "length, len, size, words, count, quantity, registers count, number of registers, "
        "register count, num registers, no of registers, of registers, qty, anzahl, laenge, "
        "lange, taille, longueur, register length, bytes, width, word count, n registers, regs, "
        "register size, characters, chars, points, quantity of registers"
    ),
    Meaning.ORDER: (
        "order, word order, byte order, endian, endianness, endianess, wordorder, byteorder, "
        "swap, word swap, byte swap, wortreihenfolge"
    ),
    Meaning.BIT: "bit, bit number, bit no, bit position, bitnr, bit index",
    Meaning.TABLE: (
        "function, function code, functions, function codes, fc, fct, func, table, object, object "
        "type, register type, registertype, reg type, area, register class, kind, address type, "
        "input type, modbus type, memory area, funktion, funktionscode, block, read function, "
        "register kind, space, modbus function, fonction, code fonction, data table"
    ),
    Meaning.ACCESS: (
        "access, rw, r/w, rights, mode, access type, permission, permissions, action, zugriff, "
        "acces, access mode, read/write, read write, writable, writeable, attribute, attr, "
        "property rw, r/w access, access right, access rights, direction, lesen/schreiben"
    ),
    Meaning.UNIT: (
        "unit, units, uom, unit of measurement, unit of measure, einheit, unite, eng unit, "
        "engineering unit, engineering units, dimension, measure"
    ),
    Meaning.SCALE: (
        "scale, scaling, factor, multiplier, scale factor, scaling factor, resolution, faktor, "
        "skalierung, facteur, accuracy, multiply, coefficient, precision factor, lsb, auflosung, "
        "conversion, ratio, multiplication factor, skalierungsfaktor, step"
    ),
    Meaning.GAIN: "gain, magnification",
    Meaning.DIVISOR: "divisor, divider, divide by, divide, teiler, division, diviseur",
    Meaning.OFFSET: "offset, bias, zero offset, value offset, verschiebung",
    Meaning.DECIMALS: (
        "decimals, decimal places, precision, decimal, dp, nachkommastellen, decimal point, digits"
    ),
    Meaning.MINIMUM: "min, minimum, low, lower limit, min value, low limit, minimum value",
    Meaning.MAXIMUM: "max, maximum, high, upper limit, max value, high limit, maximum value",
    Meaning.RANGE: "range, value range, valid range, limits, wertebereich, data range, plage",
    Meaning.DEFAULT: (
        "default, default value, factory setting, factory default, initial value, voreinstellung, "
        "standardwert, factory, preset, init"
    ),
    Meaning.TEXTS: (
        "values, enum, enumeration, options, states, coding, value, enum values, enumerations, "
        "codes, selection, werte, choices, valeurs, value description, possible values"
    ),
}
_MEANINGS = {
    heading.strip(): meaning
    for meaning, headings in _HEADINGS.items()
    for heading in headings.split(",")
}
_SEVERAL = frozenset((Meaning.ADDRESS, Meaning.NAME, Meaning.DESCRIPTION))
_FOREIGN = re.compile(r"\b(?:slave|device|unit|node|station) (?:id|addr(?:ess)?|no|number)\b")
_FILLER = frozenset(
    ("modbus", "the", "no", "nr", "number", "num", "start", "starting", "first", "begin", "plc",
     "dec", "decimal", "hex", "hexadecimal", "hexa", "pdu", "base", "based", "zero", "one", "0",
     "1", "offset", "protocol", "wire", "in", "of", "holding", "input", "id", "raw", "16bit")
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the list."""

    index: int
    heading: str
    meaning: Meaning

    @property
    def hint(self) -> str:
        """The heading in lower case, single spaces between its words."""
        return _plain(self.heading)

    def of(self, row: Sequence[str]) -> str:
        """What a row has in it; rows may be short."""
        return row[self.index].strip() if self.index < len(row) else ""

    @property
    def is_exact(self) -> bool:
        """Whether all of the heading is known."""
        return self.hint in _MEANINGS


@dataclass(frozen=True, slots=True)
class Sheet:
    """The list, cut into cells."""

    rows: Sequence[Sequence[str]]
    heading_row: int
    """Its index in `rows`."""
    columns: tuple[Column, ...]
    unused: tuple[str, ...]
    """Headings that mean nothing here."""

    @property
    def headings(self) -> Sequence[str]:
        return self.rows[self.heading_row]

    @property
    def body(self) -> Sequence[Sequence[str]]:
        """The rows below the headings."""
        return self.rows[self.heading_row + 1 :]

    def column(self, meaning: Meaning) -> Column | None:
        return next((column for column in self.columns if column.meaning is meaning), None)

    def all(self, meaning: Meaning) -> list[Column]:
        return [column for column in self.columns if column.meaning is meaning]


def find_sheet(text: str, file: str) -> Sheet:
    """Cut a text into cells and find its columns. Raises UsageError."""
    problems: list[str] = []
    found: list[Sheet] = []
    for delimiter in DELIMITERS:
        reader = csv.reader(io.StringIO(text), delimiter=delimiter, strict=True)
        try:
            rows = list(reader)
        except csv.Error as error:
            problems.append(f"{file}: not CSV: {error}, up to line {reader.line_num}")
            continue
        found += _sheets(rows)
    # The first of equals: a semicolon is less often part of a text than a comma.
    best = max(found, key=lambda sheet: len(sheet.columns), default=None)
    if best is not None:
        return best
    if problems:
        raise UsageError(f"{problems[0]}; a quote that opens a cell must close it")
    first = next((line.strip() for line in text.splitlines() if line.strip()), "")
    raise UsageError(
        f"{file}: no row of headings in its first {MAX_PREAMBLE} rows: one must name a column of "
        f"addresses, for example 'address' or 'register'; the first row is {first[:80]!r}"
    )


def _sheets(rows: list[list[str]]) -> list[Sheet]:
    sheets = []
    for index, row in enumerate(rows[:MAX_PREAMBLE]):
        columns, unused = _columns(row)
        if len(columns) > 1 and any(one.meaning is Meaning.ADDRESS for one in columns):
            sheets.append(Sheet(rows, index, tuple(columns), tuple(unused)))
    return sheets


def _columns(row: Sequence[str]) -> tuple[list[Column], list[str]]:
    columns: list[Column] = []
    unused: list[str] = []
    for index, heading in enumerate(row):
        meaning = meaning_of(heading)
        if meaning is None:
            unused += [" ".join(heading.split())] if heading.strip() else []
            continue
        column = Column(index, " ".join(heading.split()), meaning)
        other = next((one for one in columns if one.meaning is meaning), None)
        if other is None or meaning in _SEVERAL:
            columns.append(column)
        elif column.is_exact and not other.is_exact:
            columns[columns.index(other)] = column
            unused.append(other.heading)
        else:
            unused.append(column.heading)
    return _addresses_found(columns), unused


def _addresses_found(columns: list[Column]) -> list[Column]:
    """Where no column but "offset" can be the addresses, it is."""
    if any(one.meaning is Meaning.ADDRESS for one in columns):
        return columns
    return [
        Column(one.index, one.heading, Meaning.ADDRESS) if one.meaning is Meaning.OFFSET else one
        for one in columns
    ]


def meaning_of(heading: str) -> Meaning | None:
    """What a heading stands for, or None."""
    plain = _plain(heading)
    if not plain or len(plain) > 60 or _FOREIGN.search(plain):
        return None
    if plain in _MEANINGS:
        return _MEANINGS[plain]
    words = plain.replace("/", " ").split()
    kept = [word for word in words if word not in _FILLER]
    known = _MEANINGS.get(" ".join(kept))
    if known is not None:
        return known
    for count in (3, 2, 1):
        for start in range(len(kept) - count, -1, -1):
            known = _MEANINGS.get(" ".join(kept[start : start + count]))
            if known is not None:
                return known
    return None


def _plain(heading: str) -> str:
    folded = heading.lower().translate(str.maketrans("äöüéèà", "aoueea")).replace("ß", "ss")
    return " ".join(re.sub(r"[^a-z0-9/]+", " ", folded).split())
