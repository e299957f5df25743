"""Numbers, factors, rights and tables as lists write them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.importing.cells import (
    Factor,
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
from mbtool.devices.model import Access
from mbtool.modbus.tables import Table


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("5", 5), ("0.1", 0.1), ("0,1", 0.1), (" -12 ", -12), ("1e-3", 0.001), ("0x1F", 31),
        ("\u22125", -5), ("2.0", 2), (".5", 0.5), ("1.000.000", None), ("1e999", None),
        ("nan", None), ("five", None), ("", None),
    ],
)  # fmt: skip
def test_a_number_may_have_a_decimal_comma(text: str, number: float | None) -> None:
    assert parse_number(text) == number


@pytest.mark.parametrize(
    ("text", "factor"),
    [
        ("0.1", Factor(0.1)),
        ("10", Factor(10)),
        ("/10", Factor(10, divides=True)),
        ("1/10", Factor(10, divides=True)),
        ("\u00f7 100", Factor(100, divides=True)),
        ("x0.1", Factor(0.1, divides=False)),
        ("\u00d7 10", Factor(10, divides=False)),
        ("10^-1", Factor(0.1)),
        ("0", None),
        ("tenths", None),
    ],
)
def test_a_factor_may_say_what_it_is_for(text: str, factor: Factor | None) -> None:
    assert parse_factor(text) == factor


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("V", (None, "V")),
        ("0.1 V", (0.1, "V")),
        ("0,1°C", (0.1, "°C")),
        ("1/min", (None, "1/min")),
        ("m3/h", (None, "m3/h")),
        ("-", (None, None)),
    ],
)
def test_a_unit_may_have_a_factor_before_it(
    text: str, unit: tuple[float | None, str | None]
) -> None:
    assert parse_unit(text) == unit


@pytest.mark.parametrize(
    ("texts", "access"),
    [
        ("R, RO, R/O, read, read only, Read-Only, ReadOnly", Access.READ),
        ("W, WO, write, write only", Access.WRITE),
        ("RW, R/W, R&W, read/write, Read and write, rw*, R/WC", Access.READ_WRITE),
        ("x, 3, reading", None),
    ],
)
def test_rights_are_known(texts: str, access: Access | None) -> None:
    assert {parse_access(one) for one in texts.split(",")} == {access}


@pytest.mark.parametrize(
    ("texts", "table"),
    [
        ("3; 03; 0x03; FC03; FC 3; 03/06/16; 03H, 06H, 10H; 4x; HR; holding; Holding register; "
         "F3_HOLDING_REGS; Read Holding Registers (3); register; Halteregister",
         Table.HOLDING_REGISTERS),
        ("4; FC04; 3x; IR; Input Register; input; analog input; Eingangsregister",
         Table.INPUT_REGISTERS),
        ("1; FC01; 01,05,15; coil; Coil status; DO; digital output; 0x; Spulen; Digitale Ausgänge",
         Table.COILS),
        ("2; FC=02; 1x; DI; discrete input; Digital Input; input status; Diskrete Eingänge",
         Table.DISCRETE_INPUTS),
        ("x; 99; 3/4; 7", None),
    ],
)  # fmt: skip
def test_tables_are_known(texts: str, table: Table | None) -> None:
    for text in texts.split(";"):
        reach = parse_table(text.strip())
        assert (reach.table if reach else None) == table, text


def test_the_functions_of_a_cell_are_kept() -> None:
    reach = parse_table("03H, 06H, 10H")
    assert reach is not None
    assert reach.functions == (3, 6, 16)


@pytest.mark.parametrize(
    ("text", "texts"),
    [
        ("0=stopped, 1=running", {0: "stopped", 1: "running"}),
        ("0: off; 1: on", {0: "off", 1: "on"}),
        ("0 - off\n1 - on", {0: "off", 1: "on"}),
        ("0x01=a, b|0x02=c", {1: "a, b", 2: "c"}),
        ("-1 = unknown", {-1: "unknown"}),
        ("see table 3", None),
        ("0=a, b", {0: "a, b"}),
        ("0: off 1: on", {0: "off", 1: "on"}),
        ("0 = Aus  1 = Auto  2 = Sommer", {0: "Aus", 1: "Auto", 2: "Sommer"}),
        ("00=aus, 01=an", {0: "aus", 1: "an"}),
    ],
)
def test_texts_stand_behind_their_numbers(text: str, texts: dict[int, str] | None) -> None:
    assert parse_texts(text) == texts


@pytest.mark.parametrize(
    ("text", "bits"),
    [
        ("Bit0: too hot, Bit1: low oil", {0: "too hot", 1: "low oil"}),
        ("Bit 3 = Alarm", {3: "Alarm"}),
        ("bit 0 - on\nbit 15 - off", {0: "on", 15: "off"}),
        ("B0: on B1: off", {0: "on", 1: "off"}),
        ("Bit 16 = beyond", None),
        ("Bit 0-3: mode", None),
        ("0 = off", None),
    ],
)
def test_bits_stand_behind_their_numbers(text: str, bits: dict[int, str] | None) -> None:
    assert parse_bits(text) == bits


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("0..100", (0, 100)),
        ("-50 to 150", (-50, 150)),
        ("0,5 - 1,5", (0.5, 1.5)),
        ("0~65535", (0, 65535)),
        ("100..0", None),
        ("any", None),
    ],
)
def test_a_range_has_two_ends(text: str, span: tuple[float, float] | None) -> None:
    assert parse_range(text) == span


@given(st.text(max_size=40))
def test_any_text_is_read_or_not(text: str) -> None:
    number = parse_number(text)
    assert number is None or math.isfinite(number)
    factor = parse_factor(text)
    assert factor is None or factor.number != 0
    for parse in (
        parse_unit,
        parse_access,
        parse_table,
        parse_texts,
        parse_bits,
        parse_range,
        is_nothing,
    ):
        parse(text)
