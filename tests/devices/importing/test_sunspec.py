"""Profiles of SunSpec models; the models here are written for these tests."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.core import UsageError
from mbtool.devices.importing.sunspec import import_sunspec, import_sunspec_map
from mbtool.devices.model import Access
from mbtool.devices.point_types import PointType
from mbtool.devices.sunspec_map import SunSpecMap
from tests.devices.sunspec import BASE, COMMON, METER, registers

if TYPE_CHECKING:
    from mbtool.devices.importing.register_list import ImportedList
    from mbtool.devices.model import Point

HEAD: list[dict[str, Any]] = [
    {"name": "ID", "type": "uint16", "size": 1, "value": 64900, "mandatory": "M"},
    {"name": "L", "type": "uint16", "size": 1},
]


def _model(*points: dict[str, Any], groups: list[Any] | None = None) -> bytes:
    group = {"name": "pump", "type": "group", "label": "Pump", "points": [*HEAD, *points],
             "groups": groups or []}  # fmt: skip
    return json.dumps({"id": 64900, "group": group}).encode()


def _points(imported: ImportedList) -> dict[str, Point]:
    return {point.name: point for point in imported.profile.points}


def test_points_stand_behind_the_mark_and_one_another() -> None:
    made = import_sunspec(
        [
            (
                "pump.json",
                _model(
                    {"name": "W", "type": "int32", "size": 2, "units": "W", "sf": -1},
                    {"name": "Pad", "type": "pad", "size": 3},
                    {"name": "Mn", "type": "string", "size": 4, "label": "Maker {x}"},
                    {"name": "Set", "type": "float32", "size": 2, "access": "RW"},
                ),
            )
        ],
        "pump",
    )
    points = _points(made)
    assert {name: one.address for name, one in points.items()} == {
        "SunS": 40000, "ID": 40002, "L": 40003, "W": 40004, "Mn": 40009, "Set": 40013
    }  # fmt: skip
    assert (points["W"].type, points["W"].unit, points["W"].scale) == (PointType.INT32, "W", 0.1)
    assert (points["Mn"].words, points["Mn"].note) == (4, "Maker (x)")
    assert points["ID"].default == 64900
    (area,) = made.profile.areas
    assert (area.first, area.last, area.access) == (40000, 40016, Access.READ_WRITE)
    assert (points["W"].access, points["Set"].access) == (Access.READ, None)
    assert list(made.profile.functions) == ["03", "06", "10"]


def test_values_and_bits_have_their_names() -> None:
    symbols = [{"name": "OFF", "value": 0}, {"name": "ON", "value": 1}]
    points = _points(
        import_sunspec(
            [
                (
                    "pump.json",
                    _model(
                        {"name": "St", "type": "enum16", "size": 1, "symbols": symbols},
                        {"name": "Evt", "type": "bitfield16", "size": 1, "symbols": symbols},
                        {"name": "Raw", "type": "bitfield16", "size": 1},
                    ),
                )
            ],
            "pump",
        )
    )
    assert points["St"].texts == {0: "OFF", 1: "ON"}
    assert (points["Evt"].type, points["Evt"].bits) == (PointType.FLAGS, {0: "OFF", 1: "ON"})
    assert points["Raw"].type is PointType.HEX16


def test_what_a_profile_cannot_say_is_told() -> None:
    made = import_sunspec(
        [
            (
                "pump.json",
                _model(
                    {"name": "A", "type": "uint16", "size": 1, "sf": "A_SF"},
                    {"name": "Addr", "type": "ipv6addr", "size": 8},
                    groups=[{"name": "mod", "count": "N", "points": [HEAD[1]]}],
                ),
            )
        ],
        "pump",
        repeat=2,
    )
    assert made.remarks[1:] == (
        "left out, as a profile has no type ipv6addr: Addr",
        "the device tells how often a group is there, taken as 2 (--repeat): mod",
        "not scaled, as the scale factor is not there: A",
    )
    assert [name for name in _points(made) if "mod" in name] == ["mod[1].L", "mod[2].L"]
    assert _points(made)["mod[1].L"].address == 40002 + 2 + 1 + 8


def test_a_scale_factor_is_that_of_the_group_or_around_it() -> None:
    made = import_sunspec([("meter.json", json.dumps(METER).encode())], "meter", repeat=2)
    points = _points(made)
    assert {name: one.scale_from for name, one in points.items() if one.scale_from} == {
        "A": "A_SF",
        "phase[1].A": "A_SF",
        "phase[1].V": "phase[1].V_SF",
        "phase[2].A": "A_SF",
        "phase[2].V": "phase[2].V_SF",
    }
    assert (points["A_SF"].type, points["A"].scale) == (PointType.INT16, 1.0)


def test_a_model_that_is_there_twice_has_scale_factors_of_its_own() -> None:
    model = ("meter.json", json.dumps(METER).encode())
    points = _points(import_sunspec([model, model], "meter", repeat=0))
    assert points["meter.A"].scale_from == "meter.A_SF"
    assert points["meter[2].A"].scale_from == "meter[2].A_SF"


def test_the_number_for_no_value_is_that_of_the_type() -> None:
    points = _points(
        import_sunspec(
            [
                (
                    "pump.json",
                    _model(
                        {"name": "S", "type": "int16", "size": 1},
                        {"name": "Acc", "type": "acc32", "size": 2},
                        {"name": "U", "type": "uint32", "size": 2},
                    ),
                )
            ],
            "pump",
        )
    )
    assert {name: points[name].no_value for name in ("S", "Acc", "U")} == {
        "S": -0x8000,
        "Acc": None,
        "U": 0xFFFF_FFFF,
    }


def test_a_device_that_was_read_has_its_models_where_it_says() -> None:
    found = SunSpecMap(BASE)
    for address, values in registers().items():
        found.note(address, values)
    known = {one["id"]: json.dumps(one).encode() for one in (COMMON, METER)}
    files = [(f"{one.id}", known[one.id]) if one.id in known else None for one in found.models]
    made = import_sunspec_map(found, files, "meter")
    points = _points(made)
    assert (points["meter.A"].address, points["meter.phase[2].V"].address) == (40039, 40045)
    assert "meter.phase[3].V" not in points
    (area,) = made.profile.areas
    assert (area.first, area.last) == (40000, 40052)
    assert (made.profile.title, made.profile.vendor) == ("Maker Meter 7", "Maker")
    assert made.remarks == (
        "the map begins at 40000, and was read from the device",
        "left out, as there is no file of the model: 64999",
        "groups that are there 2 times, as the length of their model says: meter.phase",
    )


def test_a_model_of_a_device_may_be_shorter_than_its_file() -> None:
    found = SunSpecMap(0)
    found.note(2, [1, 32])
    made = import_sunspec_map(found, [("1", json.dumps(COMMON).encode())], "meter")
    assert list(_points(made)) == ["SunS", "ID", "L", "Mn", "Md"]
    assert made.remarks[-1] == "left out, as the device's model is shorter: DA"


def test_a_device_whose_models_have_no_file_has_no_profile() -> None:
    found = SunSpecMap(0)
    found.note(2, [1, 32])
    with pytest.raises(UsageError, match="meter: none of its models has a file"):
        import_sunspec_map(found, [None], "meter")


def test_several_models_stand_one_behind_the_other() -> None:
    one = ("pump.json", _model({"name": "W", "type": "uint16", "size": 1}))
    made = import_sunspec([one, one], "pump", base=0)
    names = [point.name for point in made.profile.points]
    assert names[:4] == ["SunS", "pump.ID", "pump.L", "pump.W"]
    assert names[4:] == ["pump[2].ID", "pump[2].L", "pump[2].W"]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"no json", "pump.json: is no SunSpec model in JSON"),
        (b"{}", "is no SunSpec model"),
        (b"\xff", "is no SunSpec model"),
        (b"[" * 100_000, "is no SunSpec model"),
        (_model({"name": "W", "type": "int32", "size": 1}), "W: 1 registers, but int32 has 2"),
        (_model({"name": "W", "type": "string", "size": 0}), "W: 0 registers do not fit at 40004"),
        (_model({"name": "W", "type": "pad", "size": 40000}), "W: 40000 registers do not fit"),
    ],
)
def test_a_file_that_is_no_model_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        import_sunspec([("pump.json", data)], "pump")


def test_groups_in_groups_without_end_are_refused() -> None:
    group: dict[str, Any] = {"name": "g", "points": []}
    for _ in range(20):
        group = {"name": "g", "points": [], "groups": [group]}
    with pytest.raises(UsageError, match="groups in more than 8 groups"):
        import_sunspec([("pump.json", _model(groups=[group]))], "pump")
