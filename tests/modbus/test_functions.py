"""The function table against the standard."""

from __future__ import annotations

import pytest

from mbtool.modbus.functions import (
    ECHOING,
    EXCEPTION_BIT,
    FUNCTIONS,
    NEVER_ECHOED,
    QUERY_DATA,
    READ_BITS,
    READ_LIMIT,
    READ_REGISTERS,
    READS,
    WRITE_LIMIT_17H,
    WRITE_ONE,
    WRITE_SEVERAL,
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


def test_functions_are_grouped_by_what_their_response_repeats() -> None:
    # V1.1b3, section 6; 2B is answered by its MEI type, 08 by its sub-function.
    assert set(READ_BITS) == {0x01, 0x02}
    assert set(READ_REGISTERS) == {0x03, 0x04, 0x17}
    assert set(READS) == {0x01, 0x02, 0x03, 0x04, 0x17}
    assert set(WRITE_ONE) == {0x05, 0x06, 0x16}
    assert set(WRITE_SEVERAL) == {0x0F, 0x10}
    assert set(ECHOING) == {0x05, 0x06, 0x08, 0x15, 0x16}
    assert sorted(NEVER_ECHOED) == list(bytes.fromhex("01 02 03 04 07 0B 0C 0F 10 11 14 17 18"))
    assert (QUERY_DATA, READ_LIMIT, WRITE_LIMIT_17H, EXCEPTION_BIT) == (0, 125, 121, 0x80)


def test_exception_codes_have_the_names_of_the_standard() -> None:
    assert {code: exception_name(code) for code in range(12)} == {
        0x00: "exception 00H",
        0x01: "illegal function",
        0x02: "illegal data address",
        0x03: "illegal data value",
        0x04: "server device failure",
        0x05: "acknowledge",
        0x06: "server device busy",
        0x07: "negative acknowledge",
        0x08: "memory parity error",
        0x09: "exception 09H",
        0x0A: "gateway path unavailable",
        0x0B: "gateway target failed to respond",
    }


def test_a_function_without_a_quantity_has_a_limit_of_one() -> None:
    assert {code for code, one in FUNCTIONS.items() if one.limit == 1 and one.table} == {5, 6, 0x16}
    assert FUNCTIONS[0x18].limit == 31  # 6.18: a FIFO queue has at most 31 registers.
