"""Points whose scale stands in another register of the device, as SunSpec has it."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from mbtool.core.errors import ProfileError, UsageError
from mbtool.devices.assignment import Assignment, Assignments, Who
from mbtool.devices.model import Access, Area, FunctionRule, Point, Profile
from mbtool.devices.naming import Namer
from mbtool.devices.point_types import PointType
from mbtool.devices.sunspec_map import MAX_SLAVES
from mbtool.devices.validation import validate
from mbtool.devices.values import registers_of
from mbtool.modbus.adu import Transport
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome
from mbtool.slave.device.value_targets import ValueTargets
from tests.devices.transactions import transaction


def _point(name: str, address: int, **fields: Any) -> Point:
    return Point(name=name, table=Table.HOLDING_REGISTERS, address=address, **fields)


CURRENT = _point("A", 10, unit="A", scale_from="A_SF", no_value=0xFFFF)
POWER = _point("W", 11, type=PointType.INT32, unit="W", scale_from="W_SF", scale=0.5)
FACTORS = [_point("A_SF", 13, type=PointType.INT16), _point("W_SF", 14, type=PointType.INT16)]
METER = Profile(
    name="meter",
    title="A meter",
    vendor="Maker",
    transports=[Transport.TCP],
    source="its manual",
    areas=[
        Area(
            name="all",
            table=Table.HOLDING_REGISTERS,
            first=0,
            last=99,
            access=Access.READ_WRITE,
        )
    ],
    functions={"03": FunctionRule(), "06": FunctionRule(), "17": FunctionRule()},
    points=[CURRENT, POWER, *FACTORS],
)
MINUS_1, MINUS_2, NOT_THERE = 0xFFFF, 0xFFFE, 0x8000


class _Meter:
    """Names reads of a meter."""

    def __init__(self) -> None:
        self._namer = Namer(Assignments([Assignment(Who(), METER)]))

    def read(self, address: int, *values: int, **fields: Any) -> dict[str, tuple[object, str]]:
        one = transaction(3, address, quantity=len(values), response_values=[*values], **fields)
        return {point.name: (point.value, point.text) for point in self._namer.name(one).points}

    def write(self, address: int, value: int) -> tuple[object, str]:
        one = transaction(6, address, quantity=1, request_values=[value])
        (point,) = self._namer.name(one).points
        return point.value, point.text


def test_the_factor_of_the_same_response_applies() -> None:
    values = _Meter().read(10, 235, 0, 5000, MINUS_1, 1)
    assert values["A"] == (23.5, "23.5 A")
    assert values["W"] == (25000, "25000 W")


def test_the_factor_that_was_read_last_applies_until_another_is_read() -> None:
    meter = _Meter()
    meter.read(13, MINUS_1)
    assert meter.read(10, 235)["A"] == (23.5, "23.5 A")
    meter.read(13, MINUS_2)
    assert meter.read(10, 235)["A"] == (2.35, "2.35 A")
    assert meter.write(10, 100) == (1, "1 A")


def test_without_its_factor_a_number_is_no_value() -> None:
    assert _Meter().read(10, 235)["A"] == (None, "235 x 10^A_SF A")


@pytest.mark.parametrize("factor", [NOT_THERE, 11, 0xFFF5])
def test_what_is_no_power_of_ten_makes_the_factor_unknown(factor: int) -> None:
    meter = _Meter()
    meter.read(13, MINUS_1)
    meter.read(13, factor)
    assert meter.read(10, 235)["A"] == (None, "235 x 10^A_SF A")


def test_each_slave_has_factors_of_its_own() -> None:
    meter = _Meter()
    meter.read(13, MINUS_1, unit=1)
    assert meter.read(10, 235, unit=2)["A"][0] is None
    assert meter.read(10, 235, unit=1, destination="10.0.0.9:502")["A"][0] is None


def test_the_factors_of_slaves_that_were_silent_for_longest_are_forgotten() -> None:
    meter = _Meter()
    meter.read(13, MINUS_1)
    for number in range(MAX_SLAVES):
        meter.read(10, 1, link=f"link {number}")
    assert meter.read(10, 235)["A"][0] is None


@pytest.mark.parametrize("outcome", [Outcome.EXCEPTION, Outcome.NOT_CAPTURED, Outcome.MALFORMED])
def test_a_response_that_is_in_doubt_brings_no_factor(outcome: Outcome) -> None:
    meter = _Meter()
    meter.read(13, MINUS_1, outcome=outcome)
    assert meter.read(10, 235)["A"][0] is None


def test_the_number_for_no_value_is_none() -> None:
    meter = _Meter()
    assert meter.read(10, 0xFFFF)["A"] == (None, "no value")
    meter.read(13, MINUS_1)
    assert meter.read(10, 0xFFFF)["A"] == (None, "no value")


def test_a_value_is_not_written_while_the_device_holds_its_scale() -> None:
    with pytest.raises(UsageError, match="scale of A in A_SF; give the number"):
        registers_of(CURRENT, 23.5)


def test_the_number_of_a_register_is_written_at_its_address() -> None:
    targets = ValueTargets(METER)
    assert targets.find("holding 10").registers(235) == [235]
    assert targets.find("holding 10").nearest(234.6) == [235]
    assert targets.find("holding 11").registers(35000) == [1, 4464]  # 70000, as W counts halves.
    with pytest.raises(UsageError, match="scale of W in W_SF"):
        targets.find("W").registers(1)


@pytest.mark.parametrize(
    ("points", "problem"),
    [
        ([CURRENT], "there is no point 'A_SF'"),
        ([CURRENT, replace(FACTORS[0], scale=0.1)], "'A_SF' has a scale"),
        ([CURRENT, replace(FACTORS[0], type=PointType.HEX16)], "not one point of type int16"),
        ([replace(CURRENT, name="A_SF", scale_from="A_SF")], "'A_SF' has a scale"),
    ],
)
def test_a_scale_that_cannot_be_is_refused(points: list[Point], problem: str) -> None:
    validate(METER, "meter.toml")
    with pytest.raises(ProfileError, match=problem):
        validate(replace(METER, points=points), "meter.toml")
