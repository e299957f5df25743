"""Profiles of configurations of Home Assistant."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.devices.importing.home_assistant import import_home_assistant
from mbtool.devices.model import Access
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.tables import Table

pytest.importorskip("yaml")

HUB = b"""
modbus:
  - name: hub
    type: tcp
    host: !secret plc
    port: 502
    sensors:
      - name: Temperature
        slave: 5
        address: 16
        input_type: input
        scale: 0.1
        offset: -40
        precision: 1
        unit_of_measurement: "\xc2\xb0C"
      - {name: Energy, slave: 5, address: 2, data_type: uint32, swap: word}
      - {name: Serial, slave: 5, address: 30, data_type: string, count: 4}
      - {name: Phase, slave: 5, address: 40, data_type: float32, virtual_count: 2, swap: word_byte}
    binary_sensors:
      - {name: Door, slave: 5, address: 3, input_type: discrete_input}
    switches:
      - {name: Pump, slave: 5, address: 7, write_type: coil}
      - {name: Mode, slave: 5, address: 70}
    climates:
      - {name: Hall, slave: 5, address: 80, data_type: int16, target_temp_register: 81}
    covers:
      - {name: Blind, slave: 5, address: 90}
"""


def test_entities_become_points() -> None:
    made = import_home_assistant(HUB, "ha.yaml", "ha")
    points = {point.name: point for point in made.profile.points}
    temperature = points["Temperature"]
    assert (temperature.table, temperature.address) == (Table.INPUT_REGISTERS, 16)
    assert (temperature.scale, temperature.offset, temperature.decimals) == (0.1, -40, 1)
    assert (temperature.unit, temperature.type) == ("°C", PointType.INT16)
    assert (points["Energy"].type, points["Energy"].word_order) == (
        PointType.UINT32, WordOrder.LOW_FIRST
    )  # fmt: skip
    assert points["Serial"].words == 4
    assert [points[f"Phase {n}"].address for n in (1, 2, 3)] == [40, 42, 44]
    assert points["Phase 3"].byte_order is ByteOrder.LOW_FIRST
    assert (points["Door"].table, points["Pump"].table) == (Table.DISCRETE_INPUTS, Table.COILS)
    assert points["Mode"].type is PointType.UINT16
    assert points["Hall target"].address == 81
    assert made.remarks == ("Blind: left out, as it is one of the covers",)
    rights = {area.table: area.access for area in made.profile.areas if area.first < 20}
    assert rights[Table.COILS] is Access.READ_WRITE
    assert rights[Table.INPUT_REGISTERS] is Access.READ


def test_one_of_several_units_is_chosen() -> None:
    data = b"""
- sensors:
    - {name: A, slave: 1, address: 0}
    - {name: B, device_address: 2, address: 0}
"""
    with pytest.raises(UsageError, match="has the units 1, 2; choose one with --unit"):
        import_home_assistant(data, "ha.yaml", "ha")
    made = import_home_assistant(data, "ha.yaml", "ha", unit=2)
    assert [point.name for point in made.profile.points] == ["B"]
    with pytest.raises(UsageError, match="has no value that a profile can have"):
        import_home_assistant(data, "ha.yaml", "ha", unit=3)


@pytest.mark.parametrize(
    ("entry", "remark"),
    [
        ("{name: X, address: -1}", "X: left out, as it has no address from 0 to 65535"),
        ("{name: X, address: yes}", "X: left out, as it has no address"),
        ("{name: X}", "X: left out, as it has no address"),
        ("{name: X, address: 9, data_type: custom}", "X: left out, as it has the type custom"),
        ("{name: X, address: 9, data_type: string}", "a text without a count"),
        ("{name: X, address: 9, swap: all}", "has the swap all"),
        ("{name: X, address: 9, scale: much}", "could not convert"),
        ("{name: X, address: 9, scale: 0}", "has the scale 0"),
        ("{name: X, address: 9, input_type: [1]}", "in a table"),
        ("{name: X, address: 9, input_type: coil}", "from a table of bits"),
        ("{name: X, address: 65535, data_type: int32}", "leaves the addresses"),
        ("{name: X, address: 9, virtual_count: 1000000}", "where a number up to 20000 is right"),
        ("{name: X, address: 0, data_type: int16}", "X: left out, as it overlaps another one"),
    ],
)
def test_what_cannot_be_read_is_left_out_and_told(entry: str, remark: str) -> None:
    data = f"modbus:\n  - sensors:\n      - {{name: A, address: 0}}\n      - {entry}\n"
    made = import_home_assistant(data.encode(), "ha.yaml", "ha")
    assert [point.name for point in made.profile.points] == ["A"]
    (told,) = made.remarks
    assert remark in told


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"a: [", "ha.yaml: is no YAML"),
        (b"\xff\xfe\x00", "is no YAML"),
        (b"[" * 5000, "is no YAML"),
        (b"modbus: 5", "has no list of hubs"),
        (b"", "has no list of hubs"),
        (b"modbus: [{name: hub}]", "has no sensors"),
        (b"modbus: [{sensors: [5]}]", "an entry is no table of keys"),
    ],
)
def test_a_file_that_is_no_configuration_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        import_home_assistant(data, "ha.yaml", "ha")
