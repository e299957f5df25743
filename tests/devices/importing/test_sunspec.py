"""Profiles of SunSpec models; the models here are written for these tests."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.core import UsageError
from mbtool.devices.importing.sunspec import import_sunspec
from mbtool.devices.model import Access
from mbtool.devices.point_types import PointType

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
    assert (area.first, area.last, area.access) == (40000, 40014, Access.READ_WRITE)
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
                    {"name": "A_SF", "type": "sunssf", "size": 1},
                    {"name": "Addr", "type": "ipv6addr", "size": 8},
                    groups=[{"name": "mod", "count": "N", "points": [HEAD[1]]}],
                ),
            )
        ],
        "pump",
        repeat=2,
    )
    assert made.remarks[1:] == (
        "not scaled, as the device tells the scale factor in a register: A",
        "left out, as a profile has no type ipv6addr: Addr",
        "the device tells how often a group is there, taken as 2 (--repeat): mod",
    )
    assert [name for name in _points(made) if "mod" in name] == ["mod[1].L", "mod[2].L"]
    assert _points(made)["mod[1].L"].address == 40002 + 2 + 2 + 8


def test_several_models_stand_one_behind_the_other() -> None:
    one = ("pump.json", _model({"name": "W", "type": "uint16", "size": 1}))
    made = import_sunspec([one, one], "pump", base=0)
    names = [point.name for point in made.profile.points]
    assert names[:4] == ["SunS", "pump.ID", "pump.L", "pump.W"]
    assert names[4:] == ["pump.ID (5)", "pump.L (6)", "pump.W (7)"]


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
