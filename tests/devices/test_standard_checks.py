from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.standard_checks import form_codes, is_quantity_wrong, padding_of, request_codes
from mbtool.modbus.adu import Transport, Verdict
from mbtool.modbus.transaction import Outcome
from tests.devices.checking.talk import transaction
from tests.devices.transactions import transaction as bare


@pytest.mark.parametrize(
    ("function", "address", "quantity", "codes"),
    [
        (0x03, 0, 125, []),
        (0x03, 0, 126, ["MB-104"]),
        (0x01, 0, 2000, []),
        (0x01, 0, 0, ["MB-104"]),
        (0x0F, 0, 1969, ["MB-104"]),
        (0x10, 0, 123, []),
        (0x03, 0xFFFF, 1, []),
        (0x03, 0xFFFF, 2, ["MB-106"]),
        (0x06, 0xFFFF, 1, []),
        (0x41, None, None, []),  # Its maker knows.
        (0x00, None, None, ["MB-107"]),
        (0x83, None, None, ["MB-107"]),
        (0x7C, None, None, []),
        (0x7F, None, None, ["MB-109"]),  # The standard reserves it.
        (0x03, None, None, []),
    ],
)
def test_a_request_is_checked_against_the_standard(
    function: int, address: int | None, quantity: int | None, codes: list[str]
) -> None:
    assert list(request_codes(function, address, quantity)) == codes


def test_what_function_17h_writes_has_a_limit_and_an_end_of_its_own() -> None:
    assert list(request_codes(0x17, 0, 1, (0, 121))) == []
    assert list(request_codes(0x17, 0, 1, (0, 122))) == ["MB-104"]
    assert list(request_codes(0x17, 0, 1, (0xFFFF, 2))) == ["MB-106"]
    assert is_quantity_wrong(0x17, None, (0, 0))


@pytest.mark.parametrize(
    ("request_", "answer", "codes"),
    [
        ("03 0000 0001", "03 02 1234", []),
        ("0F 0000 0003 02 05", "0F 0000 0003", ["MB-101"]),
        ("17 0000 0001 0000 0002 04 1234", "17 02 0001", ["MB-101"]),
        ("03 0000 0001 00", "83 03", ["MB-102"]),
        ("05 0000 FF", "85 03", ["MB-102"]),
        ("05 0000 1234", "85 03", ["MB-103"]),
        # A slave that repeats a wrong value truly does what it should.
        ("05 0000 1234", "05 0000 1234", ["MB-103"]),
        ("05 0000 FF00", "05 0001 FF00", ["MB-201"]),
        ("06 0000 0001", "06 0000 0002", ["MB-201"]),
        ("10 0000 0001 02 1234", "10 0000 0002", ["MB-201"]),
        ("16 0000 00F2 0025", "16 0000 00F2 0026", ["MB-201"]),
        ("03 0000 0002", "03 02 1234", ["MB-202"]),
        ("03 0000 0001", "03 04 1234", ["MB-202"]),
        ("01 0000 0009", "01 01 05", ["MB-202"]),
        ("06 0000 0001", "06 0000", ["MB-203"]),
        ("03 0000 0001", "83 02 00", ["MB-203"]),
        ("03 0000 0001", "83", ["MB-203"]),
        ("01 0000 0003", "01 01 0D", ["MB-204"]),
        ("01 0000 0003", "01 01 05", []),
        ("02 0000 0008", "02 01 FF", []),
        ("0F 0000 0003 01 FD", "0F 0000 0003", ["MB-105"]),
        ("0F 0000 0003 01 05", "0F 0000 0003", []),
    ],
)
@pytest.mark.parametrize("on_a_line", [False, True], ids=["tcp", "rtu"])
def test_the_form_is_checked_against_the_standard(
    request_: str, answer: str, codes: list[str], on_a_line: bool
) -> None:
    one = transaction(request_, answer, on_a_line=on_a_line)
    assert form_codes(one) == codes
    assert one.findings == codes


def test_a_response_without_a_request_has_its_form_checked() -> None:
    assert transaction("", "83 02 00").findings == ["MB-203"]
    assert transaction("", "10 0000 0300").findings == []


def test_padding_names_the_byte_and_the_bits_that_count() -> None:
    assert padding_of(transaction("01 0000 000B", "01 02 21FB")) == (0xFB, 3)
    assert padding_of(transaction("01 0000 000B", "01 02 2103")) is None


@given(raw=st.binary(max_size=20), answer=st.binary(max_size=20), function=st.integers(0, 255))
@pytest.mark.parametrize("transport", list(Transport))
def test_bytes_that_are_no_adu_do_no_harm(
    transport: Transport, raw: bytes, answer: bytes, function: int
) -> None:
    for outcome in (Outcome.OK, Outcome.MALFORMED, Outcome.EXCEPTION):
        one = bare(
            function,
            quantity=3,
            transport=transport,
            outcome=outcome,
            request_raw=raw,
            response_raw=answer,
            verdicts=[Verdict.MALFORMED_REQUEST, Verdict.MALFORMED_RESPONSE],
        )
        assert all(code.startswith("MB-") for code in form_codes(one))
        padding_of(one)
