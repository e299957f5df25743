from __future__ import annotations

from typing import Any

import msgspec
import pytest

from mbtool.core import ProfileError
from mbtool.devices import Access, Area, Exceptions, FunctionRule, Point, PointType, Profile, Timing
from mbtool.devices.validation import validate
from mbtool.modbus.adu import Transport
from mbtool.modbus.tables import Table

HOLDING = Table.HOLDING_REGISTERS


def _area(name: str, first: int, last: int, table: Table = HOLDING) -> Area:
    return Area(name=name, table=table, first=first, last=last, access=Access.READ)


def _profile(*points: Point, **fields: Any) -> Profile:
    profile = Profile(
        name="pump",
        title="A pump",
        vendor="Maker",
        transports=[Transport.RTU],
        source="its manual",
        areas=[_area("data", 0, 9), _area("bits", 0, 9, Table.COILS)],
        functions={"03": FunctionRule()},
        points=list(points),
    )
    return msgspec.structs.replace(profile, **fields)


def _point(name: str = "Speed", address: int = 3, **fields: Any) -> Point:
    return Point(**{"name": name, "table": HOLDING, "address": address, **fields})


def _problem(profile: Profile) -> tuple[str, str]:
    with pytest.raises(ProfileError) as caught:
        validate(profile, "pump.toml")
    return caught.value.key, caught.value.problem


def test_sound_profile_passes() -> None:
    validate(
        _profile(
            _point(),
            _point("CH{n}", 4, count=3, stride=2, type=PointType.FLOAT32),
            _point("Run", 0, table=Table.COILS, type=PointType.BIT, default=1),
        ),
        "pump.toml",
    )


def test_interleaved_points_pass() -> None:
    validate(
        _profile(
            _point("CH{n} low", 0, count=5, stride=2), _point("CH{n} high", 1, count=5, stride=2)
        ),
        "pump.toml",
    )


def test_area_that_ends_before_it_begins_is_refused() -> None:
    key, problem = _problem(_profile(areas=[_area("data", 16, 15)]))
    assert key == 'areas "data".last'
    assert problem == "15 (0x000F) ends before it begins, at 16 (0x0010)"


def test_areas_of_one_table_that_overlap_are_refused() -> None:
    key, problem = _problem(_profile(areas=[_area("second", 9, 12), _area("first", 0, 9)]))
    assert key == 'areas "second".first'
    assert '"first"' in problem


def test_same_addresses_in_two_tables_are_no_overlap() -> None:
    validate(_profile(areas=[_area("a", 0, 9), _area("b", 0, 9, Table.COILS)]), "pump.toml")


def test_inputs_that_can_be_written_are_refused() -> None:
    inputs = Area(name="in", table=Table.INPUT_REGISTERS, first=0, last=1, access=Access.READ_WRITE)
    assert _problem(_profile(areas=[inputs]))[0] == 'areas "in".access'


def test_exception_that_is_not_documented_is_refused() -> None:
    key, _ = _problem(_profile(exceptions=Exceptions(value=3, documented=[1, 2])))
    assert key == "exceptions.value"


@pytest.mark.parametrize("name", ["", "a/b", "a b", "-a"])
def test_name_that_could_not_stand_in_a_topic_is_refused(name: str) -> None:
    assert _problem(_profile(name=name))[0] == "name"


def test_profile_without_a_transport_is_refused() -> None:
    assert _problem(_profile(transports=[]))[0] == "transports"


@pytest.mark.parametrize(
    ("point", "key", "problem"),
    [
        (_point(address=10), "address", "holding_registers 10 (0x000A) is outside every area"),
        (_point(address=9, type=PointType.INT32), "address", "outside every area"),
        (_point("{n}", 8, count=3), "address", "10 (0x000A) is outside"),
        (_point("{n}", 0, count=0xFFFF, stride=0xFFFF), "address", "65535 (0xFFFF) is outside"),
        (_point(type=PointType.BIT), "type", "uint16 would be right"),
        (_point(table=Table.COILS), "type", "bit would be right"),
        (_point("{n}", 0, count=2, type=PointType.INT32), "stride", "less than the 2"),
        (_point("CH", 0, count=2), "name", "{n} or {reference}"),
        (_point("CH{x}"), "name", "only {n} and {reference}"),
        (_point(scale=0.0), "scale", "scales nothing"),
        (_point(scale=float("inf")), "scale", "scales nothing"),
        (_point(channels=4), "channels", "not uint16"),
        (_point(type=PointType.NIBBLE_FIELD, channels=5), "channels", "4 at most"),
        (_point(type=PointType.BIT_FIELD, texts={2: "x"}), "texts", "does not fit the 1 bit"),
        (_point(minimum=5, maximum=4), "minimum", "more than the maximum"),
        (_point(minimum=5, maximum=9, default=4), "default", "outside 5..9"),
        (_point(table=Table.COILS, type=PointType.BIT, default=2), "default", "0 or 1"),
    ],
)
def test_point_that_cannot_be_is_refused(point: Point, key: str, problem: str) -> None:
    told = _problem(_profile(point))
    assert told[0] == f'points "{point.name}".{key}'
    assert problem in told[1]


def test_two_points_at_one_address_are_refused() -> None:
    wide = _point("Wide", 2, type=PointType.UINT32)
    key, problem = _problem(_profile(wide, _point("Speed", 3)))
    assert key == 'points "Speed".address'
    assert problem == 'holding_registers 3 (0x0003) is "Wide" already'


def test_two_points_of_one_name_are_refused() -> None:
    assert _problem(_profile(_point(), _point(address=4)))[1] == "another point has this name"


def test_a_silence_that_is_none_is_told() -> None:
    assert _problem(_profile(timing=Timing(t3_5="28 bit times"))) == (
        "timing.t3_5",
        "silence '28 bit times': write a number and bits, chars, ms or us, for example 28bits or "
        "5ms",
    )
    validate(_profile(timing=Timing(t1_5="1ms", t3_5="28bits")), "pump.toml")
