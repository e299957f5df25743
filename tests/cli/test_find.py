from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.devices import load_profile
from tests.cli.test_stats import FOLDER, LINE

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine

PLANT = FOLDER / "plant.pcap"


def test_the_register_of_a_number_is_told(mbtool: CommandLine) -> None:
    told = mbtool("find", LINE, "466.0")
    assert told.code == exit_codes.DONE
    assert told.lines[0] == "466"
    assert told.lines[1].split() == [
        "likely",
        "register",
        "type",
        "scale",
        "in",
        "the",
        "recording",
    ]
    assert "holding 0" in told.lines[2]
    assert "x 0.1" in told.lines[2]


def test_a_number_that_is_nowhere_is_the_answer_no(mbtool: CommandLine) -> None:
    told = mbtool("find", LINE, "-123456.7")
    assert told.code == exit_codes.NO
    assert told.lines[-1] == "in no register, in no type and scale"


def test_all_places_are_given_as_json(mbtool: CommandLine) -> None:
    (one,) = json.loads(mbtool("find", LINE, "Speed=466.0rpm", "--json").out)
    assert (one["name"], one["unit"], one["values"]) == ("Speed", "rpm", [466.0])
    best = one["places"][0]
    assert (best["table"], best["address"], best["scale"]) == ("holding_registers", 0, 0.1)


def test_the_best_place_is_kept_in_a_new_profile_and_in_one_that_is_there(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    file = tmp_path / "device.toml"
    told = mbtool("find", LINE, "Speed=466.0rpm", "--keep", str(file))
    assert told.err.endswith(f"1 point -> {file}\n")
    (speed,) = [one for one in load_profile(str(file)).points if one.name == "Speed"]
    assert (speed.address, speed.scale, speed.unit) == (0, 0.1, "rpm")
    file.write_text(file.read_text() + "\n# A remark of the user.\n")
    mbtool("find", LINE, "Rate=4660", "--keep", str(file))
    names = [one.name for one in load_profile(str(file)).points]
    assert "Rate" in names
    assert "Speed" not in names
    assert "# A remark of the user." in file.read_text()


def test_a_number_outside_of_what_was_recorded_is_told_and_not_kept(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    file = tmp_path / "device.toml"
    told = mbtool("find", str(PLANT), "Room=23.9degC", "--keep", str(file))
    assert told.code == exit_codes.NO
    percent, row = told.lines[2].split(" %")
    assert float(percent) < 50
    assert row.split()[:3] == ["10.0.0.12:502/1", "input", "0"]
    assert told.lines[2].endswith("23 to 23.2 degC, never 23.9")
    assert told.err == (
        "mbtool: Room is not kept: the registers never had 23.9 in the recording; record while the "
        "display shows it, and give the time: 23.9@TIME\n"
        f"mbtool: nothing is likely enough, so {file} is not written\n"
    )
    assert not file.exists()


def test_a_profile_stays_as_it_was_if_a_point_cannot_be_added_to_its_text(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    file = tmp_path / "device.toml"
    text = (
        'name = "pump"\ntitle = "Pump"\nvendor = "us"\ntransports = ["rtu"]\nsource = "us"\n'
        "areas = []\nfunctions = { 03 = {} }\n"
    )
    file.write_text(text)
    load_profile(str(file))
    told = mbtool("find", LINE, "Speed=466.0rpm", "--keep", str(file))
    assert told.code == exit_codes.USAGE
    assert told.err.startswith(f"mbtool: {file}: ")
    assert told.err.endswith(f"; {file} stays as it was\n")
    assert file.read_text() == text


def test_numbers_come_from_a_file(mbtool: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "seen.csv"
    file.write_text("time,Speed\n0s,10.0\n")
    (one,) = json.loads(mbtool("find", LINE, "--values", str(file), "--json").out)
    assert one["name"] == "Speed"


def test_a_changed_setting_is_told(mbtool: CommandLine) -> None:
    told = mbtool("find", LINE, "--changed-between", "0s", "100ms")
    assert told.code in (exit_codes.DONE, exit_codes.NO)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "name what the display showed behind the files"),
        (["nonsense"], "'nonsense': write a number as the display shows it"),
        (["--changed-between", "1s", "0s"], "the second time is not after the first"),
        (["--changed-between", "0s", "500000s"], "--changed-between 500000s: is not in the record"),
        (["5@0s", "7@500000s"], ", which is not in the recording, "),
        (["5", "--changed-between", "1s", "2s"], "goes without numbers"),
        (["--unknown"], "'--unknown': write a number"),
    ],
)
def test_what_cannot_be_found_is_one_line(
    mbtool: CommandLine, arguments: list[str], said: str
) -> None:
    told = mbtool("find", LINE, *arguments)
    assert told.code == exit_codes.USAGE
    assert said in told.err
    assert told.err.count("\n") == 1
