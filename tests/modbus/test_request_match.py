"""Which response belongs to which request."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus.expected_response import (
    ExpectedResponse,
    is_response_code,
    is_response_to,
    mismatch,
)
from mbtool.modbus.pdu import parse_pdu
from tests.strategies import Exchange, exchanges

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
READ = bytes.fromhex("03 006B 0003")


@pytest.mark.parametrize(
    ("request_", "response", "problem"),
    [
        ("03 006B 0003", "03 06 022B 0000 0064", None),
        ("03 006B 0003", "03 04 022B 0000", "2 registers for a quantity of 3"),
        ("01 0000 0011", "01 03 000000", None),
        ("01 0000 0010", "01 03 000000", "3 bytes of bits for a quantity of 16"),
        ("05 0001 FF00", "05 0001 FF00", None),
        ("05 0001 FF00", "05 0002 FF00", "address 2 for 1"),
        ("05 0001 FF00", "05 0001 0000", "value 0000H for FF00H"),
        ("08 0001 0000", "08 0002 0000", "sub function 2 for 1"),
        ("0F 0000 0008 01 FF", "0F 0000 0009", "quantity 9 for 8"),
        ("10 0001 0001 02 0000", "10 0001 0001", None),
        ("10 0001 0001 02 0000", "10 0002 0001", "address 2 for 1"),
        ("16 0001 00F2 0025", "16 0001 00F3 0025", "and mask 243 for 242"),
        ("16 0001 00F2 0025", "16 0001 00F2 0026", "or mask 38 for 37"),
        ("17 0000 0001 0009 0001 02 0000", "17 02 1234", None),
        (
            "17 0000 0001 0009 0001 02 0000",
            "17 04 1234 0000",
            "2 registers for a quantity of 1",
        ),
        ("08 0000 A537", "08 0000 A537", None),
        ("08 0000 A537", "08 0000 A536", "data (42294,) for (42295,)"),
        ("2B 0E 01 00", "2B 0D", "mei type 13 for 14"),
        ("07", "07 6D", None),
    ],
)
def test_response_belongs_to_its_request(request_: str, response: str, problem: str | None) -> None:
    asked = parse_pdu(bytes.fromhex(request_), REQUEST)
    answer = bytes.fromhex(response)
    assert mismatch(asked, parse_pdu(answer, RESPONSE)) == problem
    assert is_response_to(asked, answer) == (problem is None)


@pytest.mark.parametrize(
    ("response", "fits"),
    [("83 02", True), ("83", False), ("83 02 00", False), ("84 02", False), ("", False)],
)
def test_exception_response_belongs_to_a_request_of_its_function(response: str, fits: bool) -> None:
    assert is_response_to(parse_pdu(READ, REQUEST), bytes.fromhex(response)) is fits


def test_function_code_above_127_is_answered_by_itself_only() -> None:
    assert is_response_code(0x83, 0x83)
    assert not is_response_code(0x83, 0x03)
    assert is_response_code(0x03, 0x83)


@given(exchange=exchanges(), place=st.integers(0, 300), byte=st.integers(0, 255))
def test_a_response_that_fits_by_its_bytes_belongs_to_its_request(
    exchange: Exchange, place: int, byte: int
) -> None:
    """The comparison of a response by its bytes is stricter than that by its fields."""
    expected = ExpectedResponse.of(exchange.request)
    if expected is None or exchange.response is None:
        return
    asked = parse_pdu(exchange.request, REQUEST)
    assert is_response_to(asked, exchange.response)
    at = place % len(exchange.response)
    altered = exchange.response[:at] + bytes([byte]) + exchange.response[at + 1 :]
    answer = parse_pdu(altered, RESPONSE)
    if expected.fits(altered) and answer.problem is None:
        assert mismatch(asked, answer) is None


@pytest.mark.parametrize("sub_function", [0x0001, 0x0002, 0x000A, 0x0100])
def test_only_return_query_data_must_return_its_data(sub_function: int) -> None:
    request, response = (b"\x08" + sub_function.to_bytes(2) + data for data in (b"\0\0", b"\0\7"))
    assert is_response_to(parse_pdu(request, REQUEST), response)


def test_values_of_another_function_than_08_may_differ() -> None:
    assert is_response_to(parse_pdu(bytes.fromhex("17 0000 0001 0009 0001 02 0007"), REQUEST),
                          bytes.fromhex("17 02 0008"))  # fmt: skip
