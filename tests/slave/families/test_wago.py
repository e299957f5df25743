"""A WAGO coupler, seen through the responder."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from mbtool.slave.families.wago import Wago

if TYPE_CHECKING:
    from mbtool.slave.device.responder import DeviceResponder

WAGO = load_profile("wago-750")
HOLDING, COILS = Table.HOLDING_REGISTERS, Table.COILS


def _coupler() -> DeviceResponder:
    return make_device(WAGO, RegisterImage.of(WAGO))


def _ask(device: DeviceResponder, request: str) -> str:
    answer = device.respond(1, bytes.fromhex(request), 0)
    assert answer is not None
    return answer.pdu.hex(" ")


@pytest.mark.parametrize(("function", "other"), [(3, 4), (1, 2)])
def test_two_functions_read_one_image(function: int, other: int) -> None:
    coupler = _coupler()
    coupler.image.set(HOLDING, 0, [0x1234, 0x2345])
    coupler.image.set(COILS, 0, [0, 1, 0, 0, 1])
    said = _ask(coupler, f"{function:02X} 0000 0002")
    assert said == {3: "03 04 12 34 23 45", 1: "01 01 02"}[function]
    assert _ask(coupler, f"{other:02X} 0000 0002")[3:] == said[3:]


def test_start_values_of_either_table_are_of_both() -> None:
    image = RegisterImage.of(WAGO)
    image.set(Table.INPUT_REGISTERS, 3, [7])
    image.set(Table.DISCRETE_INPUTS, 3, [1])
    image.set(HOLDING, 4, [8])
    coupler = make_device(WAGO, image)
    assert _ask(coupler, "03 0003 0002") == "03 04 00 07 00 08"
    assert _ask(coupler, "01 0000 0004") == "01 01 08"


@pytest.mark.parametrize("first", [0x0000, 0x6000])
def test_registers_are_written_over_the_inputs_and_read_back_as_outputs(first: int) -> None:
    coupler = _coupler()
    back = 0x0200 if first == 0 else 0x7000
    coupler.image.set(HOLDING, first, [0xAAAA])
    assert _ask(coupler, f"06 {first:04X} 1234") == f"06 {first >> 8:02x} 00 12 34"
    _ask(coupler, f"10 {first + 1:04X} 0002 04 5555 6666")
    assert _ask(coupler, f"03 {first:04X} 0001") == "03 02 aa aa"
    assert _ask(coupler, f"03 {back:04X} 0003") == "03 06 12 34 55 55 66 66"
    _ask(coupler, f"06 {back:04X} 7777")
    assert _ask(coupler, f"04 {back:04X} 0001") == "04 02 77 77"


@pytest.mark.parametrize(("first", "back"), [(0x0000, 0x0200), (0x3000, 0x4000)])
def test_bits_are_written_over_the_inputs_and_read_back_as_outputs(first: int, back: int) -> None:
    coupler = _coupler()
    _ask(coupler, f"0F {first:04X} 0010 02 A5F0")
    _ask(coupler, f"05 {first:04X} FF00")
    assert _ask(coupler, f"02 {first:04X} 0010") == "02 02 00 00"
    assert _ask(coupler, f"02 {back:04X} 0010") == "02 02 a5 f0"
    _ask(coupler, f"05 {back + 1:04X} FF00")
    assert _ask(coupler, f"01 {back:04X} 0008") == "01 01 a7"


def test_a_mask_and_a_read_with_a_write_reach_the_outputs() -> None:
    coupler = _coupler()
    coupler.image.set(HOLDING, 0, [0x0004, 0x5678])
    _ask(coupler, "06 0003 0123")
    assert _ask(coupler, "16 0003 00FF 5500") == "16 00 03 00 ff 55 00"
    assert _ask(coupler, "03 0203 0001") == "03 02 55 23"
    assert _ask(coupler, "17 0000 0002 0003 0001 02 0123") == "17 04 00 04 56 78"
    assert _ask(coupler, "03 0203 0001") == "03 02 01 23"


def test_one_request_writes_100_registers_at_most() -> None:
    coupler = _coupler()
    for count, code in ((100, "17"), (101, "97")):
        request = f"17 0000 0001 0000 {count:04X} {2 * count:02X}" + count * "0001"
        assert _ask(coupler, request)[:2] == code
    assert _ask(coupler, "10 0000 0065 CA" + 101 * "0001") == "90 03"
    assert _ask(coupler, "03 0264 0001") == "03 02 00 00"


def test_functions_07_and_0b_give_the_first_inputs_and_what_went_well() -> None:
    coupler = _coupler()
    coupler.image.set(COILS, 0, [0, 1, 0, 0, 1, 0, 0, 0, 1])
    assert _ask(coupler, "07") == "07 12"
    assert _ask(coupler, "03 0000 0001") == "03 02 00 00"
    assert _ask(coupler, "03 0100 0001") == "83 02"
    assert _ask(coupler, "0B") == "0b 00 00 00 02"
    assert _ask(coupler, "0B") == "0b 00 00 00 02"
    assert _ask(coupler, "07 00") == "87 03"


def test_constants_stand_and_take_no_write() -> None:
    coupler = _coupler()
    constants = "00 00 ff ff 12 34 aa aa 55 55 7f ff 80 00 3f ff 40 00"
    assert _ask(coupler, "03 2000 0009") == f"03 12 {constants}"
    assert _ask(coupler, "06 2000 0001") == "86 02"


def test_blocks_are_read_from_their_own_address_alone() -> None:
    coupler = _coupler()
    coupler.image.blocks.set(HOLDING, 0x2020, 0, [0x3735, 0x302D])
    assert _ask(coupler, "03 2020 0002") == "03 04 37 35 30 2d"
    assert _ask(coupler, "04 2020 0001") == "04 02 37 35"
    assert _ask(coupler, "03 2021 0002") == "03 04 00 00 00 00"
    assert _ask(coupler, "03 2020 0011") == "83 02"
    assert _ask(coupler, "03 2025 0001") == "83 02"
    assert _ask(coupler, "03 2040 0001") == "83 02"


@pytest.mark.parametrize("request_", ["0000 0000", "0000 07D1", "0000", "2000 0001"])
@pytest.mark.parametrize("function", ["01", "02"])
def test_functions_01_and_02_give_no_exception_but_01_and_02(function: str, request_: str) -> None:
    assert _ask(_coupler(), f"{function} {request_}") == f"8{function[1]} 02"


def test_requests_are_counted_by_what_was_wrong_with_them() -> None:
    coupler = _coupler()
    for request in (
        "2B 0E 01 00",  # a function that it lacks
        "03 0100 0001",  # no address
        "03 0000",  # too short
        "05 0000 1234",  # no value of a coil
        "03 0000 007E",
        "10 0000 0065 CA" + 101 * "0001",
        "17 0000 0001 0000 0065 CA" + 101 * "0001",
        "01 0000 07D1",
        "01 0000 0000",
        "02 2000 0001",  # no address
    ):
        _ask(coupler, request)
    assert _ask(coupler, "03 1029 0009") == (
        "03 12 00 00 00 00 00 01 00 01 00 02 00 02 00 03 00 01 00 0b"
    )
    assert _ask(coupler, "06 1029 1234") == "06 10 29 12 34"
    assert _ask(coupler, "03 1029 0004") == "03 08 00 00 00 00 00 01 00 01"
    assert _ask(coupler, "06 1029 AA55") == "06 10 29 aa 55"
    assert _ask(coupler, "03 1029 0004") == "03 08 00 00 00 00 00 00 00 00"


def test_counters_go_on_from_what_they_started_with() -> None:
    image = RegisterImage.of(WAGO)
    image.blocks.set(HOLDING, 0x1029, 4, [0xFFFF, 7])
    coupler = make_device(WAGO, image)
    _ask(coupler, "03 0100 0001")
    assert _ask(coupler, "03 1029 0006") == "03 0c" + 8 * " 00" + " 00 00 00 07"


def test_connections_are_counted_and_their_idle_time_is_a_register() -> None:
    coupler = _coupler()
    rules = coupler.behaviour.rules
    assert rules is not None
    assert math.isinf(rules.idle_s)
    rules.admit("127.0.0.1", 0)
    assert _ask(coupler, "03 102A 0001") == "03 02 00 01"
    _ask(coupler, "06 1030 05DC")
    assert rules.idle_s == 1.5


def test_what_is_saved_outlasts_a_software_reset_and_the_rest_does_not() -> None:
    coupler = _coupler()
    kept: list[str] = []
    coupler.behaviour.keep = lambda: kept.append("kept")
    coupler.image.set(HOLDING, 0, [0x1111])
    _ask(coupler, "10 1000 0002 04 0005 0004")
    assert kept == []
    _ask(coupler, "06 100B 0001")
    assert kept == ["kept"]
    _ask(coupler, "06 1000 0007")
    _ask(coupler, "06 1003 0001")
    _ask(coupler, "06 0000 2222")
    assert _ask(coupler, "06 2040 1234") == "06 20 40 12 34"
    assert _ask(coupler, "03 0200 0001") == "03 02 22 22"
    assert _ask(coupler, "06 2040 55AA") == "06 20 40 55 aa"
    assert _ask(coupler, "03 0200 0001") == "03 02 00 00"
    assert _ask(coupler, "03 0000 0001") == "03 02 11 11"
    settings = "00 05 00 04 00 00 00 00 ff ff 00 00 00 00"
    assert _ask(coupler, "03 1000 0007") == f"03 0e {settings}"


def test_it_keeps_the_time_and_the_mask_of_its_watchdog() -> None:
    assert Wago.kept == ((HOLDING, range(0x1000, 0x1003)),)
