"""Headings of register lists."""

from __future__ import annotations

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
    Meaning.ORDER: "Word order, Byte order, Endianness, Swap",
    Meaning.TABLE: "Function, Function code, FC, Register type, Table, Object type",
    Meaning.ACCESS: "Access, R/W, RW, Read/Write, Action (R/W/WC), writable, Zugriff, Mode",
    Meaning.UNIT: "Unit, Units, UoM, Einheit, Engineering units, unit_of_measurement",
    Meaning.SCALE: "Scale, Scale factor, Factor, Multiplier, Resolution, Faktor",
    Meaning.GAIN: "Gain",
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


@pytest.mark.parametrize(
    ("heading", "meaning"),
    [(one.strip(), meaning) for meaning, all_ in HEADINGS.items() for one in all_.split(",")],
)
def test_a_heading_has_its_meaning(heading: str, meaning: Meaning | None) -> None:
    assert meaning_of(heading) is meaning


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_the_delimiter_is_found(delimiter: str) -> None:
    sheet = find_sheet("address,name,unit\n1,a,V\n".replace(",", delimiter), "map.csv")
    assert [column.meaning for column in sheet.columns] == ["address", "name", "unit"]


def test_the_row_of_headings_is_the_one_with_most_of_them() -> None:
    text = "Pump register list,address book\n\nregister,name,type\n1,a,INT\n"
    sheet = find_sheet(text, "map.csv")
    assert sheet.heading_row == 2
    assert sheet.rows[3] == ["1", "a", "INT"]


def test_an_offset_is_the_address_where_nothing_else_is() -> None:
    with_address = find_sheet("address,name,offset\n", "map.csv")
    without = find_sheet("name,offset\n", "map.csv")
    assert with_address.column(Meaning.OFFSET) is not None
    assert without.column(Meaning.OFFSET) is None
    address = without.column(Meaning.ADDRESS)
    assert address is not None
    assert address.index == 1


def test_of_two_columns_of_a_meaning_the_second_is_unused() -> None:
    sheet = find_sheet("address,type,data type,colour\n", "map.csv")
    assert sheet.unused == ("data type", "colour")


def test_a_heading_that_is_known_whole_counts_before_one_that_is_not() -> None:
    sheet = find_sheet("address,input type of it,data type\n", "map.csv")
    column = sheet.column(Meaning.TYPE)
    assert column is not None
    assert column.heading == "data type"
    assert sheet.unused == ("input type of it",)


def test_headings_are_looked_for_in_the_first_rows_only() -> None:
    with pytest.raises(UsageError, match=f"in its first {MAX_PREAMBLE} rows"):
        find_sheet("x\n" * MAX_PREAMBLE + "address,name\n", "map.csv")


def test_cells_may_have_line_ends_in_quotes() -> None:
    sheet = find_sheet('address,name\n1,"two\nlines"\n', "map.csv")
    assert sheet.rows[1] == ["1", "two\nlines"]


@given(st.text(max_size=80))
def test_any_heading_has_a_meaning_or_none(text: str) -> None:
    meaning_of(text)
