"""What a read-only tap passes on, byte by byte and function by function."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus.adu import mbap_adu, rtu_adu
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.pdu import parse_pdu
from mbtool.sources.read_only import MAX_WAITING, ReadOnlyScreen, only_reads

READ = bytes.fromhex("03 006b 0003")  # read holding registers, address 107, quantity 3
WRITE = bytes.fromhex("06 0001 1234")  # write single register, address 1
REFUSAL = bytes.fromhex("86 01")  # the exception bit and the function, illegal function
RESPONSE = bytes.fromhex("03 06 0001 0002 0003")


def _reads(pdu: bytes) -> bool:
    return only_reads(parse_pdu(pdu, Direction.REQUEST))


def test_each_function_that_writes_is_refused() -> None:
    writing = [code for code, one in FUNCTIONS.items() if one.writes]
    assert {0x05, 0x06, 0x0F, 0x10, 0x15, 0x16, 0x17} == set(writing)
    requests = [
        "05 0001 ff00", "06 0001 1234", "0f 0001 0001 01 01", "10 0001 0001 02 1234",
        "15 09 06 0001 0000 0001 1234", "16 0001 0000 1234", "17 0001 0001 0001 0001 02 1234",
    ]  # fmt: skip
    assert sorted(bytes.fromhex(one)[0] for one in requests) == sorted(writing)
    assert not any(_reads(bytes.fromhex(one)) for one in requests)


@pytest.mark.parametrize(
    "pdu",
    [
        "01 0000 0001", "02 0000 0001", "03 0000 0001", "04 0000 0001", "07", "0b", "0c", "11",
        "14 07 06 0001 0000 0001", "18 0000", "08 0000 1234", "08 000b 0000", "2b 0e 01 00",
    ],
)  # fmt: skip
def test_each_function_that_only_reads_passes(pdu: str) -> None:
    assert _reads(bytes.fromhex(pdu))


@pytest.mark.parametrize(
    "pdu",
    [
        "08 0001 ff00",  # restart communications
        "08 0004 0000",  # force listen only mode
        "08 000a 0000",  # clear counters
        "2b 0d 01",  # CANopen general reference, which can write
        "42", "5a 00 01", "7f",  # functions of vendors
        "83 02",  # an exception response
        "03 0000 0001 06 0001 1234",  # a read, and a write behind it in the same ADU
        "03 0000",  # not whole
        "",
    ],
)  # fmt: skip
def test_what_may_change_something_or_is_not_known_is_refused(pdu: str) -> None:
    assert not _reads(bytes.fromhex(pdu))


@given(cuts=st.lists(st.integers(0, 40), max_size=6))
def test_however_the_bytes_are_cut_only_reads_pass(cuts: list[int]) -> None:
    first, second, third = (
        mbap_adu(number, 1, pdu) for number, pdu in enumerate((READ, WRITE, READ))
    )
    data = first + second + third
    screen, onward, refused = ReadOnlyScreen(is_rtu=False), b"", 0
    places = [0, *sorted(cuts), len(data)]
    for start, end in pairwise(places):
        result = screen.ask(data[start:end], 0)
        onward += result.onward
        refused += len(result.refused)
    assert (onward, refused) == (first + third, 1)
    assert screen.due() == mbap_adu(1, 1, REFUSAL)


def test_an_exception_never_comes_inside_a_response() -> None:
    screen = ReadOnlyScreen(is_rtu=False)
    response = mbap_adu(1, 1, RESPONSE)
    screen.respond(response[:5], 0)
    screen.ask(mbap_adu(2, 1, WRITE), 0)
    assert screen.due() == b""
    screen.respond(response[5:], 0)
    assert screen.due() == mbap_adu(2, 1, REFUSAL)
    assert screen.due() == b""


def test_rtu_over_tcp_is_screened_by_its_frames() -> None:
    screen = ReadOnlyScreen(is_rtu=True)
    result = screen.ask(rtu_adu(1, READ) + rtu_adu(1, WRITE), 0)
    assert result.onward == rtu_adu(1, READ)
    assert result.refused == ["unit 1: write single register not passed on"]
    assert screen.due() == rtu_adu(1, REFUSAL)


def test_bytes_that_are_no_request_end_the_connection_and_take_no_request_with_them() -> None:
    screen = ReadOnlyScreen(is_rtu=False)
    hidden = mbap_adu(1, 1, READ) + b"\xff" * 9 + mbap_adu(2, 1, READ)
    result = screen.ask(hidden, 0)
    assert (result.is_broken, result.onward) == (True, b"")


def test_refused_requests_that_nobody_reads_the_answers_of_are_bounded() -> None:
    screen = ReadOnlyScreen(is_rtu=False)
    screen.respond(mbap_adu(1, 1, RESPONSE)[:5], 0)
    results = [screen.ask(mbap_adu(2, 1, WRITE), 0) for _ in range(MAX_WAITING + 1)]
    assert [one.is_broken for one in results] == [False] * MAX_WAITING + [True]
