"""What manuals say of responses and units, case by case: who is wrong, and what is told."""

from __future__ import annotations

from typing import Any

import pytest

from mbtool.devices.checking.transactions import TransactionRules
from tests.devices.checking.talk import assigned, transaction

TOUCH, SMARTAXIS = "idec-ft1a-touch", "idec-ft1a-smartaxis"
TH1M16XC, WAGO, LT830 = "fa3-th1m16xc", "wago-750", "chino-lt830"


def told(request: str, answer: str | None, device: str | None, **fields: Any) -> dict[str, str]:
    one = transaction(request, answer, profile=device, **fields)
    found = TransactionRules().check(one, assigned(device).profile_for(one))
    return {finding.code: finding.message for finding in found}


@pytest.mark.parametrize(
    ("device", "request_", "answer", "code", "text"),
    [
        (SMARTAXIS, "03 07D0 0001", "83 03", "SMARTAXIS-C3",
         "exception 03 (device quantity error or 1-bit write data error), but the manual has 02 "
         "(access destination error)"),
        (SMARTAXIS, "03 0000 0000", "83 02", "SMARTAXIS-C2",
         "exception 02 (access destination error), but the manual has 03 (device quantity error "
         "or 1-bit write data error)"),
        (SMARTAXIS, "05 0000 1234", "85 02", "SMARTAXIS-C2", "but the manual has 03 ("),
        (SMARTAXIS, "07", "87 02", "SMARTAXIS-C2", "but the manual has 01 ("),
        (TOUCH, "03 0000 0001", "83 02", "FT1A-C2",
         "read holding HR400001: exception 02 (illegal data address), but nothing is wrong with "
         "the request"),
        (TOUCH, "03 0000 0001", "83 01", "FT1A-C1", "but nothing is wrong with the request"),
        (TH1M16XC, "02 0000 0001", "82 02", "FA3-C2", "but nothing is wrong with the request"),
        (TH1M16XC, "02 0010 0001", "82 01", "FA3-C1", "but the manual has 02 (device address"),
        (TH1M16XC, "41 00", "41 00", "FA3-R65", "41 00, the manual states no response"),
        (TH1M16XC, "42 00", "42 16", "FA3-R66", "42 16, the manual states two bytes"),
        (TH1M16XC, "42 00", "42 00 16 00", "FA3-R66", "the manual states two bytes"),
        (TH1M16XC, "43 00", "43 01", "FA3-R67", "answer to error clear: 43 01, it is not as sent"),
        (TH1M16XC, "44 00", "44", "FA3-R68", "44, it is not as sent"),
        (TH1M16XC, "44 00", "44 00 00", "FA3-R68", "44 00 00, it is not as sent"),
        (TH1M16XC, "42 00", "42 00 99", "FA3-M66",
         "answer to read model name: 42 00 99, the manual does not list this code"),
        (WAGO, "01 0000 0001", "81 03", "WAGO-E3", "exception 03 (illegal data value) is not"),
        (WAGO, "02 0000 0001", "82 04", "WAGO-E4", "exception 04 (slave device failure) is not"),
    ],
)  # fmt: skip
def test_a_wrong_response_is_the_slaves(
    device: str, request_: str, answer: str, code: str, text: str
) -> None:
    findings = told(request_, answer, device)
    assert text in findings[code]


@pytest.mark.parametrize(
    ("device", "request_", "answer"),
    [
        (SMARTAXIS, "03 07D0 0001", "83 02"),
        (SMARTAXIS, "03 0000 0000", "83 03"),
        (SMARTAXIS, "03 07D0 0000", "83 03"),  # Both are wrong, so either code is right.
        (SMARTAXIS, "03 07D0 0000", "83 02"),
        (SMARTAXIS, "03 0000 0001", "83 02"),  # Not every SmartAXIS has every device.
        (TOUCH, "03 0000 007E", "83 01"),  # Which code is for what is not stated.
        (TOUCH, "03 0000 007E", "83 02"),
        (TH1M16XC, "02 0000 0000", "82 02"),  # Nor what 03 is for.
        (TH1M16XC, "41 00", None),
        (TH1M16XC, "41 00", "C1 03"),
        (TH1M16XC, "42 00", "42 00 13"),
        (TH1M16XC, "43 00", "43 00"),
        (WAGO, "01 0000 0001", "81 02"),  # The node has no such module.
        (WAGO, "03 0000 0001", "83 04"),
        (LT830, "03 0000 0001", "83 02"),  # Which references exist is not known.
        (LT830, "10 0000 0001 02 7FFF", "90 11"),
    ],
)
def test_what_a_manual_states_or_leaves_open_is_no_fault_of_the_slave(
    device: str, request_: str, answer: str | None
) -> None:
    codes = told(request_, answer, device)
    assert {code.partition("-")[2][0] for code in codes if code != "MB-104"} <= {"Q", "A"}


def test_a_model_code_is_shown_as_the_manual_writes_it() -> None:
    shown = transaction("42 00", "42 00 99", profile=TH1M16XC)
    assert [(point.name, point.text) for point in shown.points] == [("Model code", "0099H")]
    known = transaction("42 00", "42 00 13", profile=TH1M16XC)
    assert [point.text for point in known.points] == ["FA3-TH1M16XC"]


@pytest.mark.parametrize("unit", [248, 255])
def test_a_unit_above_247_on_a_line_is_found(unit: int) -> None:
    findings = told("03 0000 0001", "03 02 1234", None, unit=unit, on_a_line=True)
    assert findings == {"MB-108": f"read holding 0: unit {unit}, 247 is the last"}
    assert told("03 0000 0001", "03 02 1234", None, unit=247, on_a_line=True) == {}
    assert told("03 0000 0001", "03 02 1234", None, unit=255) == {}  # Usual on Modbus/TCP.


def test_a_unit_that_the_manual_does_not_allow_is_found() -> None:
    findings = told("03 0000 0001", "03 02 1234", LT830, unit=100, on_a_line=True)
    assert findings == {"LT830-U100": "read holding 40001 of unit 100: units are 1 to 99"}
    assert told("03 0000 0001", "03 02 1234", LT830, unit=99, on_a_line=True) == {}
    assert "MB-108" in told("03 0000 0001", "03 02 1234", LT830, unit=248, on_a_line=True)


def test_more_than_a_doubtful_figure_is_a_note() -> None:
    findings = told("01 0064 0008", "01 01 FF", LT830, unit=2, on_a_line=True)
    assert findings == {
        "LT830-L1": "read coils 101..108: quantity 8, limit is 1, which is doubtful"
    }
    assert "LT830-Q1" in told("01 0064 0000", "81 03", LT830, unit=2, on_a_line=True)


@pytest.mark.parametrize(("device", "code"), [(None, "MB-104"), (WAGO, "WAGO-Q23")])
def test_the_write_quantity_of_17h_is_that_of_its_field(device: str | None, code: str) -> None:
    findings = told("17 0000 0001 0000 2112 02 1234", "97 03", device)
    assert "writes 8466" in findings[code]
