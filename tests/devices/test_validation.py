from __future__ import annotations

from typing import Any

import msgspec
import pytest

from mbtool.core.errors import ProfileError
from mbtool.devices.model import (
    Access,
    AnswerWord,
    Area,
    Exceptions,
    FunctionRule,
    Point,
    Profile,
    Timing,
)
from mbtool.devices.point_types import PointType
from mbtool.devices.validation import validate
from mbtool.modbus.adu import Transport
from mbtool.modbus.tables import Table

HOLDING = Table.HOLDING_REGISTERS


def _area(
    name: str,
    first: int,
    last: int,
    table: Table = HOLDING,
    access: Access = Access.READ,
    base: int = 0,
) -> Area:
    return Area(name=name, table=table, first=first, last=last, access=access, base=base)


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


def test_two_areas_of_one_name_are_refused() -> None:
    key, problem = _problem(_profile(areas=[_area("data", 0, 9), _area("data", 10, 12)]))
    assert (key, problem) == (
        'areas "data".name',
        "another area has this name; give it one of its own",
    )


@pytest.mark.parametrize(
    ("first", "second", "may_overlap"),
    [("r", "w", True), ("w", "r", True), ("r", "r", False), ("w", "w", False), ("rw", "w", False)],
)
def test_areas_overlap_only_where_one_is_read_and_the_other_written(
    first: str, second: str, *, may_overlap: bool
) -> None:
    areas = [
        _area("first", 0, 9, access=Access(first)),
        _area("second", 5, 12, access=Access(second)),
    ]
    if may_overlap:
        validate(_profile(areas=areas), "pump.toml")
    else:
        assert _problem(_profile(areas=areas))[0] == 'areas "second".first'


def test_an_area_inside_another_is_found_behind_a_third() -> None:
    areas = [
        _area("all", 0, 99),
        _area("set", 10, 20, access=Access.WRITE),
        _area("own", 50, 60),
    ]
    assert _problem(_profile(areas=areas)) == (
        'areas "own".first',
        '50 (0x0032) lies in area "all" of the same table, which ends at 99 (0x0063); '
        "only an 'r' and a 'w' area may overlap",
    )


def test_area_whose_first_number_would_be_negative_is_refused() -> None:
    assert _problem(_profile(areas=[_area("M", 1000, 2000, base=-1001)])) == (
        'areas "M".base',
        "-1001 gives its first address, 1000, the number -1; -1000 or more would be right",
    )


def _two_sided(*points: Point) -> Profile:
    areas = [
        _area("inputs", 0, 9, access=Access.READ),
        _area("outputs", 0, 4, access=Access.WRITE),
        _area("both", 20, 29, access=Access.READ_WRITE),
    ]
    return _profile(*points, areas=areas)


def test_points_at_one_address_pass_where_one_is_read_and_the_other_written() -> None:
    validate(
        _two_sided(
            _point("In", 0, access=Access.READ),
            _point("Out", 0, access=Access.WRITE),
            _point("Echoed", 1, access=Access.READ_WRITE),
            _point("In 7", 7),
            _point("Status", 20, access=Access.READ),
            _point("Command", 20, access=Access.WRITE),
        ),
        "pump.toml",
    )


@pytest.mark.parametrize(
    ("points", "key", "problem"),
    [
        ([_point("In", 0)], 'points "In".access',
         "this key is missing; holding_registers 0 (0x0000) is read in one area and written in "
         "another: write 'r' or 'w'"),
        ([_point("In", 7, access=Access.WRITE)], 'points "In".access',
         "'w' is not what its area \"inputs\" allows: 'r'"),
        ([_point("A", 0, access=Access.READ), _point("B", 0, access=Access.READ)],
         'points "B".address', 'holding_registers 0 (0x0000) is "A" already'),
        ([_point("A", 20), _point("B", 20, access=Access.WRITE)],
         'points "B".address', 'holding_registers 20 (0x0014) is "A" already'),
    ],
)  # fmt: skip
def test_point_on_the_wrong_side_is_refused(points: list[Point], key: str, problem: str) -> None:
    assert _problem(_two_sided(*points)) == (key, problem)


def test_limit_beyond_the_standards_is_refused() -> None:
    assert _problem(_profile(functions={"03": FunctionRule(limit=126)})) == (
        "functions.03.limit",
        "126 is more than the 125 that the standard allows for read holding registers",
    )
    for code in ("41", "14"):  # The maker's own, and one that counts otherwise.
        validate(_profile(functions={code: FunctionRule(limit=200)}), "pump.toml")
    both = {"15": FunctionRule(limit=100), "0F": FunctionRule()}  # So 15 is no 15 in decimal.
    validate(_profile(functions=both), "pump.toml")


def test_limit_on_ascii_lines_is_for_devices_that_have_them() -> None:
    rule = FunctionRule(limit=26, ascii_limit=13)
    assert _problem(_profile(functions={"03": rule})) == (
        "functions.03.ascii_limit",
        "the device is on no ASCII line; add 'ascii' to the transports",
    )
    both = [Transport.RTU, Transport.ASCII]
    validate(_profile(functions={"03": rule}, transports=both), "pump.toml")


def test_function_without_an_answer_has_no_answer_word() -> None:
    rule = FunctionRule(answer=AnswerWord(name="Code"), answers=False)
    assert _problem(_profile(functions={"41": rule}))[0] == "functions.41.answers"


def test_text_of_an_exception_that_is_not_documented_is_refused() -> None:
    assert _problem(_profile(exceptions=Exceptions(texts={0x11: "range"}))) == (
        "exceptions.texts",
        "17 (0x11) is not among the documented codes (1, 2, 3); add it there",
    )


def test_a_function_lists_only_codes_of_the_device_and_gives_only_codes_that_it_lists() -> None:
    def problem(**rule: Any) -> tuple[str, str]:
        return _problem(_profile(functions={"01": FunctionRule(**rule)}))

    validate(_profile(functions={"01": FunctionRule(value=2, documented=[1, 2])}), "pump.toml")
    assert problem(value=2, documented=[1, 2, 9]) == (
        "functions.01.documented",
        "9 is not among the documented codes of the device (1, 2, 3); add it to 'documented' of "
        "[exceptions]",
    )
    assert problem(documented=[1, 2]) == (
        "functions.01.value",
        "3 is not among the documented codes of the function (1, 2); give another",
    )
    assert problem(value=9)[0] == "functions.01.value"


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
    ("point", "problem"),
    [
        (_point(address=10), "holding_registers 10 (0x000A) is in no area; there are 0..9"),
        (_point("{n}", 8, count=3), "holding_registers 10 (0x000A) is in no area; there are 0..9"),
        (_point("{n}", 0, count=0xFFFF, stride=0xFFFF),
         "holding_registers 65535 (0xFFFF) is in no area; there are 0..9"),
        (_point(address=9, type=PointType.INT32),
         "holding_registers 9..10 are not in one area; there are 0..9"),
        (_point(address=8, type=PointType.STRING, length=3),
         "holding_registers 8..10 are not in one area; there are 0..9"),
        (_point(table=Table.INPUT_REGISTERS),
         "input_registers 3 (0x0003) is in no area; there is none of that table"),
    ],
)  # fmt: skip
def test_point_outside_every_area_is_refused(point: Point, problem: str) -> None:
    assert _problem(_profile(point)) == (f'points "{point.name}".address', problem)


def test_of_many_areas_the_first_are_named() -> None:
    areas = [_area(str(first), first, first) for first in range(0, 20, 2)]
    _, problem = _problem(_profile(_point(), areas=areas))
    assert problem.endswith("there are 0..0, 2..2, 4..4, 6..6, 8..8, ...")


def test_point_that_cannot_be_is_refused_wherever_it_stands() -> None:
    assert _problem(_profile(_point(scale=0.0)))[0] == 'points "Speed".scale'


def test_two_points_at_one_address_are_refused() -> None:
    wide = _point("Wide", 2, type=PointType.UINT32)
    key, problem = _problem(_profile(wide, _point("Speed", 3)))
    assert key == 'points "Speed".address'
    assert problem == 'holding_registers 3 (0x0003) is "Wide" already'


def test_parts_of_blocks_overlap_what_is_in_none() -> None:
    text = _point("Text", 2, type=PointType.STRING, length=4, block=2)
    date = _point("Date", 3, type=PointType.STRING, length=4, block=3)
    validate(_profile(_point("Speed", 3), text, date), "pump.toml")
    key, problem = _problem(_profile(text, _point("Speed", 3, block=2)))
    assert key == 'points "Speed".address'
    assert problem == 'holding_registers 3 (0x0003) is "Text" already'


def test_block_that_begins_behind_its_part_is_refused() -> None:
    assert _problem(_profile(_point(block=4))) == (
        'points "Speed".block',
        "4 (0x0004) is behind the point itself, at 3 (0x0003)",
    )


def test_two_points_of_one_name_are_refused() -> None:
    assert _problem(_profile(_point(), _point(address=4)))[1] == (
        "another point has this name; give it one of its own"
    )


def test_an_invalid_silence_is_reported() -> None:
    assert _problem(_profile(timing=Timing(t3_5="28 bit times"))) == (
        "timing.t3_5",
        "silence '28 bit times': write a number and bits, chars, ms or us, for example 28bits or "
        "5ms",
    )
    assert _problem(_profile(timing=Timing(request_interval="0ms")))[0] == "timing.request_interval"
    validate(
        _profile(timing=Timing(t1_5="1ms", t3_5="28bits", request_interval="5ms")), "pump.toml"
    )
