"""Writing points into the text of a profile."""

from __future__ import annotations

from mbtool.devices import Point, Profile
from mbtool.devices.loading import profile_from_toml
from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import Table
from mbtool.values.keeping import with_points

HEADER = """\
# A pump in the cellar.
name = "pump"
title = "Pump"
vendor = "Somebody"
transports = ["rtu"]
source = "its manual"
notes = [
"[[points]] are from page 4",
]
functions = { 03 = {} }
[[areas]]
name = "all"
table = "holding_registers"
first = 0
last = 9
access = "r"
"""
LEVEL = """\
# How full it is.
[[points]]
name = "Level"
table = "holding_registers"
address = 0
type = "uint16"

[points.texts]
0 = "empty"
1 = "full"
"""
FLOW = """\
[[points]]  # in m3/h
name = "Flow"
table = "holding_registers"
address = 1
type = "uint16"
"""
SPEED = Point(name="Speed", table=Table.HOLDING_REGISTERS, address=0, type=PointType.UINT16)


def with_speed(text: str) -> tuple[str, Profile]:
    made = with_points(text, profile_from_toml(text, "pump.toml"), [(SPEED, "Seen.")])
    return made, profile_from_toml(made, "pump.toml")


def test_a_point_takes_the_place_of_one_that_no_empty_line_divides_from_the_rest() -> None:
    made, profile = with_speed(HEADER + LEVEL + FLOW)
    assert made.startswith(HEADER + FLOW)
    assert [one.name for one in profile.points] == ["Flow", "Speed"]


def test_comments_between_empty_lines_stay_where_a_point_goes() -> None:
    made, profile = with_speed(f"{HEADER}\n{LEVEL}\n# Up to here from the manual.\n\n{FLOW}")
    assert made.startswith(f"{HEADER}\n# Up to here from the manual.\n\n{FLOW}")
    assert [one.name for one in profile.points] == ["Flow", "Speed"]
