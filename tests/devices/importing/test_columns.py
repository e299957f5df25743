"""Headings of register lists."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core.errors import UsageError
from mbtool.devices.importing.columns import MAX_PREAMBLE, Meaning, find_sheet, meaning_of

HEADINGS = {
    Meaning.ADDRESS: "Address, Register, Modbus Address (Dec), Addr., Start address, Reg No., "
    "Register (hex), Holding register, Adresse, PDU address (0-based), Address offset",
    Meaning.NAME: "Name, Signal name, Tag, variable name, Bezeichnung, Register name, Parameter",
    Meaning.DESCRIPTION: "Description, Parameter description, Remarks, Beschreibung, Comment",
    Meaning.TYPE: "Type, Data type, Datatype, Data Format, Format, Datentyp",
    Meaning.LENGTH: "Length, Size (words), Number of registers, Quantity, Register length, Länge",
    Meaning.LENGTH_IN_BYTES: "Bytes, Size (bytes), Length in characters",
    Meaning.LENGTH_IN_BITS: "Size (bits)",
    Meaning.WORD_ORDER: "Word order, Byte order, Endianness, Swap",
    Meaning.TABLE: "Function, Function code, FC, Register type, Table, Object type",
    Meaning.ACCESS: "Access, R/W, RW, Read/Write, Action (R/W/WC), writable, Zugriff, Mode",
    Meaning.UNIT: "Unit, Units, UoM, Einheit, Engineering units, unit_of_measurement",
    Meaning.SCALE: "Scale, Scale factor, Factor, Multiplier, Resolution, Faktor, Gain",
    Meaning.DIVISOR: "Divisor, Divide by",
    Meaning.OFFSET: "Offset",
    Meaning.MINIMUM: "Min, Minimum, Min value",
    Meaning.MAXIMUM: "Max, Maximum value",
    Meaning.RANGE: "Range, Value range",
    Meaning.DEFAULT: "Default, Default value, Factory setting",
    Meaning.TEXTS: "Values, Enum, Options",
    Meaning.BIT: "Bit, Bit number",
    None: "Slave address, Unit ID, #, No., Colour, ",
}  # fmt: skip


@pytest.mark.parametrize(("meaning", "headings"), HEADINGS.items())
def test_a_heading_has_its_meaning(meaning: Meaning | None, headings: str) -> None:
    for heading in headings.split(","):
        assert meaning_of(heading.strip()) is meaning, heading


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_the_delimiter_is_found(delimiter: str) -> None:
    sheet = find_sheet("address,name,unit\n1,a,V\n".replace(",", delimiter), "map.csv")
    assert [column.meaning for column in sheet.columns] == ["address", "name", "unit"]


def test_the_row_of_headings_is_the_one_with_most_of_them() -> None:
    text = "Pump register list,address book\n\nregister,name,type\n1,a,INT\n"
    sheet = find_sheet(text, "map.csv")
    assert sheet.heading_row == 2
    assert sheet.rows[3] == ["1", "a", "INT"]


def test_of_two_columns_of_a_meaning_the_first_counts() -> None:
    sheet = find_sheet("address,type,data type,colour\n", "map.csv")
    assert [column.heading for column in sheet.columns] == ["address", "type"]


def test_a_column_that_is_named_is_the_only_one_of_its_meaning() -> None:
    named = {Meaning.ADDRESS: "number", Meaning.TYPE: "DATA  TYPE"}
    sheet = find_sheet("address,type,data type,number\n", "map.csv", named)
    assert {column.meaning: (column.heading, column.is_named) for column in sheet.columns} == {
        Meaning.TYPE: ("data type", True),
        Meaning.ADDRESS: ("number", True),
    }


def test_the_row_of_headings_is_the_one_that_has_the_named_ones() -> None:
    text = "address,name,type\nNummer,Wert\n1,a\n"
    assert find_sheet(text, "map.csv", {Meaning.ADDRESS: "Nummer"}).heading_row == 1


@pytest.mark.parametrize(
    ("text", "named", "said"),
    [
        ("", {}, "is empty"),
        ("\n\n", {}, "is empty"),
        ("a,b\n1,2\n", {}, "--column address=HEADING; row 1 has 'a', 'b'"),
        (
            "address,name\n",
            {Meaning.TYPE: "typ"},
            "no column is headed 'typ'; row 1 has 'address', 'name'",
        ),
        ("address,name,name\n", {Meaning.NAME: "name"}, "2 columns are headed 'name'"),
        (
            "address,register\n",
            {},
            "'address' and 'register' may be columns of addresses; say which",
        ),
    ],
)
def test_columns_that_are_not_there_or_not_clear_are_told(
    text: str, named: dict[Meaning, str], said: str
) -> None:
    with pytest.raises(UsageError, match=re.escape(said)):
        find_sheet(text, "map.csv", named)


def test_headings_are_looked_for_in_the_first_rows_only() -> None:
    with pytest.raises(UsageError, match=f"in its first {MAX_PREAMBLE} rows"):
        find_sheet("x\n" * MAX_PREAMBLE + "address,name\n", "map.csv")


def test_a_row_of_very_many_columns_is_refused_at_once() -> None:
    with pytest.raises(UsageError, match="more than 1,000 columns"):
        find_sheet("address," * 50_000, "map.csv")


def test_cells_may_have_line_ends_in_quotes() -> None:
    sheet = find_sheet('address,name\n1,"two\nlines"\n', "map.csv")
    assert sheet.rows[1] == ["1", "two\nlines"]


@given(st.text(max_size=80))
def test_any_heading_has_a_meaning_or_none(text: str) -> None:
    meaning_of(text)
