"""Each cell of the transaction table as text."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import clock_time, day
from mbtool.devices import PointValue, load_profile
from mbtool.modbus import FUNCTIONS, Outcome, Verdict, function_name
from mbtool.views.cells import (
    event_text,
    finding_texts,
    function_text,
    result_text,
    transaction_text,
    values_text,
    what_text,
)
from tests.logs.samples import transaction, transactions

NOON_NS = 1_700_000_000_000_000_000 // 86_400_000_000_000 * 86_400_000_000_000 + 43_200_000_000_000
TOUCH = load_profile("idec-ft1a-touch")


def _point(name: str, text: str, value: float, reference: str = "") -> PointValue:
    return PointValue(name=name, reference=reference or name, value=value, text=text)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"reference": "HR400001..400002"}, "03 read HR400001..400002 -> 4660, 22136"),
        (
            {
                "function": 6,
                "reference": "HR400001",
                "request_values": [7],
                "response_values": None,
            },
            "06 write HR400001 := 7",
        ),
        (
            {
                "reference": "HR404096",
                "outcome": Outcome.EXCEPTION,
                "exception": 2,
                "exception_name": "illegal data address",
            },
            "03 read HR404096 -> 02 illegal data address",
        ),
        ({"outcome": Outcome.NO_ANSWER, "reference": "HR400001"}, "03 read HR400001 -> no answer"),
        (
            {"function": 8, "function_name": "diagnostics", "sub_function": 4, "reference": None},
            "08 diagnostics sub-function 04 -> 4660, 22136",
        ),
        (
            {"function": 7, "function_name": "x", "reference": None, "response_values": None},
            "07 x -> ok",
        ),
    ],
)
def test_request_and_result_read_as_one(fields: dict[str, Any], text: str) -> None:
    assert transaction_text(transaction(**fields)) == text


def test_values_are_shown_as_manuals_write_them() -> None:
    one = transaction(reference="HR400001", points=[_point("Level", "5 m", 5)])
    assert transaction_text(one, in_hex=True) == "03 read HR400001 -> 1234H, 5678H"


@pytest.mark.parametrize(
    ("fields", "result"),
    [
        ({}, "4660, 22136"),
        ({"response_values": None}, "ok"),
        (
            {
                "outcome": Outcome.EXCEPTION,
                "exception": 2,
                "exception_name": "illegal data address",
            },
            "exception 02 illegal data address",
        ),
        (
            {"outcome": Outcome.EXCEPTION, "exception": 0x11, "exception_name": "exception 11H"},
            "exception 11",
        ),
        ({"outcome": Outcome.NO_ANSWER, "response_values": None}, "no answer"),
        ({"outcome": Outcome.BROADCAST, "response_values": None}, "broadcast"),
        ({"outcome": Outcome.MALFORMED}, "malformed answer"),
        ({"outcome": Outcome.UNSOLICITED}, "unsolicited 4660, 22136"),
        ({"outcome": Outcome.UNSOLICITED, "response_values": None}, "unsolicited"),
        (
            {
                "outcome": Outcome.UNSOLICITED,
                "exception": 4,
                "exception_name": "server device failure",
            },
            "unsolicited exception 04 server device failure",
        ),
    ],
)
def test_says_how_a_transaction_ended(fields: dict[str, Any], result: str) -> None:
    assert result_text(transaction(**fields)) == result


@pytest.mark.parametrize("code", FUNCTIONS)
def test_calls_each_function_of_the_standard_by_its_short_name(code: int) -> None:
    text = function_text(transaction(function=code, function_name=function_name(code)))
    assert text == f"{code:02X} {FUNCTIONS[code].short}"


def test_calls_a_function_of_the_makers_own_as_he_does() -> None:
    assert function_text(transaction(function=0x42, function_name="read model name")) == (
        "42 read model name"
    )


def test_says_that_it_does_not_know_a_function() -> None:
    text = function_text(transaction(function=0x41, function_name=function_name(0x41)))
    assert text == "41 unknown function"


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"reference": "holding 0..1"}, "holding 0..1"),
        ({"reference": None}, ""),
        ({"function": 6, "reference": "HR400001", "request_values": [7]}, "HR400001 := 7"),
        ({"function": 5, "reference": "C1", "request_values": [1]}, "C1 := 1"),
        (
            {"function": 15, "reference": "C1..3", "request_values": [1, 0, 1]},
            "C1..3 := 1 0 1",
        ),
        (
            {
                "function": 6,
                "reference": "0102H",
                "request_values": [0x5C],
                "points": [_point("A/D conversion", "CH1 CH2 enabled", 0x5C, "0102H")],
            },
            "0102H A/D conversion: CH1 CH2 enabled",
        ),
        (
            {"function": 0x16, "reference": "holding 4", "request_values": [0xF2, 0x25]},
            "holding 4 := AND 00F2H, OR 0025H",
        ),
        ({"function": 8, "sub_function": 4, "reference": None}, "sub-function 04"),
        ({"reference": "HR400001", "retries": 2}, "HR400001 (asked 3x)"),
        ({"function": 17, "reference": None, "retries": 1}, "(asked 2x)"),
        (
            {"reference": "HR400001", "retries": 2, "outcome": Outcome.NO_ANSWER},
            "HR400001 (3 in a row)",
        ),
        ({"reference": "HR400001", "verdicts": [Verdict.AMBIGUOUS]}, "HR400001 (ambiguous)"),
    ],
)
def test_says_what_is_addressed_and_written(fields: dict[str, Any], what: str) -> None:
    assert what_text(transaction(**fields)) == what


@pytest.mark.parametrize(
    ("function", "values", "result"),
    [
        (0x07, [0x6D], "status 6DH"),
        (0x0B, [0xFFFF, 264], "status FFFFH, 264 events"),
        (0x0B, [7], "7"),  # A log that others wrote may hold anything.
        (0x07, None, "ok"),
    ],
)
def test_says_a_status_that_is_in_no_register(
    function: int, values: list[int] | None, result: str
) -> None:
    assert result_text(transaction(function=function, response_values=values)) == result


def test_findings_have_the_figures_of_their_profile() -> None:
    one = transaction(findings=["FT1A-Q16", "FT1A-A3"])
    assert finding_texts(one, TOUCH) == [
        "FT1A-Q16 limit is 100",
        "FT1A-A3 not an address that one can read",
    ]
    assert finding_texts(one)[0] == "FT1A-Q16 the quantity is not allowed"


def test_a_read_brings_its_points() -> None:
    points = [
        _point("CH1 digital value", "12000", 12000, "RWr2"),
        _point("CH2 digital value", "4000", 4000, "RWr3"),
    ]
    assert result_text(transaction(points=points)) == "digital value: CH1 12000, CH2 4000"


def test_17h_has_what_it_wrote_beside_where_and_what_it_read_in_the_result() -> None:
    wrote = msgspec.structs.replace(_point("Valve", "open", 1, "D3"), written=True)
    read = _point("Level", "5 m", 5, "D1")
    fields: dict[str, Any] = {
        "function": 0x17,
        "reference": "D1, write D3",
        "write_address": 3,
        "request_values": [1],
        "response_values": [5],
    }
    both = transaction(**fields, points=[wrote, read])
    assert (what_text(both), result_text(both)) == ("D1, write D3 Valve: open", "Level: 5 m")
    unnamed = transaction(**fields, points=[read])
    assert (what_text(unnamed), result_text(unnamed)) == ("D1, write D3 := 1", "Level: 5 m")
    blind = transaction(**fields, points=[wrote])
    assert (what_text(blind), result_text(blind)) == ("D1, write D3 Valve: open", "5")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([0] * 24, "0 x24"),
        ([7, 0, 0, 0, 0, 7, 7, 7, 8], "7, 0 x4, 7, 7, 7, 8"),
        (list(range(20)), ", ".join(map(str, range(20)))),
    ],
)
def test_equal_registers_in_a_row_are_counted(values: list[int], text: str) -> None:
    assert values_text(values) == text


@given(st.lists(st.integers(0, 3), max_size=300))
def test_each_register_can_be_read_from_the_text(values: list[int]) -> None:
    told = [one.split(" x") for one in values_text(values).split(", ") if one]
    assert [int(one[0]) for one in told for _ in range(int(one[-1]) if one[1:] else 1)] == values


@given(st.lists(st.integers(0, 1), max_size=300))
def test_each_bit_can_be_read_from_the_text(bits: list[int]) -> None:
    text = values_text(bits, bits=True)
    told, before = "", ""
    for one in text.split():
        told += before * (int(one[1:]) - 1) if one.startswith("x") else one
        before = one
    assert told == "".join(map(str, bits))


@pytest.mark.parametrize(
    ("ts_ns", "date", "time"),
    [
        (0, "1970-01-01", "00:00:00.000"),
        (-1, "1969-12-31", "23:59:59.999"),
        (1_700_000_000_123_999_999, "2023-11-14", "22:13:20.123"),
        (4_102_444_800_000_000_000, "2100-01-01", "00:00:00.000"),
        (253_402_300_799_999_999_999, "9999-12-31", "23:59:59.999"),
        (253_402_300_800_000_000_000, "day 2932897", "00:00:00.000"),
    ],
)
def test_writes_any_time(ts_ns: int, date: str, time: str) -> None:
    assert (day(ts_ns), clock_time(ts_ns)) == (date, time)


def test_an_event_has_its_first_bytes() -> None:
    event = WireEvent(
        ts_ns=NOON_NS, link="rs485", kind=EventKind.SKIPPED, message="no frame", raw=bytes(17)
    )
    assert event_text(event) == f"skipped: no frame: {'00 ' * 16}..."
    gap = WireEvent(ts_ns=NOON_NS, link="rs485", kind=EventKind.GAP, message="60 bytes")
    assert event_text(gap) == "gap: 60 bytes"


@given(transactions, st.booleans())
def test_any_transaction_has_a_text(one: Any, in_hex: bool) -> None:
    assert transaction_text(one, in_hex=in_hex).split()[0] == f"{one.function:02X}"


@given(st.integers())
def test_any_integer_is_a_time(ts_ns: int) -> None:
    assert len(clock_time(ts_ns)) == len("00:00:00.000")
    assert day(ts_ns)
