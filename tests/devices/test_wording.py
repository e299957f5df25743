from __future__ import annotations

import pytest

from mbtool.devices.assignment import Assignment, Assignments, Who
from mbtool.devices.loading import load_profile
from mbtool.devices.named_transaction import PointValue
from mbtool.devices.naming import Namer
from mbtool.devices.wording import describe, describe_points
from tests.devices.transactions import transaction


def _point(name: str, value: float, text: str) -> PointValue:
    return PointValue(name=name, reference="R", value=value, text=text)


def _bit(reference: str, value: int) -> PointValue:
    return PointValue(
        name=reference, reference=reference, value=value, text="on" if value else "off"
    )


@pytest.mark.parametrize(
    ("points", "phrases"),
    [
        ([], []),
        ([_point("Speed", 5, "5 rpm")], ["Speed: 5 rpm"]),
        ([_point("Pump speed", 5, "5"), _point("State", 1, "on")], ["Pump speed: 5", "State: on"]),
        ([_point("CH1 level", 5, "5"), _point("CH2 level", 0, "0")], ["level: CH1 5, CH2 0"]),
        (
            [_point("CH1 low", 1, "1"), _point("CH1 high", 2, "2"),
             _point("CH2 low", 3, "3"), _point("CH2 high", 4, "4")],
            ["low: CH1 1, CH2 3", "high: CH1 2, CH2 4"],
        ),
        ([_point("CH1 flag", 1, "set"), _point("CH2 flag", 0, "clear")], ["flag: CH1 set"]),
        ([_point("CH1 flag", 0, "clear"), _point("CH2 flag", 0, "clear")], ["flag: all clear"]),
        ([_bit("X0", 1), _bit("X1", 0), _bit("X2", 1)], ["X0 X2 on"]),
        ([_bit("X0", 0)], ["off"]),
        ([_bit("X0", 0), _bit("X1", 0)], ["all off"]),
        (
            [_bit("X0", 0), _bit("X1", 0), _point("Ready flag", 1, "on")],
            ["Ready flag: on", "others off"],
        ),
        ([_bit("X0", 0), _point("Ready flag", 1, "on")], ["Ready flag: on", "X0 off"]),
        (
            [_bit("X0", 1), _bit("X1", 0), _point("Ready flag", 1, "on")],
            ["Ready flag: on", "X0 on"],
        ),
        (
            [_point("Rate", 5, "5"), _point("R", 7, "7")],
            ["Rate: 5", "R 7"],
        ),
    ],
)  # fmt: skip
def test_points_of_a_series_share_a_phrase(points: list[PointValue], phrases: list[str]) -> None:
    assert describe_points(points) == phrases


def test_bits_without_a_name_come_last() -> None:
    device = Assignments([Assignment(Who(), load_profile("fa3-at1m8x"))])
    values = [0] * 9 + [1] + [0] * 6
    read = Namer(device).name(transaction(1, 0, quantity=16, response_values=values))
    assert describe(read) == "Y0..YF Initial data setting request flag: on; others off"


def test_without_names_there_is_only_the_reference() -> None:
    assert describe(Namer().name(transaction(3, 0, quantity=2))) == "holding 0..1"


def test_a_function_without_addresses_has_no_description() -> None:
    assert describe(Namer().name(transaction(7))) == ""


def test_a_reference_at_the_beginning_of_a_name_is_not_repeated() -> None:
    device = Assignments([Assignment(Who(), load_profile("idec-ft1a-smartaxis"))])
    one = Namer(device).name(transaction(4, 5, quantity=1, response_values=[100]))
    several = Namer(device).name(transaction(4, 5, quantity=2, response_values=[100, 7]))
    assert describe(one) == "T5 current value: 100"
    assert describe(several) == "T5..6 current value: T5 100, T6 7"
