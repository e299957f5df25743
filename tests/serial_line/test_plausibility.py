"""PDUs of a correct form whose contents no master or slave sends."""

from __future__ import annotations

import pytest
from hypothesis import given

from mbtool.core import Direction
from mbtool.serial_line.costs import (
    is_counted,
    is_implausible_request,
    is_implausible_response,
    is_padded,
)
from tests.strategies import Message, messages


@pytest.mark.parametrize(
    ("pdu", "odd"),
    [
        ("83 02", True),
        ("08 000B 0000", False),
        ("08 000B 0108", True),
        ("08 0000 A537", False),
        ("03 006B 0003", False),
    ],
)
def test_odd_requests_are_recognised(pdu: str, odd: bool) -> None:
    assert is_implausible_request(bytes.fromhex(pdu)) is odd


@pytest.mark.parametrize(
    ("pdu", "odd"),
    [
        ("83 02", False),
        ("83 12", False),
        ("83 00", True),
        ("92 93", True),
        ("03 02 022B", False),
        ("03 03 022B 00", True),
        ("01 03 022B 00", False),
    ],
)
def test_odd_responses_are_recognised(pdu: str, odd: bool) -> None:
    assert is_implausible_response(bytes.fromhex(pdu)) is odd


@pytest.mark.parametrize(
    ("pdu", "counted"),
    [
        ("10 0019 0008 10", True),
        ("10 0019 0008 0F", False),
        ("10 0019 0008", False),
        ("0F 0000 0009 02", True),
        ("0F 0000 0009 01", False),
        ("17 0000 0001 0009 0001 02", True),
        ("17 0000 0001 0009 0001 04", False),
        ("03 0000 0001 02", False),
    ],
)
def test_byte_count_agrees_with_the_quantity_or_not(pdu: str, counted: bool) -> None:
    assert is_counted(bytes.fromhex(pdu)) is counted


@pytest.mark.parametrize(
    ("quantity", "last", "padded"), [(16, 0xFF, True), (17, 0x01, True), (17, 0x02, False)]
)
def test_bits_behind_those_asked_for_are_0(quantity: int, last: int, padded: bool) -> None:
    request = bytes((0x01, 0, 0, 0, quantity))
    assert is_padded(request, bytes((0x01, 2, 0, last))) is padded


@given(message=messages(Direction.REQUEST))
def test_write_that_keeps_the_rules_is_counted(message: Message) -> None:
    if message.code in (0x0F, 0x10, 0x17):
        assert is_counted(message.pdu)
