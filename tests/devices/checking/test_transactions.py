from __future__ import annotations

from typing import Any

import pytest

from mbtool.devices.checking.transactions import TransactionRules, request_text
from tests.devices.checking.talk import assigned, transaction


def messages(*of: Any, profile: str | None = None, **fields: Any) -> list[tuple[str, str]]:
    one = transaction(*of, profile=profile, **fields)
    found = TransactionRules().check(one, assigned(profile).profile_for(one))
    return [(finding.code, finding.message) for finding in found]


@pytest.mark.parametrize(
    ("request_", "answer", "code", "message"),
    [
        (
            "03 0000 0000",
            "83 03",
            "MB-104",
            "read holding 0: quantity 0, the standard allows 1 to 125",
        ),
        (
            "17 0000 0001 FFFF 0002 04 12345678",
            "97 02",
            "MB-106",
            "read/write holding 0, write holding 65535..65536: 2 from FFFFH on, "
            "the last address is FFFFH",
        ),
        (
            "10 0000 0002 02 1234",
            "90 03",
            "MB-101",
            "write holding 0..1: 1 registers for a quantity of 2",
        ),
        ("05 0007 0001", "85 03", "MB-103", "write coil 7: value 0001H for a coil"),
        ("06 0001 0005", "06 0002 0005", "MB-201", "answer to write holding 1: address 2 for 1"),
        (
            "01 0000 0001",
            "01 01 03",
            "MB-204",
            "read coil 0: the last byte is 03H, of which 1 bit counts",
        ),
        ("00 00", "80 01", "MB-107", "a request with function 00H"),
    ],
)  # fmt: skip
def test_a_finding_of_the_standard_has_its_figures(
    request_: str, answer: str, code: str, message: str
) -> None:
    assert messages(request_, answer) == [(code, message)]


def test_the_write_quantity_of_17h_is_the_field_not_the_number_of_values() -> None:
    """2112H registers with a byte count of 2."""
    what = "read/write holding 3..4, write holding 14..8479"
    assert messages("17 0003 0002 000E 2112 02 00FF", "97 03") == [
        ("MB-104", f"{what}: writes 8466 registers, the standard allows 1 to 121"),
        ("MB-101", f"{what}: 1 registers for a quantity of 8466"),
    ]


@pytest.mark.parametrize(
    ("device", "request_", "answer", "code", "message"),
    [
        ("idec-ft1a-touch", "07", "87 01", "FT1A-F7", "the device has no read exception status"),
        (
            "idec-ft1a-touch",
            "03 0000 0080",
            "83 02",
            "FT1A-Q3",
            "read holding HR400001..400128: quantity 128, limit is 125",
        ),
        (
            "idec-ft1a-touch",
            "03 0000 0001",
            "83 03",
            "FT1A-E3",
            "read holding HR400001: exception 03 (illegal data value) is not documented",
        ),
        (
            "wago-750",
            "17 0000 0001 0000 0065 CA" + 101 * " 0000",
            "97 03",
            "WAGO-Q23",
            "read/write %IW0, write %QW0..100: reads 1, writes 101, at most 125 are read and 100 "
            "written",
        ),
        (
            "idec-ft1a-smartaxis",
            "06 2328 0001",
            "86 02",
            "SMARTAXIS-W6",
            "write register T0: one may only read there",
        ),
        (
            "fa3-at1m8x",
            "10 00F2 0004 08 0000 0000 0003 FFFF",
            "10 00F2 0004",
            "FA3-V16",
            "write registers 00F2H..00F5H: Destination alive check start interval timer 0 s, "
            "the range is 1..14400; Destination alive check interval timer 0 s, "
            "the range is 1..60; Split reception monitoring timer 65535 s, the range is 1..1200",
        ),
    ],
)  # fmt: skip
def test_a_finding_of_a_manual_has_its_figures(
    device: str, request_: str, answer: str, code: str, message: str
) -> None:
    assert messages(request_, answer, profile=device) == [(code, message)]


def test_a_value_within_its_range_is_no_finding() -> None:
    assert messages("06 00F2 3840", "06 00F2 3840", profile="fa3-at1m8x") == []
    # What is read was never asked for; the module clamps it.
    assert messages("03 00F2 0001", "03 02 FFFF", profile="fa3-at1m8x") == []


def test_a_request_is_described_in_few_words() -> None:
    assert request_text(transaction()) == "read holding 0"
    assert request_text(transaction(profile="idec-ft1a-touch")) == "read holding HR400001"
    assert request_text(transaction("42 00", "42 0016", profile="fa3-at1m8x")) == "read model name"
    assert request_text(transaction("16 0000 00F2 0025", None)) == "mask write holding 0"


def test_a_table_that_its_reference_names_is_not_named_twice() -> None:
    # Coil 10000 would be 10001, which is a discrete input.
    one = transaction("01 2710 0001", "81 02", profile="chino-lt830")
    assert request_text(one) == "read coil 10000"
    assert request_text(transaction("07", "87 01")) == "read exc status"
    unasked = transaction("", "01 01 01")
    assert request_text(unasked) == "read coils"
