"""Addresses as lists write them, and what they mean."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.importing.addresses import (
    ColumnPair,
    Counting,
    Numbering,
    Written,
    decide,
    difference_of,
    has_tables_in_front,
    is_bare_hex,
    numbering,
    pair,
    parse_address,
    reference_table,
    without_false_bits,
)
from mbtool.devices.model import Radix
from mbtool.modbus.tables import Table


def written(text: str, **flags: bool) -> Written:
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


def test_digits_with_letters_are_hexadecimal_where_the_whole_column_is() -> None:
    assert is_bare_hex(["0BB7", "0BB8", "3000"])
    assert written("3000", bare_hex=True).number == 0x3000
    assert not is_bare_hex(["3000", "3001"])
    assert not is_bare_hex(["D100", "D101"])


def test_0x_is_a_coil_beside_4x() -> None:
    assert has_tables_in_front(["0x0001", "4x0001"])
    assert written("0x0001", tables_in_front=True).prefix == "0x"
    assert written("0x0001", tables_in_front=True).radix is Radix.DECIMAL


def test_a_spreadsheets_decimal_is_no_bit() -> None:
    whole = without_false_bits([written("40001.0"), written("40002.0")])
    mixed = without_false_bits([written("40001.0"), written("40001.1")])
    assert [one.bit for one in whole if one] == [None, None]
    assert [one.bit for one in mixed if one] == [0, 1]


@pytest.mark.parametrize(
    ("texts", "hint", "counting"),
    [
        (["40001", "40012"], "", Counting.REFERENCES),
        (["30001", "40001", "00001"], "", Counting.REFERENCES),
        (["300001", "400012"], "", Counting.REFERENCES),
        (["40000", "40001"], "", Counting.ZERO_BASED),
        (["0", "1"], "address", Counting.ZERO_BASED),
        (["1", "2"], "address", Counting.ONE_BASED),
        (["1", "2"], "address 0 based", Counting.ZERO_BASED),
        (["5", "6"], "address 1 based", Counting.ONE_BASED),
        (["5", "6"], "address", Counting.ZERO_BASED),
    ],
)
def test_the_list_tells_how_it_counts(texts: list[str], hint: str, counting: Counting) -> None:
    assert decide([(written(text), None) for text in texts], hint, None)[0] is counting


def test_a_reference_must_fit_the_table_of_its_row() -> None:
    rows: list[tuple[Written, Table | None]] = [(written("30001"), Table.HOLDING_REGISTERS)]
    assert decide(rows, "", None)[0] is Counting.ZERO_BASED


def test_what_the_user_says_counts() -> None:
    assert decide([(written("0"), None)], "", Counting.ONE_BASED) == (
        Counting.ONE_BASED, "you said so",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "counting", "how"),
    [
        ("40010", Counting.REFERENCES, Numbering(Table.HOLDING_REGISTERS, 40001)),
        ("300010", Counting.REFERENCES, Numbering(Table.INPUT_REGISTERS, 300001)),
        ("00010", Counting.REFERENCES, Numbering(Table.COILS, 1)),
        ("4x0010", Counting.ZERO_BASED, Numbering(Table.HOLDING_REGISTERS, 1)),
        ("0x10", Counting.ONE_BASED, Numbering(None, 0)),
        ("IR10", Counting.ONE_BASED, Numbering(Table.INPUT_REGISTERS, 1)),
        ("10", Counting.ZERO_BASED, Numbering(None, 0)),
    ],
)
def test_a_number_counts_by_its_notation(text: str, counting: Counting, how: Numbering) -> None:
    assert numbering(written(text), counting, None) == how


@pytest.mark.parametrize(
    ("numbers", "pairing"),
    [
        ([(2999, 3000), (3001, 3002)], ColumnPair(0, True, 1)),
        ([(3000, 2999), (3002, 3001)], ColumnPair(0, False, -1)),
        ([(40001, 0), (40002, 1), (30001, 0)], ColumnPair(0, False, -1)),
        ([(40001, 1), (40002, 2)], ColumnPair(1, False, 0)),
        ([(5, 5), (6, 6)], None),
        ([(5, 100), (6, 200)], None),
        ([], None),
    ],
)
def test_two_columns_tell_which_is_the_wires(
    numbers: list[tuple[int, int]], pairing: ColumnPair | None
) -> None:
    assert pair(numbers) == pairing


@given(st.integers(0, 99_999), st.integers(0, 99_999))
def test_a_difference_forgets_the_tables(first: int, second: int) -> None:
    assert (first + difference_of(first, second) - second) % 10_000 == 0


@given(st.text(max_size=45), st.booleans(), st.booleans())
def test_any_text_is_an_address_or_none(text: str, hexadecimal: bool, in_front: bool) -> None:
    found = parse_address(text, bare_hex=hexadecimal, tables_in_front=in_front)
    assert found is None or found.number >= 0


@given(st.integers(0, 10**8), st.integers(1, 8))
def test_only_five_or_six_digits_make_a_reference(number: int, digits: int) -> None:
    table = reference_table(number, digits)
    assert table is None or digits in (5, 6)
