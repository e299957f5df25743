"""SunSpec devices of a capture, named by the models that they say they have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, UsageError
from mbtool.devices import Assignments, Namer, Who, parse_assignment
from mbtool.workflows.shared.reading import ReadingOptions
from mbtool.workflows.shared.sunspec_devices import (
    MAX_DEVICES,
    SunSpecDevices,
    SunSpecFolder,
    only_map,
    with_sunspec,
)
from tests.devices.sunspec import COMMON, METER, registers, write_models
from tests.devices.transactions import transaction
from tests.workflows.evidence import capture_of, read

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A capture in which a value is read first, then the map of the device."""
    device = registers()
    exchanges = [read(40039, [235]), *(read(*block) for block in device.items())]
    path = tmp_path / "site.pcap"
    path.write_bytes(capture_of(exchanges))
    return path


def test_a_device_in_a_capture_gets_the_profile_of_its_models(site: Path, tmp_path: Path) -> None:
    told: list[str] = []
    folder = SunSpecFolder(write_models(tmp_path / "models"))
    options = with_sunspec([str(site)], ReadingOptions(), folder, told.append)
    (assigned,) = options.assignments
    assert assigned.who == Who("10.0.0.2", 502, 1)
    assert assigned.profile.name == "sunspec-10.0.0.2-1"
    assert told == [
        "unit 1 at 10.0.0.2:502: Maker Meter 7, SunSpec models 1, 64900, 64999 from 40000 on"
    ]


def test_a_slave_with_a_profile_of_the_users_keeps_it(site: Path, tmp_path: Path) -> None:
    told: list[str] = []
    folder = SunSpecFolder(write_models(tmp_path / "models"))
    options = ReadingOptions(assignments=Assignments([parse_assignment("1=wago-750")]))
    named = with_sunspec([str(site)], options, folder, told.append)
    assert [one.profile.name for one in named.assignments] == ["wago-750"]
    assert told == ["--sunspec: no slave was asked for its SunSpec models here"]


def test_a_pipe_is_not_read_twice(tmp_path: Path) -> None:
    folder = SunSpecFolder(write_models(tmp_path / "models"))
    with pytest.raises(UsageError, match="-: --sunspec reads a file twice"):
        with_sunspec(["-"], ReadingOptions(), folder, print)


def test_models_may_stand_in_the_folder_json_of_a_copy(tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    write_models(tmp_path / "copy" / "json")
    assert SunSpecFolder(tmp_path / "copy").file(1) is not None
    assert SunSpecFolder(tmp_path / "copy").file(2) is None


def test_a_folder_without_models_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError, match="no folder with SunSpec models"):
            SunSpecFolder(path)


def test_each_model_that_cannot_be_imported_is_told(tmp_path: Path) -> None:
    folder = write_models(tmp_path / "models", COMMON, METER)
    (folder / "model_9.json").write_text("{}")
    count, wrong = SunSpecFolder(folder).try_all()
    assert count == 2
    assert [line.split(":")[0] for line in wrong] == ["model_9.json"]


def _noted(*units: int) -> SunSpecDevices:
    devices = SunSpecDevices()
    for unit in units:
        for address, values in registers().items():
            one = transaction(3, address, response_values=values, unit=unit)
            devices.note(Namer().name(one))
    return devices


def test_one_of_several_devices_must_be_named() -> None:
    devices = _noted(1, 2)
    with pytest.raises(UsageError, match="2 SunSpec devices are there: 1, 2; name one with --unit"):
        only_map(devices, None, "--unit")
    assert only_map(devices, Who(unit=2), "--unit").models
    with pytest.raises(UsageError, match="no such slave was asked"):
        only_map(devices, Who(unit=3), "--unit")


def test_the_devices_that_are_held_are_bounded() -> None:
    devices = SunSpecDevices()
    for number in range(MAX_DEVICES + 5):
        one = transaction(3, 40000, response_values=[0x5375, 0x6E53], link=f"{number}")
        devices.note(Namer().name(one))
    assert len(devices.maps) == MAX_DEVICES
