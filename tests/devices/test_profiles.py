"""The built-in profiles against the figures of the manuals."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbtool.devices import (
    RULES,
    AnswerWord,
    Area,
    Exceptions,
    FunctionRule,
    Point,
    Profile,
    builtin_profiles,
    load_profile,
    parse_reference,
)
from mbtool.modbus.tables import Table

DOCUMENTATION = Path(__file__).resolve().parents[2] / "docs" / "devices.md"

FA3 = ["fa3-at1m8x", "fa3-at1m8y", "fa3-th1m16xc", "fa3-th1m16y", "fa3-th1m16ye"]


def _defaults(profile: Profile) -> dict[int, int]:
    return {
        address: point.default
        for point in profile.points
        if point.default is not None
        for address in point.addresses
    }


def test_six_profiles_are_built_in() -> None:
    assert builtin_profiles() == [*FA3, "idec-ft1a-touch"]


@pytest.mark.parametrize("name", builtin_profiles())
def test_profile_is_named_as_its_file(name: str) -> None:
    assert load_profile(name).name == name


@pytest.mark.parametrize(
    ("reference", "table", "address"),
    [
        ("C1", Table.COILS, 0),
        ("C4096", Table.COILS, 0xFFF),
        ("I100001", Table.DISCRETE_INPUTS, 0),
        ("I104096", Table.DISCRETE_INPUTS, 0xFFF),
        ("IR300001", Table.INPUT_REGISTERS, 0),
        ("IR304096", Table.INPUT_REGISTERS, 0xFFF),
        ("HR400001", Table.HOLDING_REGISTERS, 0),
        ("HR404096", Table.HOLDING_REGISTERS, 0xFFF),
    ],
)
def test_ft1a_areas_begin_and_end_where_the_supplement_says(
    reference: str, table: Table, address: int
) -> None:
    profile = load_profile("idec-ft1a-touch")
    assert parse_reference(profile, reference) == (table, address)
    assert profile.area(table, 0x1000) is None


def test_ft1a_has_seven_functions_and_two_exception_codes() -> None:
    profile = load_profile("idec-ft1a-touch")
    limits = {code: rule.limit for code, rule in profile.functions.items()}
    assert limits == {
        "01": 2000, "02": 2000, "03": 125, "04": 125, "05": None, "06": None, "10": 100,
    }  # fmt: skip
    assert profile.exceptions.documented == [1, 2]
    assert profile.exceptions.value == 2


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("fa3-th1m16xc", 0x13),
        ("fa3-th1m16y", 0x14),
        ("fa3-th1m16ye", 0x15),
        ("fa3-at1m8x", 0x16),
        ("fa3-at1m8y", 0x17),
    ],
)
def test_fa3_model_code_is_the_one_that_function_42h_gives(name: str, code: int) -> None:
    profile = load_profile(name)
    rule = profile.rule(0x42)
    assert rule is not None
    assert rule.answer is not None
    assert profile.model_code == code
    assert rule.answer.texts[code] == name.upper()


@pytest.mark.parametrize("name", FA3)
def test_fa3_has_the_functions_and_the_defaults_of_its_chapter(name: str) -> None:
    profile = load_profile(name)
    assert " ".join(sorted(profile.functions)) == "01 02 03 04 05 06 0F 10 41 42 43 44"
    assert profile.any_unit
    assert _defaults(profile) == {
        0xF0: 0x03FA,  # 3.250
        0xF1: 0xC0A8,  # 192.168
        0xF2: 600,
        0xF3: 10,
        0xF4: 3,
        0xF5: 30,
    }


@pytest.mark.parametrize("name", FA3)
def test_fa3_holding_registers_have_a_hole(name: str) -> None:
    profile = load_profile(name)
    table = Table.HOLDING_REGISTERS
    assert [address for address in range(0x40) if profile.area(table, address) is None] == list(
        range(0x10, 0x20)
    )
    assert profile.area(table, 0x4FFF) is not None
    assert profile.area(table, 0x5000) is None


@pytest.mark.parametrize("name", FA3)
def test_fa3_analog_models_have_32_signals_and_digital_ones_16(name: str) -> None:
    profile = load_profile(name)
    last = 0x1F if "-at" in name else 0x0F
    for table in (Table.COILS, Table.DISCRETE_INPUTS):
        assert profile.area(table, 0, last + 1) is not None
        assert profile.area(table, last + 1) is None
    assert profile.area(Table.INPUT_REGISTERS, 0, 0x20) is not None


def test_limits_stand_in_opposite_order_on_input_and_output_modules() -> None:
    starts = {
        point.name: point.address
        for name in ("fa3-at1m8x", "fa3-at1m8y")
        for point in load_profile(name).points
        if "limit" in point.name
    }
    assert starts == {
        "CH{n} scaling lower limit value": 0x134,
        "CH{n} scaling upper limit value": 0x135,
        "CH{n} warning output upper limit value": 0x108,
        "CH{n} warning output lower limit value": 0x109,
    }


def test_documentation_names_every_profile_key_and_rule() -> None:
    text = DOCUMENTATION.read_text(encoding="utf-8")
    for name in builtin_profiles():
        assert f"| `{name}` |" in text
    for part in (Profile, Area, FunctionRule, AnswerWord, Exceptions, Point):
        for key in part.__struct_fields__:
            assert f"`{key}`" in text
    for letter, rule in RULES.items():
        assert f"| {letter} | {rule} |" in text


def test_example_of_the_documentation_is_a_profile(tmp_path: Path) -> None:
    text = DOCUMENTATION.read_text(encoding="utf-8")
    (tmp_path / "pump.toml").write_text(
        text.partition("## A profile of your own")[2].partition("```toml\n")[2].partition("```")[0],
        encoding="utf-8",
    )
    profile = load_profile(str(tmp_path / "pump.toml"))
    assert [point.name for point in profile.points] == ["Speed", "State", "CH{n} temperature"]
