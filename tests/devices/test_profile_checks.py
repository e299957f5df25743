from __future__ import annotations

import msgspec
import pytest

from mbtool.devices.checking.rules import RULES
from mbtool.devices.loading import load_profile
from mbtool.devices.model import Access, Area, FunctionRule, Profile
from mbtool.devices.profile_checks import exception_finding_code, finding_text, request_findings
from mbtool.modbus import Table, Transport
from tests.devices.checking import talk
from tests.devices.transactions import transaction

FT1A = load_profile("idec-ft1a-touch")


@pytest.mark.parametrize(
    ("function", "address", "quantity", "codes"),
    [
        (0x10, 0, 100, []),
        (0x10, 0, 110, ["FT1A-Q16"]),
        (0x03, 0, 0, ["FT1A-Q3"]),
        (0x03, 4095, 2, ["FT1A-A3"]),
        (0x01, 4000, 2001, ["FT1A-Q1", "FT1A-A1"]),
        (0x0F, 9999, 1, ["FT1A-F15"]),
        (0x06, 4096, None, ["FT1A-A6"]),
        (0x03, None, None, []),
    ],
)
def test_a_request_is_checked_against_the_manual(
    function: int, address: int | None, quantity: int | None, codes: list[str]
) -> None:
    asked = transaction(function, address, quantity=quantity)
    assert list(request_findings(FT1A, asked)) == codes


@pytest.mark.parametrize(
    ("device", "request_pdu", "codes"),
    [
        ("fa3-at1m8x", "41 00", []),
        ("fa3-at1m8x", "41 01", ["FA3-D65"]),
        ("fa3-at1m8x", "41", ["FA3-D65"]),
        ("fa3-at1m8x", "43 01", ["FA3-D67"]),
        ("fa3-at1m8x", "44 00", []),
        ("chino-lt830", "08 0000 1234", []),
        ("chino-lt830", "08 000A 0000", ["LT830-D8"]),
    ],
)
def test_fixed_data_are_checked_against_the_manual(
    device: str, request_pdu: str, codes: list[str]
) -> None:
    asked = talk.transaction(request_pdu, None, profile=device, on_a_line=device == "chino-lt830")
    assert asked.findings == codes
    if codes:
        assert "the manual fixes them as 00" in finding_text(codes[0], load_profile(device))


@pytest.mark.parametrize(
    ("read", "write", "codes"),
    [
        (range(5), range(10, 12), []),
        (range(8, 12), range(10, 12), []),  # Reads from one area into the next.
        (range(5), range(2), ["X-W23"]),  # Writes where one may only read.
        (range(5), range(19, 21), ["X-A23"]),
        (range(18, 22), range(10, 12), ["X-A23"]),
    ],
)
def test_both_ranges_of_17h_are_checked_against_the_areas(
    read: range, write: range, codes: list[str]
) -> None:
    areas = [
        Area(name=name, table=Table.HOLDING_REGISTERS, first=first, last=last, access=access)
        for name, first, last, access in [
            ("in", 0, 9, Access.READ),
            ("out", 10, 19, Access.READ_WRITE),
        ]
    ]
    profile = Profile(
        name="x",
        title="X",
        vendor="X",
        transports=[Transport.RTU],
        source="none",
        areas=areas,
        functions={"17": FunctionRule()},
    )
    asked = transaction(
        0x17,
        read.start,
        quantity=len(read),
        write_address=write.start,
        request_values=[0] * len(write),
    )
    assert list(request_findings(profile, asked)) == codes


@pytest.mark.parametrize(
    ("read", "write", "codes", "text"),
    [
        (125, 100, [], None),
        (125, 101, ["WAGO-Q23"], "at most 125 are read and 100 written"),
        (1, 121, ["WAGO-Q23"], "at most 125 are read and 100 written"),
        (126, 1, ["WAGO-Q23"], "at most 125 are read and 100 written"),
    ],
)
def test_17h_has_a_separate_limit_for_writing(
    read: int, write: int, codes: list[str], text: str | None
) -> None:
    wago = load_profile("wago-750")
    asked = transaction(0x17, 0, quantity=read, write_address=0, request_values=[0] * write)
    assert list(request_findings(wago, asked)) == codes
    assert [finding_text(code, wago) for code in codes] == ([text] if text else [])


def test_with_only_a_write_limit_the_standard_limits_reading() -> None:
    profile = msgspec.structs.replace(FT1A, functions={"17": FunctionRule(write_limit=4)})
    for read, write, codes in ((125, 4, []), (125, 5, ["FT1A-Q23"]), (126, 4, ["MB-104"])):
        asked = transaction(0x17, 0, quantity=read, write_address=0, request_values=[0] * write)
        assert list(request_findings(profile, asked)) == codes
    assert finding_text("FT1A-Q23", profile) == "at most 4 are written"


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("FT1A-E4", "exception 04 (server device failure) is not documented"),
        ("LT830-E19", "exception 13 is not documented"),
    ],
)
def test_exception_without_a_name_is_said_once(code: str, text: str) -> None:
    assert finding_text(code) == text


def test_functions_of_the_makers_own_are_no_finding() -> None:
    fa3 = load_profile("fa3-at1m8x")
    assert list(request_findings(fa3, transaction(0x42))) == []
    assert list(request_findings(fa3, transaction(0x45))) == ["FA3-F69"]


def test_an_exception_is_checked_against_the_manual() -> None:
    assert exception_finding_code(FT1A, 0x03, 2) is None
    assert exception_finding_code(FT1A, 0x03, 3) == "FT1A-E3"


@pytest.mark.parametrize("exception", [3, 4])
def test_an_exception_is_checked_against_what_the_manual_lists_for_the_function(
    exception: int,
) -> None:
    wago = load_profile("wago-750")
    for function in (0x01, 0x02):
        assert exception_finding_code(wago, function, exception) == f"WAGO-E{exception}"
    assert exception_finding_code(wago, 0x03, exception) is None


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("FT1A-Q16", "limit is 100"),
        ("FT1A-F15", "the device has no write multiple coils"),
        ("FT1A-A3", "not an address that one can read"),
        ("FT1A-A6", "not an address that one can write"),
        ("FT1A-E3", "exception 03 (illegal data value) is not documented"),
        ("FT1A-W6", "one may only read there"),
        ("FT1A-V6", "a value outside its range"),
        ("MB-103", "function 05 writes a value other than 0000H and FF00H"),
        ("RTU-CRC", "RTU-CRC"),
    ],
)
def test_code_is_put_into_words(code: str, text: str) -> None:
    assert finding_text(code, FT1A) == text


def test_code_has_words_without_its_profile() -> None:
    assert finding_text("FT1A-Q16") == "the quantity is not allowed"


def test_every_rule_has_words() -> None:
    for code, rule in RULES.items():
        code = f"FT1A-{code}3" if rule.is_of_devices else code
        assert finding_text(code, FT1A) != code
