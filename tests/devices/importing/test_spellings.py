"""Spellings of types and orders."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.importing.spellings import (
    HIGH_LOW,
    HIGH_SWAPPED,
    LOW_HIGH,
    LOW_SWAPPED,
    Order,
    parse_order,
    parse_type,
)

SPELLINGS = {
    "uint16": "UINT16, U16, uint_16, uint16_t, WORD, unsigned, unsigned int, "
    "Unsigned 16-bit integer, 16-bit unsigned, INT16U, USHORT, UINT8, byte, ENUM, acc16, "
    "16bit, enum16",
    "int16": "INT, INT16, S16, i16, short, signed 16 bit, int 16, sunssf, SINT, integer, signed",
    "uint32": "UINT32, U32, DWORD, UDINT, ulong, INT32U, acc32, 32BIT_UINT, bitfield32, enum32",
    "int32": "INT32, S32, DINT, long, Signed Long, 32-bit integer, i32",
    "uint64": "UINT64, ULINT, LWORD, u64, 64bit",
    "int64": "INT64, LINT, s64, long long",
    "float32": "FLOAT, FLOAT32, REAL, F32, single, IEEE754, Float IEEE 754, 32-bit float, floating "
    "point, IEEE 754 float",
    "float64": "double, LREAL, FLOAT64, f64, 64 bit float",
    "bcd16": "BCD, BCD16, bcd4, packed BCD",
    "bcd32": "BCD32, BCD8, 32 bit BCD",
    "hex16": "HEX, bitfield, bitfield16, BITMAP, Flags, bit string, raw",
    "bit": "BOOL, boolean, Bit, digital, COIL, on/off",
    "string": "STRING, ASCII, STRING[16], CHAR(20), UTF8, Text, STR16",
}  # fmt: skip


@pytest.mark.parametrize(("type_", "spellings"), SPELLINGS.items())
def test_a_spelling_is_known(type_: str, spellings: str) -> None:
    for spelling in spellings.split(","):
        kind = parse_type(spelling.strip())
        assert kind is not None, spelling
        assert kind.type == type_, spelling


@pytest.mark.parametrize(
    ("spelling", "registers", "type_"),
    [
        ("INT", 2, "int32"),
        ("unsigned", 4, "uint64"),
        ("float", 4, "float64"),
        ("BCD", 2, "bcd32"),
        ("hex", 2, "uint32"),
        ("UINT16", 2, "uint16"),
        ("long", 1, "int32"),
    ],
)
def test_registers_decide_where_the_spelling_does_not(
    spelling: str, registers: int, type_: str
) -> None:
    kind = parse_type(spelling, registers)
    assert kind is not None
    assert kind.type == type_


@pytest.mark.parametrize(
    "spelling",
    [
        "",
        "FLOTE",
        "u4",
        "16",
        "x",
        "uint",
        "s",
        "INT24",
        "FLOAT16",
        "DATETIME",
        "U16x2",
        "date time",
        "int3264",
    ],
)
def test_what_is_not_known_whole_is_no_type(spelling: str) -> None:
    known = {"uint": "uint16", "s": None}
    kind = parse_type(spelling)
    assert (kind.type if kind else None) == known.get(spelling)


@pytest.mark.parametrize(
    ("spelling", "length", "is_registers"),
    [("STRING[16]", 16, False), ("STRING16", 16, False), ("ASCII 8 registers", 8, True)],
)
def test_a_string_may_say_its_length(spelling: str, length: int, is_registers: bool) -> None:
    kind = parse_type(spelling)
    assert kind is not None
    assert (kind.length, kind.length_is_registers) == (length, is_registers)


@pytest.mark.parametrize(
    ("spelling", "type_", "order"),
    [
        ("FLOAT32 CDAB", "float32", LOW_HIGH),
        ("32BIT_UINT_3412", "uint32", LOW_HIGH),
        ("REAL (swapped)", "float32", LOW_HIGH),
        ("Float (big endian)", "float32", HIGH_LOW),
        ("float32_le", "float32", LOW_SWAPPED),
        ("UINT32_BE", "uint32", HIGH_LOW),
        ("INT32 word swap", "int32", LOW_HIGH),
        ("UINT32 byte-swap", "uint32", HIGH_SWAPPED),
        ("float inverse", "float32", LOW_HIGH),
        ("UINT32 (big-endian, word swapped)", "uint32", LOW_HIGH),
        ("UINT32 (low word first)", "uint32", LOW_HIGH),
        ("INT32, high word first", "int32", HIGH_LOW),
        ("UINT32 (niederwertiges Wort zuerst)", "uint32", LOW_HIGH),
    ],
)
def test_a_type_may_bring_its_order_along(spelling: str, type_: str, order: Order) -> None:
    kind = parse_type(spelling)
    assert kind is not None
    assert (kind.type, kind.order) == (type_, order)


@pytest.mark.parametrize(
    ("text", "order"),
    [
        ("ABCD", HIGH_LOW),
        ("cd ab", LOW_HIGH),
        ("B-A-D-C", HIGH_SWAPPED),
        ("DCBA", LOW_SWAPPED),
        ("3-4-1-2", LOW_HIGH),
        ("big-endian", HIGH_LOW),
        ("BE", HIGH_LOW),
        ("big-endian word swap", LOW_HIGH),
        ("Big-endian byte swap", HIGH_SWAPPED),
        ("little endian", LOW_SWAPPED),
        ("Little-endian byte swap", LOW_HIGH),
        ("LSW first", LOW_HIGH),
        ("Hi-Lo", HIGH_LOW),
        ("high word first", HIGH_LOW),
        ("low word", LOW_HIGH),
        ("swapped", LOW_HIGH),
        ("none", HIGH_LOW),
        ("ghefcdab", LOW_HIGH),
        ("sideways", None),
        ("", None),
    ],
)
def test_an_order_is_known(text: str, order: Order | None) -> None:
    assert parse_order(text) == order


@given(st.text(max_size=40), st.none() | st.integers(1, 125))
def test_any_text_is_a_type_or_none(text: str, registers: int | None) -> None:
    parse_type(text, registers)
    parse_order(text)


def test_a_very_long_cell_names_no_type() -> None:
    assert parse_type(f"STRING[{'9' * 5000}]") is None
    assert parse_type(f"UINT{'9' * 5000}") is None
