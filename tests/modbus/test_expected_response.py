"""The response that a request asks for."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus.expected_response import ExpectedResponse, is_response_to
from mbtool.modbus.pdu import exception_pdu, parse_pdu
from tests.strategies import Exchange, Message, exchanges, messages

READ = bytes.fromhex("03 006B 0003")
UNKNOWN_SIZE = 0
MAX_KNOWN = 1024


def of(request: str) -> ExpectedResponse:
    expected = ExpectedResponse.of(bytes.fromhex(request))
    assert expected is not None
    return expected


@pytest.mark.parametrize(
    ("request_", "head", "size"),
    [
        ("01 0000 0011", "01 03", 5),
        ("02 0000 0010", "02 02", 4),
        ("03 006B 0003", "03 06", 8),
        ("04 0008 007D", "04 FA", 252),
        ("05 0004 FF00", "05 0004 FF00", 5),
        ("06 0001 0003", "06 0001 0003", 5),
        ("07", "07", 2),
        ("08 0000 A537 0001", "08 0000 A537 0001", 7),
        ("08 000A 0000", "08 000A", 5),
        ("0B", "0B", 5),
        ("0C", "0C", UNKNOWN_SIZE),
        ("0F 0013 000A 02 CD01", "0F 0013 000A", 5),
        ("10 0001 0002 04 000A 0102", "10 0001 0002", 5),
        ("11", "11", UNKNOWN_SIZE),
        ("14 07 06 0004 0001 0002", "14", UNKNOWN_SIZE),
        ("15 07 06 0004 0007 0000", "15 07 06 0004 0007 0000", 9),
        ("16 0004 00F2 0025", "16 0004 00F2 0025", 7),
        ("17 0003 0006 000E 0003 06 00FF 00FF 00FF", "17 0C", 14),
        ("18 04DE", "18", UNKNOWN_SIZE),
        ("2B 0E 01 00", "2B 0E", UNKNOWN_SIZE),
        ("41 0102 03", "41", UNKNOWN_SIZE),
    ],
)
def test_response_follows_from_the_request(request_: str, head: str, size: int) -> None:
    expected = of(request_)
    code = int(request_[:2], 16)
    assert (expected.code, expected.prefix, expected.size) == (code, bytes.fromhex(head), size)


def test_force_listen_only_has_no_response() -> None:
    assert ExpectedResponse.of(bytes.fromhex("08 0004 0000")) is None


@pytest.mark.parametrize(
    ("response", "fits"),
    [
        ("03 06 022B 0000 0064", True),
        ("03 04 022B 0000", False),
        ("03 06 022B 0000", False),
        ("04 06 022B 0000 0064", False),
        ("83 02", True),
        ("83 12", True),
        ("83", False),
        ("83 02 00", False),
        ("84 02", False),
    ],
)
def test_response_fits_or_not(response: str, fits: bool) -> None:
    assert of(READ.hex()).fits(bytes.fromhex(response)) is fits


def test_request_for_contacts_may_have_the_form_of_its_own_response() -> None:
    contacts = "01 03E8 0011"
    assert of(contacts).fits(bytes.fromhex(contacts))
    assert not of("01 03E8 0010").fits(bytes.fromhex("01 03E8 0010"))


@pytest.mark.parametrize("quantity", ["0080", "00FF", "FFFF"])
def test_quantity_that_no_response_can_hold_fits_an_exception_only(quantity: str) -> None:
    expected = of(f"03 0000 {quantity}")
    byte_count = 2 * int(quantity, 16) & 0xFF
    assert not expected.fits(bytes((0x03, byte_count)) + bytes(byte_count))
    assert expected.fits(exception_pdu(3, 3))


def test_function_names_its_response_and_its_exception() -> None:
    expected = of(READ.hex())
    assert expected.is_named_by(0x03)
    assert expected.is_named_by(0x83)
    assert not expected.is_named_by(0x04)


@pytest.mark.parametrize("request_", ["03", "03 00", "03 006B 00", "08", "08 00", "0F", "2B", "00"])
def test_request_that_is_cut_off_is_no_error(request_: str) -> None:
    expected = of(request_)
    assert not expected.fits(bytes.fromhex("7F 00 00"))


@given(exchange=exchanges())
def test_every_response_of_a_slave_that_keeps_the_rules_fits(exchange: Exchange) -> None:
    expected = ExpectedResponse.of(exchange.request)
    if expected is not None and exchange.response is not None:
        assert expected.fits(exchange.response)


@given(request=messages(Direction.REQUEST), other=messages(Direction.RESPONSE))
def test_a_pdu_that_is_a_response_when_parsed_fits(request: Message, other: Message) -> None:
    expected = ExpectedResponse.of(request.pdu)
    if request.code == 0x15 and other.pdu != request.pdu:
        return  # A written file record is echoed whole (V1.1b3, 6.15), which parsing does not ask.
    if expected is not None and is_response_to(
        parse_pdu(request.pdu, Direction.REQUEST), other.pdu
    ):
        assert expected.fits(other.pdu)


def test_requests_remembered_are_bounded() -> None:
    for number in range(2 * MAX_KNOWN):
        assert of(f"06 0001 {number:04X}").prefix == bytes((6, 0, 1, *number.to_bytes(2)))
    assert ExpectedResponse.of.cache_info().currsize == MAX_KNOWN


@given(exchanges(), st.data())
def test_the_first_bytes_of_a_fitting_response_fit(exchange: Exchange, data: st.DataObject) -> None:
    expected = ExpectedResponse.of(exchange.request)
    if expected is None or not exchange.response or not expected.fits(exchange.response):
        return
    size = len(exchange.response)
    kept = data.draw(st.integers(1, size))
    assert expected.fits_start(exchange.response[:kept], size)
    if expected.size != UNKNOWN_SIZE:
        assert not expected.fits_start(exchange.response[:kept], size + 1)


@pytest.mark.parametrize(
    ("request_", "start", "size", "fits"),
    [
        ("03 006B 0003", "03", 8, True),
        ("03 006B 0003", "03", 7, False),
        ("03 006B 0003", "03 06", 8, True),
        ("03 006B 0003", "03 05", 8, False),
        ("03 006B 0003", "03 06 FFFF", 8, True),
        ("03 006B 0003", "83", 2, True),
        ("03 006B 0003", "83", 3, False),
        ("03 006B 0003", "84", 2, False),
        ("03 006B 0003", "03", 2, False),
        ("11", "11", 2, True),
        ("11", "11 05", 99, True),
        ("06 0001 0003", "06 0001 00", 5, True),
        ("06 0001 0003", "06 0001 01", 5, False),
    ],
)
def test_a_response_may_begin_with_some_bytes(
    request_: str, start: str, size: int, fits: bool
) -> None:
    assert of(request_).fits_start(bytes.fromhex(start), size) is fits


def test_the_size_is_unknown_if_none_is_given() -> None:
    assert ExpectedResponse(3, b"\x03").size == UNKNOWN_SIZE
