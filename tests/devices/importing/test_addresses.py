"""Addresses as lists write them, and what they mean."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.importing.addresses import (
    AddressCell,
    decide_style,
    parse_address,
    read_addresses,
    reference_table,
    table_and_base,
)
from mbtool.devices.importing.options import AddressStyle, ImportReport
from mbtool.devices.model import Radix
from mbtool.modbus.tables import Table


def written(text: str, **flags: bool) -> AddressCell:
    found = parse_address(text, **flags)
    assert found is not None, text
    return found


@pytest.mark.parametrize(
    ("text", "number", "prefix", "suffix", "radix"),
    [
        ("40001", 40001, "", "", Radix.DECIMAL),
        ("0x0102", 0x102, "0x", "", Radix.HEX),
        ("0102H", 0x102, "", "H", Radix.HEX),
        ("16#10", 0x10, "0x", "", Radix.HEX),
        ("4x0001", 1, "4x", "", Radix.DECIMAL),
        ("HR12", 12, "HR", "", Radix.DECIMAL),
        ("%MW 100", 100, "%MW", "", Radix.DECIMAL),
    ],
)
def test_an_address_is_read(text: str, number: int, prefix: str, suffix: str, radix: Radix) -> None:
    found = written(text)
    assert (found.number, found.prefix, found.suffix, found.radix) == (
        number, prefix, suffix, radix,
    )  # fmt: skip


@pytest.mark.parametrize("text", ["40001.3", "40001:3", "40001 bit 3", "40001.b3", "40001[3]"])
def test_a_bit_stands_behind_its_register(text: str) -> None:
    assert (written(text).number, written(text).bit) == (40001, 3)


@pytest.mark.parametrize(
    "text",
    [
        "40001-40004",
        "40001..40004",
        "40001 - 4",
        "40001\u201340004",
        "40001~40004",
        "40001,40002,40003,40004",
    ],
)
def test_a_range_has_its_last(text: str) -> None:
    assert (written(text).number, written(text).last) == (40001, 40004)


@pytest.mark.parametrize("text", ["", "x", "1,3", "40004-40001", "0-9999", "1e5", "-5", "4" * 50])
def test_what_is_no_address(text: str) -> None:
    assert parse_address(text) is None


def read(*cells: str, heading: str = "address") -> tuple[list[AddressCell], list[str]]:
    report = ImportReport()
    found = read_addresses(cells, heading, None, report)
    return [one for one in found if one is not None], report.remarks


@pytest.mark.parametrize(
    ("cells", "heading", "number"),
    [
        (("3000", "0BB7"), "address", 0x3000),
        (("3000", "3001"), "address", 3000),
        (("3000", "3001"), "address hex", 0x3000),
        (("D100", "D101"), "address", 100),
    ],
)
def test_digits_are_hexadecimal_if_letters_or_the_heading_show_it(
    cells: tuple[str, ...], heading: str, number: int
) -> None:
    found, told = read(*cells, heading=heading)
    assert found[0].number == number
    assert any("hexadecimal" in one for one in told) is (number == 0x3000)


def test_0x_is_a_coil_beside_4x() -> None:
    found, told = read("0x0001", "4x0001")
    assert found[0] == AddressCell(1, "0x", digits=4)
    assert told == ["0x0001 and its like are coils, as other addresses begin with 4x or 3x"]


def test_a_spreadsheets_decimal_is_no_bit() -> None:
    whole, told = read("40001.0", "40002.0")
    mixed, nothing = read("40001.0", "40001.1")
    assert [one.bit for one in whole] == [None, None]
    assert [one.bit for one in mixed] == [0, 1]
    assert told == ["addresses end in .0, which a spreadsheet adds, as all of them do"]
    assert nothing == []


def test_a_number_that_cannot_be_the_reference_it_must_be_is_an_error() -> None:
    with pytest.raises(ValueError, match="is no reference"):
        table_and_base(written("70001"), AddressStyle.REFERENCES)


@pytest.mark.parametrize(
    ("texts", "hint", "style"),
    [
        (["40001", "40012"], "", AddressStyle.REFERENCES),
        (["30001", "40001", "00001"], "", AddressStyle.REFERENCES),
        (["300001", "400012"], "", AddressStyle.REFERENCES),
        (["40000", "40001"], "", AddressStyle.ZERO_BASED),
        (["0", "1"], "address", AddressStyle.ZERO_BASED),
        (["1", "2"], "address", AddressStyle.ONE_BASED),
        (["1", "2"], "address 0 based", AddressStyle.ZERO_BASED),
        (["5", "6"], "address 1 based", AddressStyle.ONE_BASED),
        (["5", "6"], "address", AddressStyle.ZERO_BASED),
    ],
)
def test_the_list_tells_how_it_counts(texts: list[str], hint: str, style: AddressStyle) -> None:
    assert decide_style([(written(text), None) for text in texts], hint)[0] is style


def test_a_reference_must_fit_the_table_of_its_row() -> None:
    rows: list[tuple[AddressCell, Table | None]] = [(written("30001"), Table.HOLDING_REGISTERS)]
    assert decide_style(rows, "")[0] is AddressStyle.ZERO_BASED


@pytest.mark.parametrize(
    ("text", "style", "how"),
    [
        ("40010", AddressStyle.REFERENCES, (Table.HOLDING_REGISTERS, 40001)),
        ("300010", AddressStyle.REFERENCES, (Table.INPUT_REGISTERS, 300001)),
        ("00010", AddressStyle.REFERENCES, (Table.COILS, 1)),
        ("4x0010", AddressStyle.ZERO_BASED, (Table.HOLDING_REGISTERS, 1)),
        ("0x10", AddressStyle.ONE_BASED, (None, 0)),
        ("IR10", AddressStyle.ONE_BASED, (Table.INPUT_REGISTERS, 1)),
        ("10", AddressStyle.ZERO_BASED, (None, 0)),
    ],
)
def test_a_number_counts_by_its_notation(
    text: str, style: AddressStyle, how: tuple[Table | None, int]
) -> None:
    assert table_and_base(written(text), style) == how


@given(st.text(max_size=45), st.booleans(), st.booleans())
def test_any_text_is_an_address_or_none(text: str, hexadecimal: bool, in_front: bool) -> None:
    found = parse_address(text, bare_hex=hexadecimal, tables_in_front=in_front)
    assert found is None or found.number >= 0


@given(st.integers(0, 10**8), st.integers(1, 8))
def test_only_five_or_six_digits_make_a_reference(number: int, digits: int) -> None:
    table = reference_table(number, digits)
    assert table is None or digits in (5, 6)
