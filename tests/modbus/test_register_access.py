"""The addresses and values that requests read and write."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus.functions import TABLE_FUNCTIONS
from mbtool.modbus.pdu import parse_pdu
from mbtool.modbus.register_access import (
    RegisterAccess,
    keeps_limits,
    register_access,
    response_to,
    values_after,
)
from mbtool.modbus.tables import Table

COILS, INPUTS = Table.COILS, Table.DISCRETE_INPUTS
HOLDING, REGISTERS = Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS


def _access(request: str) -> RegisterAccess | None:
    return register_access(parse_pdu(bytes.fromhex(request), Direction.REQUEST))


@pytest.mark.parametrize(
    ("request_", "access"),
    [
        ("01 0010 0003", RegisterAccess(COILS, reads=range(16, 19))),
        ("02 0010 0003", RegisterAccess(INPUTS, reads=range(16, 19))),
        ("03 006B 0003", RegisterAccess(HOLDING, reads=range(107, 110))),
        ("04 FFFF 0001", RegisterAccess(REGISTERS, reads=range(0xFFFF, 0x10000))),
        ("05 0010 FF00", RegisterAccess(COILS, writes=range(16, 17))),
        ("06 0010 1234", RegisterAccess(HOLDING, writes=range(16, 17))),
        ("0F 0010 0003 01 05", RegisterAccess(COILS, writes=range(16, 19))),
        ("10 0010 0002 04 0001 0002", RegisterAccess(HOLDING, writes=range(16, 18))),
        ("16 0010 00F2 0025", RegisterAccess(HOLDING, writes=range(16, 17))),
        ("17 0003 0006 000E 0001 02 00FF", RegisterAccess(HOLDING, range(3, 9), range(14, 15))),
        # Past the last address: that is no error of the form.
        ("03 FFFF 0002", RegisterAccess(HOLDING, range(0xFFFF, 0x10001))),
    ],
)
def test_gives_the_addresses_that_are_read_and_written(
    request_: str, access: RegisterAccess
) -> None:
    assert _access(request_) == access


@pytest.mark.parametrize(
    "request_",
    [
        "03 0000 0000",  # quantity 0
        "03 0000 007E",  # over the limit
        "03 0000",  # too short
        "05 0000 1234",  # neither on nor off
        "0F 0000 0009 01 FF",  # nine coils in one byte
        "10 0000 0002 02 0001",  # two registers in two bytes
        "17 0000 0000 000E 0001 02 00FF",  # reads nothing
        "18 0000",  # a FIFO queue
        "2B 0E 01 00",
        "41 00",
    ],
)
def test_a_wrong_request_or_one_without_a_table_has_no_register_access(request_: str) -> None:
    assert _access(request_) is None


@pytest.mark.parametrize(
    ("request_", "keeps"),
    [
        ("01 0300 07D0", True),
        ("01 0300 0000", False),
        ("02 0300 07D1", False),
        ("03 FFFF 0001", True),
        ("03 FFFF 0002", False),
        ("17 0003 0006 FFFF 0001 02 00FF", True),
        ("17 0003 0006 FFFF 0002 04 00FF 0001", False),
        ("14 07 06 0004 0001 0002", True),
        ("14 07 05 06 000D FE00 20", False),
        ("41 00", True),
    ],
)
def test_request_keeps_the_limits_of_its_function(request_: str, keeps: bool) -> None:
    assert keeps_limits(parse_pdu(bytes.fromhex(request_), Direction.REQUEST)) is keeps


@pytest.mark.parametrize(
    ("request_", "before", "after"),
    [
        ("05 0010 FF00", [0], (1,)),
        ("05 0010 0000", [1], (0,)),
        ("06 0010 1234", [0], (0x1234,)),
        ("0F 0010 0003 01 05", [0, 0, 0], (1, 0, 1)),
        ("10 0010 0002 04 0001 0002", [0, 0], (1, 2)),
        ("16 0010 00F2 0025", [0x12], (0x17,)),  # V1.1b3, 6.16
        ("17 0003 0006 000E 0002 04 00FF 0001", [0, 0], (0xFF, 1)),
    ],
)
def test_gives_the_values_after_a_write(
    request_: str, before: list[int], after: tuple[int, ...]
) -> None:
    assert values_after(parse_pdu(bytes.fromhex(request_), Direction.REQUEST), before) == after


@pytest.mark.parametrize(
    ("request_", "values", "response"),
    [
        ("01 0000 000B", [1, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0], "01 02 21 03"),
        ("04 0000 0001", [0x1234], "04 02 12 34"),
        ("06 0010 1234", [], "06 00 10 12 34"),
        ("10 0010 0001 02 0001", [], "10 00 10 00 01"),
        ("17 0003 0001 000E 0001 02 00FF", [7], "17 02 00 07"),
    ],
)
def test_makes_the_standards_response(request_: str, values: list[int], response: str) -> None:
    pdu = bytes.fromhex(request_)
    made = response_to(parse_pdu(pdu, Direction.REQUEST), pdu, values)
    assert made.hex(" ") == response


@given(st.sampled_from(sorted(TABLE_FUNCTIONS)), st.binary(max_size=260))
def test_a_request_with_register_access_can_be_executed(function: int, data: bytes) -> None:
    pdu = bytes([function]) + data
    request = parse_pdu(pdu, Direction.REQUEST)
    access = register_access(request)
    if access is None:
        return
    assert access.reads or access.writes
    if access.writes:
        assert len(values_after(request, [0] * len(access.writes))) == len(access.writes)
    response = response_to(request, pdu, [0] * len(access.reads))
    assert parse_pdu(response, Direction.RESPONSE).problem is None


def _request(code: int, quantity: int, written: int = 1) -> bytes:
    address = b"\x00\x10"
    match code:
        case 0x0F:
            data = bytes((quantity + 7) // 8)
        case 0x10:
            data = bytes(2 * quantity)
        case 0x17:
            count = written.to_bytes(2) + bytes([2 * written & 0xFF])
            return bytes([code]) + address + quantity.to_bytes(2) + address + count + bytes(
                2 * written
            )  # fmt: skip
        case _:
            return bytes([code]) + address + quantity.to_bytes(2)
    return bytes([code]) + address + quantity.to_bytes(2) + bytes([len(data) & 0xFF]) + data


@pytest.mark.parametrize(
    ("code", "limit"), [(1, 2000), (2, 2000), (3, 125), (4, 125), (0x0F, 1968), (0x10, 123)]
)
def test_each_function_has_a_least_and_a_largest_quantity(code: int, limit: int) -> None:
    for quantity in (0, 1, 2, limit - 1, limit, limit + 1):
        request = parse_pdu(_request(code, quantity), Direction.REQUEST)
        access = register_access(request)
        assert (access is not None) == (1 <= quantity <= limit), quantity
        if access is not None:
            sizes = len(access.reads), len(access.writes)
            assert sizes == ((0, quantity) if code in (0x0F, 0x10) else (quantity, 0))


def test_function_17h_reads_at_most_125_and_writes_at_most_121_registers() -> None:
    for reads, writes in ((1, 1), (125, 121), (126, 1), (1, 122), (0, 1), (1, 0)):
        request = parse_pdu(_request(0x17, reads, writes), Direction.REQUEST)
        access = register_access(request)
        assert (access is not None) == (1 <= reads <= 125 and 1 <= writes <= 121)


def test_a_function_without_a_quantity_accesses_one_address_and_nothing_else() -> None:
    for request in ("05 0010 FF00", "06 0010 1234", "16 0010 00F2 0025"):
        access = _access(request)
        assert access is not None
        assert (access.reads, access.writes) == (range(0), range(16, 17))
    reading = _access("03 0010 0001")
    assert reading is not None
    assert reading.writes == range(0)


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("05 0010 FF00", "05 0010 FF00"),
        ("0F 0010 0003 01 05", "0F 0010 0003"),
        ("16 0010 00F2 0025", "16 0010 00F2 0025"),
    ],
)
def test_a_write_is_confirmed_by_its_first_bytes(request_: str, response: str) -> None:
    pdu = bytes.fromhex(request_)
    assert response_to(parse_pdu(pdu, Direction.REQUEST), pdu, []) == bytes.fromhex(response)
