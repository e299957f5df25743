from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core.errors import InputError, ProfileError, UsageError
from mbtool.devices.assignment import Assignment, Assignments, Who
from mbtool.devices.loading import (
    MAX_EXTENDED,
    MAX_JSON_BYTES,
    builtin_profiles,
    load_profile,
    profile_from_json,
    profile_to_json,
)
from mbtool.devices.naming import Namer
from mbtool.devices.point_types import PointType
from mbtool.devices.wording import describe
from tests.devices.pump import PUMP
from tests.devices.transactions import transaction

if TYPE_CHECKING:
    from mbtool.devices.model import Profile


def _load(folder: Path, text: str, name: str = "pump.toml") -> Profile:
    (folder / name).write_text(text, encoding="utf-8")
    return load_profile(str(folder / name))


def _problem(folder: Path, text: str) -> tuple[str, str]:
    with pytest.raises(ProfileError) as caught:
        _load(folder, text)
    assert caught.value.file == str(folder / "pump.toml")
    assert "\n" not in str(caught.value)
    return caught.value.key, caught.value.problem


def test_loads_a_file_of_the_users_own(tmp_path: Path) -> None:
    profile = _load(tmp_path, PUMP)
    assert profile.name == "pump"
    assert profile.points[0].type is PointType.UINT16


def test_built_in_profile_is_read_once() -> None:
    assert load_profile("fa3-at1m8x") is load_profile("fa3-at1m8x")


def test_an_unknown_name_is_refused_with_similar_and_all_names() -> None:
    with pytest.raises(UsageError, match=r"did you mean fa3-at1m8. or fa3-at1m8.\?") as caught:
        load_profile("FA3-AT1M8")
    for name in builtin_profiles():
        assert name in str(caught.value)


def test_the_common_part_of_a_family_is_no_profile() -> None:
    with pytest.raises(UsageError, match="built-in ones are"):
        load_profile("_fa3")


def test_absent_file_is_named_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.toml: cannot be read: No such file"):
        load_profile(str(tmp_path / "nothing.toml"))


def test_profile_extends_a_built_in_one(tmp_path: Path) -> None:
    mine = _load(
        tmp_path,
        """
        extends = "idec-ft1a-touch"
        name = "line-3"
        notes = ["Beside the press."]

        [functions]
        10 = { limit = 32 }

        [exceptions]
        documented = [1, 2, 3]

        [[areas]]
        name = "coil status"
        table = "coils"
        first = 0
        last = 15
        access = "r"
        prefix = "C"
        base = 1

        [[points]]
        name = "Speed"
        table = "holding_registers"
        address = 0
        """,
    )
    base = load_profile("idec-ft1a-touch")
    assert mine.name == "line-3"
    assert mine.vendor == base.vendor
    assert mine.functions["10"].limit == 32
    assert mine.functions["03"] == base.functions["03"]
    assert mine.exceptions.value == 2
    assert mine.exceptions.documented == [1, 2, 3]
    assert [area.last for area in mine.areas] == [15, 4095, 4095, 4095]
    assert mine.notes == [*base.notes, "Beside the press."]


def test_profile_extends_a_file_beside_it(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(PUMP, encoding="utf-8")
    assert _load(tmp_path, 'extends = "base.toml"\nname = "second"').title == "A pump"


def test_mistake_in_an_extended_file_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(PUMP.replace("last = 9", "last = -9"), encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        _load(tmp_path, 'extends = "base.toml"')
    assert caught.value.file == str(tmp_path / "base.toml")


def test_circle_of_files_is_refused(tmp_path: Path) -> None:
    key, problem = _problem(tmp_path, 'extends = "pump.toml"')
    assert key == "extends"
    assert (
        problem == "'pump.toml' is this file, or extends it in turn; one of them must stand alone"
    )


def test_circle_of_several_files_is_refused_where_it_closes(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('extends = "b.toml"', encoding="utf-8")
    (tmp_path / "b.toml").write_text('extends = "pump.toml"', encoding="utf-8")
    with pytest.raises(ProfileError, match=r"'pump\.toml' is this file, or extends it") as caught:
        _load(tmp_path, 'extends = "a.toml"')
    assert caught.value.file == str(tmp_path / "b.toml")


def test_at_most_so_many_files_extend_one_another(tmp_path: Path) -> None:
    (tmp_path / "0.toml").write_text(PUMP, encoding="utf-8")
    for number in range(1, MAX_EXTENDED + 1):
        text = f'extends = "{number - 1}.toml"'
        (tmp_path / f"{number}.toml").write_text(text, encoding="utf-8")
    assert load_profile(str(tmp_path / f"{MAX_EXTENDED - 1}.toml")).name == "pump"
    with pytest.raises(ProfileError, match="more than 8 files extend one another"):
        load_profile(str(tmp_path / f"{MAX_EXTENDED}.toml"))


def test_point_that_stands_twice_in_an_extending_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(PUMP, encoding="utf-8")
    again = '[[points]]\nname = "Speed"\ntable = "holding_registers"\naddress = 4\n'
    assert _load(tmp_path, 'extends = "base.toml"\n' + again).points[0].address == 4
    key, _ = _problem(tmp_path, 'extends = "base.toml"\n' + again + again)
    assert key == 'points "Speed".name'


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "pump.toml").write_text("\ufeff" + PUMP, encoding="utf-8")
    assert load_profile(str(tmp_path / "pump.toml")).name == "pump"


@pytest.mark.parametrize("name", builtin_profiles())
def test_a_profile_survives_json(name: str) -> None:
    profile = load_profile(name)
    assert profile_from_json(profile_to_json(profile), "log") == profile


@pytest.mark.parametrize(
    "data", [b"", b"[]", b"\xff", b"{", b"[" * 100_000, b"{}", b" " * (MAX_JSON_BYTES + 1)]
)
def test_json_that_is_no_profile_is_refused(data: bytes) -> None:
    with pytest.raises(ProfileError, match=r"^log: "):
        profile_from_json(data, "log")


def test_import_reads_no_profile() -> None:
    code = """
import sys
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
import mbtool.devices
assert not [name for name in opened if name.endswith(".toml")], opened
mbtool.devices.load_profile("idec-ft1a-touch")
assert len([name for name in opened if name.endswith(".toml")]) == 1
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_timing_is_merged_key_by_key(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(PUMP + '[timing]\nt3_5 = "28bits"\nt1_5 = "1ms"\n')
    profile = _load(tmp_path, 'extends = "base.toml"\nname = "other"\n[timing]\nt1_5 = "2ms"\n')
    assert (profile.timing.t1_5, profile.timing.t3_5) == ("2ms", "28bits")
    assert profile_from_json(profile_to_json(profile), "a log") == profile
    key, problem = _problem(tmp_path, PUMP + "[timing]\nt35 = 1\n")
    assert (key, problem) == ("timing.t35", "unknown key; did you mean 't3_5'?")


def test_texts_and_bits_take_numbers_in_any_notation(tmp_path: Path) -> None:
    profile = _load(
        tmp_path,
        PUMP
        + """
type = "flags"
bits = { 0 = "READY", 0x0F = "ALARM" }

[exceptions]
documented = [1, 2, 3, 0x11]
texts = { 0x11 = "value out of setting range" }
""",
    )
    assert profile.points[0].bits == {0: "READY", 15: "ALARM"}
    assert profile.exceptions.texts == {17: "value out of setting range"}
    assert profile_from_json(profile_to_json(profile), "a log") == profile


def test_the_number_of_a_text_has_at_most_100_digits(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    key = "0x" + "f" * 6000
    path.write_text(PUMP + f'[exceptions]\ntexts = {{ "{key}" = "range" }}\n')
    with pytest.raises(ProfileError, match="a key of more than 100 digits"):
        load_profile(str(path))


def test_texts_of_exceptions_are_inherited(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(
        PUMP + '[exceptions]\ndocumented = [1, 2, 3, 17]\ntexts = { 17 = "range" }\n'
    )
    profile = _load(tmp_path, 'extends = "base.toml"\n[exceptions]\nvalue = 2\n')
    assert (profile.exceptions.value, profile.exceptions.texts) == (2, {17: "range"})


def test_example_of_the_documentation_reads_as_it_says_there(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "devices.md").read_text(encoding="utf-8")
    part = page.partition("## A profile of your own")[2]
    profile = _load(tmp_path, part.partition('"pump.toml"\n')[2].partition("```")[0])
    namer = Namer(Assignments([Assignment(Who(), profile)]))
    floats = [word for value in (20.5, 21.25) for word in reversed(_words(">f", value))]
    told = [
        describe(namer.name(transaction(3, address, quantity=len(words), response_values=words)))
        for address, words in (
            (10, [12000, 183, 1, 3]),
            (20, floats),
            (0x1000, _words("16s", b"FP-7/2".ljust(16))),
        )
    ]
    told.append(describe(namer.name(transaction(6, 10, quantity=1, request_values=[16000]))))
    assert told == [
        "D10..13 Speed: 1200.0 rpm; Oil temperature: 41.5 degC; State: running; "
        "Alarms: pressure low, filter",
        "D20..23 temperature: CH1 20.5 degC, CH2 21.25 degC",
        "1000H..1007H Model: FP-7/2",
        "D10 Speed: 1600.0 rpm",
    ]
    assert profile.exception_name(0x11) == "value out of setting range"


def _words(form: str, value: float | bytes) -> list[int]:
    data = struct.pack(form, value)
    return [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]


@pytest.mark.parametrize(
    ("keys", "stride"),
    [
        ("type = 'float32'", 2),
        ("type = 'float32'\nstride = 3", 3),
        ("type = 'string'\nlength = 4", 4),
        ("type = 'int16'", 1),
    ],
)
def test_points_of_a_series_are_side_by_side_by_default(
    keys: str, stride: int, tmp_path: Path
) -> None:
    path = tmp_path / "pump.toml"
    path.write_text(
        PUMP.replace("last = 9", "last = 99").replace('"Speed"', '"CH{n}"') + f"count = 4\n{keys}\n"
    )
    (point,) = load_profile(str(path)).points
    assert point.addresses == range(3, 3 + 4 * stride, stride)
