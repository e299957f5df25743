"""Profiles in the words of other programs, and back."""

from __future__ import annotations

import csv
import json
import tomllib
from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace

from mbtool.core import UsageError
from mbtool.devices import builtin_profiles, load_profile, profile_from_json
from mbtool.devices.exporting.exported_points import single_points
from mbtool.devices.exporting.register_list import export_register_list
from mbtool.devices.exporting.sunspec_model import export_sunspec
from mbtool.devices.importing.home_assistant import import_home_assistant
from mbtool.devices.importing.register_list import import_register_list
from mbtool.devices.importing.sunspec import import_sunspec
from mbtool.devices.model import Access, Area, Point
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.tables import Table
from mbtool.workflows.export_profile import ExportForm, exported

if TYPE_CHECKING:
    from mbtool.devices import Profile

HOLDING, INPUT = Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS
LOW, SWAPPED = WordOrder.LOW_FIRST, ByteOrder.LOW_FIRST
POINTS = [
    Point(name="Level", table=HOLDING, address=0, unit="m", scale=0.01, decimals=2),
    Point(name="Flow", table=HOLDING, address=1, type=PointType.FLOAT32, word_order=LOW),
    Point(name="Count", table=HOLDING, address=3, type=PointType.UINT64),
    Point(name="Tag", table=HOLDING, address=7, type=PointType.STRING, length=3),
    Point(name="Raw {n}", table=HOLDING, address=10, type=PointType.INT16, count=3,
          byte_order=SWAPPED),
    Point(name="Both", table=INPUT, address=4, type=PointType.INT32, word_order=LOW,
          byte_order=SWAPPED, offset=-40.0),
    Point(name="Run", table=Table.COILS, address=2, type=PointType.BIT),
    Point(name="Full", table=Table.DISCRETE_INPUTS, address=9, type=PointType.BIT),
]  # fmt: skip


@pytest.fixture
def pump() -> Profile:
    areas = [
        Area(name="a", table=HOLDING, first=0, last=15, access=Access.READ),
        Area(name="b", table=INPUT, first=0, last=15, access=Access.READ),
        Area(name="c", table=Table.COILS, first=0, last=15, access=Access.READ_WRITE),
        Area(name="d", table=Table.DISCRETE_INPUTS, first=0, last=15, access=Access.READ),
    ]
    return replace(load_profile("idec-ft1a-touch"), name="pump", areas=areas, points=POINTS)


def _values(profile: Profile) -> list[tuple[Point, Access]]:
    """The values of a profile, without what is only for readers."""
    return [
        (replace(one.point, access=None, note=None), one.access) for one in single_points(profile)
    ]


def test_a_register_list_comes_back_the_same(pump: Profile) -> None:
    made = exported(pump, ExportForm.CSV)
    again = import_register_list(made.text.encode(), "pump.csv").profile
    assert _values(again) == _values(pump)
    assert made.lacking == ()


def test_a_configuration_of_home_assistant_comes_back_the_same(pump: Profile) -> None:
    pytest.importorskip("yaml")
    made = exported(pump, ExportForm.HOME_ASSISTANT, 5)
    again = import_home_assistant(made.text.encode(), "ha.yaml", "pump", unit=5)
    assert _values(again.profile) == _values(pump)
    assert (made.lacking, again.remarks) == ((), ())


def test_json_comes_back_the_same(pump: Profile) -> None:
    text = exported(pump, ExportForm.JSON).text
    assert profile_from_json(text.encode(), "pump") == pump


def test_telegraf_gets_a_request_for_each_table_and_order(pump: Profile) -> None:
    made = exported(pump, ExportForm.TELEGRAF, 7)
    (plugin,) = tomllib.loads(made.text)["inputs"]["modbus"]
    assert plugin["configuration_type"] == "request"
    requests = {(one["register"], one["byte_order"]): one for one in plugin["request"]}
    assert {one["slave_id"] for one in requests.values()} == {7}
    assert requests["coil", "ABCD"]["fields"] == [{"address": 2, "name": "Run"}]
    assert requests["holding", "ABCD"]["fields"] == [
        {"address": 0, "name": "Level", "type": "UINT16", "scale": 0.01},
        {"address": 3, "name": "Count", "type": "UINT64"},
        {"address": 7, "name": "Tag", "type": "STRING", "length": 3},
    ]
    assert requests["holding", "CDAB"]["fields"][0]["name"] == "Flow"
    assert [one["address"] for one in requests["holding", "BADC"]["fields"]] == [10, 11, 12]
    assert requests["input", "DCBA"]["fields"][0]["type"] == "INT32"
    assert made.lacking == ("without their unit: Level", "without their offset: Both")


def test_a_sunspec_model_comes_back_the_same() -> None:
    points: list[dict[str, Any]] = [
        {"name": "ID", "type": "uint16", "size": 1, "value": 64900},
        {"name": "L", "type": "uint16", "size": 1},
        {"name": "W", "type": "int16", "size": 1, "units": "W", "sf": -2, "access": "RW"},
        {"name": "Pad1", "type": "pad", "size": 1},
        {"name": "St", "type": "enum16", "size": 1, "symbols": [{"name": "ON", "value": 1}]},
        {"name": "Evt", "type": "bitfield16", "size": 1, "symbols": [{"name": "E", "value": 0}]},
        {"name": "Mn", "type": "string", "size": 4, "label": "Maker"},
        {"name": "A", "type": "uint16", "size": 1, "units": "A", "sf": "A_SF"},
        {"name": "A_SF", "type": "sunssf", "size": 1},
    ]
    model = {"id": 64900, "group": {"name": "pump", "type": "group", "points": points}}
    first = import_sunspec([("a", json.dumps(model).encode())], "pump").profile
    made = export_sunspec(first)
    assert json.loads(made.text)["id"] == 64900
    assert import_sunspec([("b", made.text.encode())], "pump").profile.points == first.points
    assert made.lacking == ("left out, as they are not in the model: SunS",)


@pytest.mark.parametrize("form", [ExportForm.CSV, ExportForm.TELEGRAF, ExportForm.HOME_ASSISTANT])
def test_a_scale_in_another_register_and_no_value_are_told(form: ExportForm, pump: Profile) -> None:
    points = [
        Point(name="A", table=HOLDING, address=0, unit="A", scale_from="SF"),
        Point(name="SF", table=HOLDING, address=1, type=PointType.INT16, no_value=-32768),
    ]
    made = exported(replace(pump, points=points), form)
    assert "as in the register, since another register of the device holds the scale: A" in (
        made.lacking
    )
    told = "that a number means no value: SF" in made.lacking
    assert told or "nan_value: -32768" in made.text


def test_a_profile_that_is_no_sunspec_model_is_refused(pump: Profile) -> None:
    with pytest.raises(UsageError, match="pump: is no SunSpec model"):
        exported(pump, ExportForm.SUNSPEC)


@pytest.mark.parametrize("name", builtin_profiles())
@pytest.mark.parametrize("form", [ExportForm.CSV, ExportForm.TELEGRAF, ExportForm.HOME_ASSISTANT])
def test_every_built_in_profile_can_be_exported(name: str, form: ExportForm) -> None:
    profile = load_profile(name)
    made = exported(profile, form)
    assert made.text
    assert all(": " in line for line in made.lacking)


def test_what_a_list_cannot_say_is_told() -> None:
    lacking = "\n".join(export_register_list(load_profile("wago-750")).lacking)
    assert (
        "that a point exists only in reads from one address: SlaveDeviceFailure statistics"
        in lacking
    )


def test_a_row_of_a_list_has_the_reference_of_the_manual() -> None:
    rows = list(csv.DictReader(export_register_list(load_profile("fa3-th1m16y")).text.splitlines()))
    timer = next(row for row in rows if row["name"] == "Split reception monitoring timer")
    assert (timer["wire address"], timer["in the manual"], timer["unit"]) == ("245", "00F5H", "s")
