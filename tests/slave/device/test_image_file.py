"""Values to start with, from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, UsageError
from mbtool.devices import load_profile
from mbtool.modbus.tables import Table
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.device.image_file import MAX_FILE_BYTES, Course, FromCapture, load_image

if TYPE_CHECKING:
    from pathlib import Path


def _load(path: Path, text: str, profile: str = "idec-ft1a-touch") -> RegisterImage:
    image = RegisterImage()
    file = path / "start.toml"
    file.write_text(text, encoding="utf-8")
    assert load_image(file, load_profile(profile), image) == []
    return image


def test_reads_single_values_lists_and_bits(tmp_path: Path) -> None:
    image = _load(
        tmp_path,
        """
        HR400001 = 4660
        "HR400010" = [1, 2, 3]
        ir300002 = -2
        C1 = 1
        I100001 = [true, false, 1]
        """,
    )
    assert image.get(Table.HOLDING_REGISTERS, 0, 2) == [4660, 0]
    assert image.get(Table.HOLDING_REGISTERS, 9, 4) == [1, 2, 3, 0]
    assert image.get(Table.INPUT_REGISTERS, 1) == [0xFFFE]
    assert image.get(Table.COILS, 0, 2) == [1, 0]
    assert image.get(Table.DISCRETE_INPUTS, 0, 3) == [1, 0, 1]


def test_reads_the_notation_of_the_device(tmp_path: Path) -> None:
    image = _load(tmp_path, "X1F = 1\n0102H = 0x005C\nRWr2 = [12000, 4000]", "fa3-at1m8x")
    assert image.get(Table.DISCRETE_INPUTS, 0x1F) == [1]
    assert image.get(Table.HOLDING_REGISTERS, 0x0102) == [0x5C]
    assert image.get(Table.INPUT_REGISTERS, 2, 2) == [12000, 4000]


def test_a_list_stands_at_a_reference_also_where_a_point_has_the_same_name(tmp_path: Path) -> None:
    image = _load(tmp_path, "X0 = [1, 0, 0, 1]", "fa3-th1m16xc")
    assert image.get(Table.DISCRETE_INPUTS, 0, 5) == [1, 0, 0, 1, 0]


def test_a_later_line_counts_where_ranges_overlap(tmp_path: Path) -> None:
    image = _load(tmp_path, "HR400001 = [1, 2, 3]\nHR400002 = 9")
    assert image.get(Table.HOLDING_REGISTERS, 0, 3) == [1, 9, 3]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("HR999999 = 1", "start.toml: reference 'HR999999'"),
        ("HR400001 = 65536", "start.toml: HR400001: 65536: write a number from -32768 to 65535"),
        ("HR400001 = -32769", "write a number from -32768 to 65535"),
        ("HR400001 = 1.5", "start.toml: HR400001: 1.5: write a number"),
        ('HR400001 = "on"', "start.toml: HR400001: 'on': write a number"),
        ("HR400001 = true", "start.toml: HR400001: true: write a number"),
        ("HR400001 = [1, [2]]", r"start.toml: HR400001: \[2\]: write a number"),
        ("HR400001 = []", "start.toml: HR400001: the list is empty"),
        ("[HR400001]\nx = 1", "start.toml: HR400001: {'x': 1}: write a number, or one of ramp"),
        ("C1 = 2", "start.toml: C1: 2: write a number from 0 to 1"),
        ("HR404096 = [1, 2]", "start.toml: HR404096: 2 values do not .* ends at HR404096"),
        ('"holding 4096" = 1', "holding 4096: idec-ft1a-touch has no such address"),
        ("HR400001 = { ramp = [0], seconds = 1 }", r"HR400001: ramp: \[0\]: write two numbers"),
        ("HR400001 = { ramp = [0, inf], seconds = 1 }", "ramp: .* write two numbers"),
        ("HR400001 = { ramp = [0, 1] }", "HR400001: seconds: is missing; ramp needs it"),
        ("HR400001 = { ramp = [0, 1], seconds = 0 }", "seconds: 0: write a number from 0.001"),
        ("HR400001 = { ramp = [0, 1], second = 1 }", "second: does not go with ramp; did you mean"),
        ("HR400001 = { ramp = [0, 70000], seconds = 1 }", "70000: write a number from -32768"),
        ("HR400001 = { ramp = [0, 1], sine = [0, 1] }", "one of ramp, sine, steps, walk, from"),
        ("HR400001 = { steps = [], seconds = 1 }", r"HR400001: steps: \[\]: write numbers, such"),
        ("HR400001 = { steps = [0, 70000], seconds = 1 }", "70000: write a number from -32768"),
        ("C1 = { sine = [0, 2], seconds = 1 }", "C1: 2: write a number from 0 to 1"),
        ("HR400001 = { from = 1 }", "from: 1: write a text"),
        ('HR400001 = { from = "a", unit = 256 }', "unit: 256: write a number from 0 to 255"),
        ('HR400001 = { from = "a", what = "C1" }', "what: 'C1': a bit and a register"),
        ('HR400001 = { from = "a", loop = 1 }', "loop: 1: write true or false"),
        ('HR400001 = { from = "a" }', "HR400001: from: no capture can be read here"),
    ],
)
def test_names_file_key_and_value_of_a_mistake(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        _load(tmp_path, text)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"HR400001 4660", "not TOML"),
        (b"HR400001 = 1\nHR400001 = 2", "not TOML"),
        (b"\xff\xfe", "not TOML"),
        (b"x = " + b"[" * 100_000, "nested too deep"),
        (b"#" * (MAX_FILE_BYTES + 1), "more than 4194304 bytes"),
    ],
)
def test_refuses_a_file_of_another_kind(tmp_path: Path, data: bytes, says: str) -> None:
    file = tmp_path / "start.toml"
    file.write_bytes(data)
    with pytest.raises(UsageError, match=says):
        load_image(file, load_profile("idec-ft1a-touch"), RegisterImage())


@pytest.mark.parametrize("value", ["{}", "{{ ramp = [0, {}], seconds = 1 }}"])
def test_numbers_that_no_computer_reckons_with_are_refused(tmp_path: Path, value: str) -> None:
    text = '"CH1 digital operation value" = ' + value.format("1" + "0" * 400)
    with pytest.raises(UsageError, match=r"10000.* is a number of more than 100 digits"):
        _load(tmp_path, text, "fa3-at1m8x")


def test_refuses_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.toml: cannot be read: No such file"):
        load_image(tmp_path / "absent.toml", load_profile("idec-ft1a-touch"), RegisterImage())


def test_what_moves_is_given_back_and_leaves_the_image_alone(tmp_path: Path) -> None:
    file = tmp_path / "start.toml"
    file.write_text(
        """
        HR400001 = { ramp = [0, 100], seconds = 10 }
        HR400002 = { sine = [0, 100], seconds = 10 }
        HR400003 = { walk = [0, 100], seconds = 0.5 }
        HR400004 = { walk = [0, 100], seconds = 0.5 }
        HR400005 = { steps = [7, 8, 9], seconds = 1 }
        """
    )
    image = RegisterImage()
    driven = load_image(file, load_profile("idec-ft1a-touch"), image)
    assert [one.target.address for one in driven] == [0, 1, 2, 3, 4]
    assert [one.course(0) for one in driven] == [[0], [50], [50], [50], [7]]
    assert [one.course(2_500_000_000) for one in driven[:2]] == [[25], [100]]
    assert driven[4].course(2_500_000_000) == [9]
    later = [[one.course(step * 500_000_000) for step in range(20)] for one in driven[2:4]]
    assert later[0] != later[1]
    assert image.get(Table.HOLDING_REGISTERS, 0, 5) == [0, 0, 0, 0, 0]


def test_a_capture_is_asked_for_by_what_it_holds(tmp_path: Path) -> None:
    file = tmp_path / "start.toml"
    file.write_text(
        """
        [HR400001]
        from = "site.mcap"
        what = "IR300005"
        unit = 3
        link = "rs485"
        speed = 2
        loop = false
        [HR400002]
        from = "site.mcap"
        # = { from = "site.mcap" }
        """
    )
    asked: list[FromCapture] = []

    def recall(what: FromCapture) -> Course:
        asked.append(what)
        return lambda moment_ns: [moment_ns]

    profile = load_profile("idec-ft1a-touch")
    driven = load_image(file, profile, RegisterImage(), recall=recall)
    site = tmp_path / "site.mcap"
    assert asked == [
        FromCapture(site, Table.INPUT_REGISTERS, 4, 1, 3, "rs485", 2.0, False),
        FromCapture(site, Table.HOLDING_REGISTERS, 1, 1, None, None, 1, True),
    ]
    assert driven[1].course(5) == [5]


def test_names_are_keys_in_the_measure_of_their_points(tmp_path: Path) -> None:
    image = _load(tmp_path, '"watchdog time" = 1500\n"Item number" = 341', "wago-750")
    assert image.get(Table.HOLDING_REGISTERS, 0x1000) == [15]
    assert image.get(Table.HOLDING_REGISTERS, 0x2012) == [341]
