"""The function table against the standard."""

from __future__ import annotations

import pytest

from mbtool.modbus.functions import (
    FUNCTIONS,
    ExceptionCode,
    exception_name,
    function_name,
    short_name,
)
from mbtool.modbus.tables import Table

# V1.1b3, section 6: code, table, the largest quantity, whether it writes.
STANDARD = [
    (0x01, Table.COILS, 2000, False),
    (0x02, Table.DISCRETE_INPUTS, 2000, False),
    (0x03, Table.HOLDING_REGISTERS, 125, False),
    (0x04, Table.INPUT_REGISTERS, 125, False),
    (0x05, Table.COILS, 1, True),
    (0x06, Table.HOLDING_REGISTERS, 1, True),
    (0x0F, Table.COILS, 1968, True),
    (0x10, Table.HOLDING_REGISTERS, 123, True),
    (0x16, Table.HOLDING_REGISTERS, 1, True),
    (0x17, Table.HOLDING_REGISTERS, 125, True),
]


@pytest.mark.parametrize(("code", "table", "limit", "writes"), STANDARD)
def test_function_addresses_its_table(code: int, table: Table, limit: int, writes: bool) -> None:
    function = FUNCTIONS[code]
    assert (function.table, function.limit, function.writes) == (table, limit, writes)


def test_every_function_of_the_standard_is_there() -> None:
    codes = "01 02 03 04 05 06 07 08 0B 0C 0F 10 11 14 15 16 17 18 2B"
    assert sorted(FUNCTIONS) == list(bytes.fromhex(codes))
    assert {code for code, _, _, _ in STANDARD} == {
        code for code, function in FUNCTIONS.items() if function.table is not None
    }


def test_some_functions_belong_to_serial_lines_only() -> None:
    serial = [code for code, function in FUNCTIONS.items() if function.serial_only]
    assert serial == list(bytes.fromhex("07 08 0B 0C 11"))


def test_short_names_fit_a_narrow_column() -> None:
    assert all(len(function.short) <= 18 for function in FUNCTIONS.values())


def test_unknown_codes_have_a_name_too() -> None:
    assert function_name(0x03) == "read holding registers"
    assert function_name(0x41) == "function 41H"
    assert exception_name(0x02) == "illegal data address"
    assert exception_name(0x11) == "exception 11H"
    assert ExceptionCode(0x0B) is ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND


def test_a_makers_own_name_is_not_shortened() -> None:
    assert short_name(0x03, function_name(0x03)) == "read holding"
    assert short_name(0x03, "read words") == "read words"
    assert short_name(0x41, "remote reset") == "remote reset"
