from __future__ import annotations

import pytest

from mbtool.devices import Access, Area, Point, PointType, Radix, load_profile
from mbtool.modbus.tables import Table


def _area(**fields: object) -> Area:
    defaults: dict[str, object] = {
        "name": "area",
        "table": Table.HOLDING_REGISTERS,
        "first": 0,
        "last": 99,
        "access": Access.READ_WRITE,
    }
    return Area(**{**defaults, **fields})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("area", "one", "several"),
    [
        (_area(prefix="HR", base=400001), "HR400017", "HR400017..400018"),
        (_area(prefix="X", radix=Radix.HEX), "X10", "X10..X11"),
        (_area(radix=Radix.HEX, width=4, suffix="H"), "0010H", "0010H..0011H"),
    ],
)
def test_area_writes_addresses_as_its_manual_does(area: Area, one: str, several: str) -> None:
    assert area.reference(16) == one
    assert area.span(16, 16) == one
    assert area.span(16, 17) == several


def test_area_holds_a_range_only_when_it_holds_all_of_it() -> None:
    area = _area(first=10, last=19)
    assert area.holds(Table.HOLDING_REGISTERS, 10, 10)
    assert not area.holds(Table.HOLDING_REGISTERS, 10, 11)
    assert not area.holds(Table.HOLDING_REGISTERS, 9)
    assert not area.holds(Table.COILS, 10)


def test_point_says_where_each_of_several_begins() -> None:
    point = Point(name="{n}", table=Table.HOLDING_REGISTERS, address=0x134, count=3, stride=2)
    assert list(point.addresses) == [0x134, 0x136, 0x138]


def test_words_and_channels_follow_from_the_type() -> None:
    assert PointType.FLOAT32.words == 2
    assert PointType.INT16.words == 1
    assert PointType.NIBBLE_FIELD.channel_bits == 4
    assert PointType.UINT16.channel_bits == 0


def test_profile_finds_the_rule_and_the_area() -> None:
    profile = load_profile("idec-ft1a-touch")
    rule = profile.rule(0x10)
    assert rule is not None
    assert rule.limit == 100
    assert profile.rule(0x0F) is None
    area = profile.area(Table.INPUT_REGISTERS, 4095)
    assert area is not None
    assert area.prefix == "IR"
    assert profile.area(Table.INPUT_REGISTERS, 4095, 2) is None
