"""What keys of a file of values mean."""

from __future__ import annotations

import struct

import pytest
from msgspec.structs import replace

from mbtool.core import UsageError
from mbtool.devices import Access, Point, PointType, builtin_profiles, load_profile
from mbtool.modbus.tables import Table
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.device.value_targets import ValueTargets

HOLDING, INPUT = Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS
SMARTAXIS = load_profile("idec-ft1a-smartaxis")
TOUCH = replace(
    load_profile("idec-ft1a-touch"),
    points=[
        Point(name="flow", table=HOLDING, address=0, type=PointType.FLOAT32),
        Point(name="level", table=HOLDING, address=2, scale=0.1, unit="m"),
        Point(name="mode", table=HOLDING, address=3, texts={0: "stop", 1: "run"}),
        Point(name="pump {n}", table=Table.COILS, address=8, type=PointType.BIT, count=4),
        Point(name="total", table=INPUT, address=0, type=PointType.INT32),
    ],
)


def _said(key: str, value: object) -> list[int]:
    return ValueTargets(TOUCH).find(key).registers(value)


@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("T5 contact", (Table.DISCRETE_INPUTS, 1005)),
        ("t5 CURRENT value", (INPUT, 5)),
        ("T5 preset value", (HOLDING, 9005)),
        ("holding 9005", (HOLDING, 9005)),
        ("input:5", (INPUT, 5)),
        ("d1710", (HOLDING, 1710)),
        ("M325", (Table.COILS, 1213 + 0x30)),
    ],
)
def test_a_key_is_a_name_or_a_reference_or_a_table_and_address(
    key: str, place: tuple[Table, int]
) -> None:
    spot = ValueTargets(SMARTAXIS).find(key)
    assert (spot.table, spot.address) == place


def test_a_reference_that_may_mean_several_things_is_refused_with_their_names() -> None:
    with pytest.raises(
        UsageError, match="'C7' may mean 'C7 contact', 'C7 current value', 'C7 preset value'; write"
    ):
        ValueTargets(SMARTAXIS).find("C7")


def test_every_name_and_unshared_reference_of_the_built_in_devices_is_found() -> None:
    for name in builtin_profiles():
        profile = load_profile(name)
        spots = ValueTargets(profile)
        for area in profile.areas:
            reference = area.reference(area.first)
            if name != "idec-ft1a-smartaxis" or reference[0] not in "TC":
                assert spots.find(reference).address in range(0x10000)
        for point in profile.points:
            if "{" not in point.name:
                assert spots.find(point.name).address == point.address


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("levle", "'levle' is no name and no reference; did you mean 'level'?"),
        ("HR999999", "reference 'HR999999': idec-ft1a-touch has"),
        ("holding 3..4", "name the first address"),
    ],
)
def test_a_key_that_means_nothing_is_refused(key: str, says: str) -> None:
    with pytest.raises(UsageError, match=says.replace("?", r"\?")):
        ValueTargets(TOUCH).find(key)


@pytest.mark.parametrize(
    ("key", "value", "registers"),
    [
        ("flow", 3, [0x4040, 0]),
        ("flow", -1.5, [0xBFC0, 0]),
        ("HR400001", 3, [0x4040, 0]),  # Half a float would mean nothing.
        ("level", 2, [20]),
        ("level", 2.5, [25]),
        ("HR400003", 2, [2]),  # As it stands.
        ("HR400003", 2.5, [25]),
        ("mode", "run", [1]),
        ("HR400004", "run", [1]),
        ("pump 2", True, [1]),
        ("C10", 0, [0]),
        ("total", -2, [0xFFFF, 0xFFFE]),
        ("HR400010", -3, [0xFFFD]),
    ],
)
def test_a_value_is_said_in_the_type_of_its_point(
    key: str, value: object, registers: list[int]
) -> None:
    assert _said(key, value) == registers


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("level", 7000, "does not fit uint16"),
        ("mode", "fast", "expected a number or one of stop, run"),
        ("HR400010", 1.5, "1.5: write a number from -32768 to 65535"),
        ("pump 1", 2, "a bit is 0 or 1"),
        ("flow", True, "true: write a number"),
        ("flow", [1], "write a number"),
    ],
)
def test_a_value_that_does_not_fit_is_refused(key: str, value: object, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        _said(key, value)


def test_what_is_stored_is_what_stands_in_the_register() -> None:
    assert ValueTargets(TOUCH).find("HR400001").registers(3, stored=True) == [3]


@pytest.mark.parametrize(
    ("key", "registers"),
    [
        ("flow", list(struct.unpack(">2H", struct.pack(">f", 1.26)))),
        ("level", [13]),
        ("mode", [1]),
        ("C1", [1]),
        ("HR400010", [1]),
        ("total", [0, 1]),
    ],
)
def test_a_moving_value_is_said_as_near_as_its_type_can(key: str, registers: list[int]) -> None:
    assert ValueTargets(TOUCH).find(key).nearest(1.26) == registers


def test_a_value_of_a_block_goes_into_the_block() -> None:
    profile = load_profile("wago-750")
    image = RegisterImage.of(profile)
    spot = ValueTargets(profile).find("short description")
    spot.put(image, spot.registers("750-341"))
    assert image.blocks.get(HOLDING, range(0x2020, 0x2022)) == [0x3735, 0x302D]


@pytest.mark.parametrize(("value", "word"), [("75", 0x3735), (7, 7)])
def test_the_reference_of_a_block_is_its_beginning(value: object, word: int) -> None:
    profile = load_profile("wago-750")
    image = RegisterImage.of(profile)
    spot = ValueTargets(profile).find("0x2020")
    spot.put(image, spot.registers(value))
    assert image.blocks.get(HOLDING, range(0x2020, 0x2021)) == [word]


def test_what_is_read_is_meant_where_writing_has_another_name() -> None:
    profile = load_profile("wago-750")
    spot = ValueTargets(profile).find("0x102A")
    assert spot.point is not None
    assert (spot.point.name, spot.point.access) == ("TCP connections", Access.READ)
