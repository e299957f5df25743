"""The built-in profiles against the figures of the manuals."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbtool.devices.loading import builtin_profiles, load_profile
from mbtool.devices.model import AnswerWord, Area, Exceptions, FunctionRule, Point, Profile
from mbtool.devices.references import parse_reference, write_reference
from mbtool.modbus.adu import Transport
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


def _limits(profile: Profile) -> dict[str, int | None]:
    return {code: rule.limit for code, rule in profile.functions.items()}


def test_nine_profiles_are_built_in() -> None:
    assert builtin_profiles() == [
        "chino-lt830", *FA3, "idec-ft1a-smartaxis", "idec-ft1a-touch", "wago-750",
    ]  # fmt: skip


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


@pytest.mark.parametrize("name", FA3)
def test_fa3_remote_reset_has_no_answer_and_exceptions_the_chapters_names(name: str) -> None:
    profile = load_profile(name)
    silent = [code for code, rule in profile.functions.items() if not rule.answers]
    assert silent == ["41"]
    assert [profile.exception_name(code) for code in (1, 2, 3)] == [
        "function code error", "device address error", "data error",
    ]  # fmt: skip


# The address map of the manual, page 11-9: the device, and the address of the frame.
_SMARTAXIS = [
    ("Q0", Table.COILS, 0x0000),
    ("Q137", Table.COILS, 0x006F),  # Printed as Q141, which is 000114.
    ("R0", Table.COILS, 0x02BC),
    ("R127", Table.COILS, 0x033B),
    ("M0", Table.COILS, 0x03E8),
    ("M325", Table.COILS, 0x04ED),  # The page's own example.
    ("M1277", Table.COILS, 0x07E7),
    ("M8000", Table.COILS, 0x2328),
    ("M8177", Table.COILS, 0x23B7),
    ("I0", Table.DISCRETE_INPUTS, 0x0000),
    ("I155", Table.DISCRETE_INPUTS, 0x007D),
    ("T0", Table.DISCRETE_INPUTS, 0x03E8),
    ("T199", Table.DISCRETE_INPUTS, 0x04AF),
    ("C0", Table.DISCRETE_INPUTS, 0x05DC),
    ("C199", Table.DISCRETE_INPUTS, 0x06A3),
    ("T0", Table.INPUT_REGISTERS, 0x0000),
    ("T199", Table.INPUT_REGISTERS, 0x00C7),
    ("C0", Table.INPUT_REGISTERS, 0x01F4),
    ("C199", Table.INPUT_REGISTERS, 0x02BB),
    ("D0", Table.HOLDING_REGISTERS, 0x0000),
    ("D1999", Table.HOLDING_REGISTERS, 0x07CF),
    ("D8000", Table.HOLDING_REGISTERS, 0x1F40),
    ("D8199", Table.HOLDING_REGISTERS, 0x2007),
    ("T0", Table.HOLDING_REGISTERS, 0x2328),
    ("T199", Table.HOLDING_REGISTERS, 0x23EF),
    ("C0", Table.HOLDING_REGISTERS, 0x251C),
    ("C199", Table.HOLDING_REGISTERS, 0x25E3),
]


@pytest.mark.parametrize(("reference", "table", "address"), _SMARTAXIS)
def test_smartaxis_devices_stand_where_the_address_map_says(
    reference: str, table: Table, address: int
) -> None:
    assert write_reference(load_profile("idec-ft1a-smartaxis"), table, address) == reference


def test_smartaxis_has_as_many_devices_as_its_address_map() -> None:
    profile = load_profile("idec-ft1a-smartaxis")
    sizes = dict.fromkeys(Table, 0)
    for area in profile.areas:
        sizes[area.table] += area.last - area.first + 1
    assert sizes == {
        Table.COILS: 112 + 128 + 1024 + 144,
        Table.DISCRETE_INPUTS: 126 + 200 + 200,
        Table.INPUT_REGISTERS: 200 + 200,
        Table.HOLDING_REGISTERS: 2000 + 200 + 200 + 200,
    }
    assert profile.area(Table.COILS, 0x808) is None  # M1320 of the example of function 05.


def test_smartaxis_takes_128_bits_64_words_and_no_preset_value() -> None:
    profile = load_profile("idec-ft1a-smartaxis")
    assert _limits(profile) == {
        "01": 128, "02": 128, "03": 64, "04": 64, "05": None, "06": None, "0F": 128, "10": 64,
    }  # fmt: skip
    holding = Table.HOLDING_REGISTERS
    assert profile.allows(holding, range(2000), writing=True)
    for first in (0x2328, 0x251C):
        assert profile.allows(holding, range(first, first + 200))
        assert not profile.allows(holding, range(first, first + 1), writing=True)
    assert profile.exceptions.documented == [1, 2, 3]
    assert profile.timing.request_interval is None  # Its 5 ms are those of a SmartAXIS as master.


@pytest.mark.parametrize(
    ("reference", "table", "address"),
    [
        ("1", Table.COILS, 0),
        ("101", Table.COILS, 0x64),
        ("10001", Table.DISCRETE_INPUTS, 0),
        ("30001", Table.INPUT_REGISTERS, 0),
        ("40001", Table.HOLDING_REGISTERS, 0),
        ("40206", Table.HOLDING_REGISTERS, 0xCD),
    ],
)
def test_lt830_reference_less_the_first_of_its_class_is_the_start_number(
    reference: str, table: Table, address: int
) -> None:
    profile = load_profile("chino-lt830")
    assert parse_reference(profile, reference) == (table, address)
    assert write_reference(profile, table, address) == reference


def test_lt830_takes_less_in_ascii_mode() -> None:
    profile = load_profile("chino-lt830")
    rtu, ascii_ = (
        _limits(profile.with_limits_of(mode)) for mode in (Transport.RTU, Transport.ASCII)
    )
    assert [rtu[code] for code in ("01", "03", "04", "0F", "10")] == [1, 26, 26, 1, 26]
    assert [ascii_[code] for code in ("01", "03", "04", "0F", "10")] == [1, 13, 13, 1, 11]


def test_lt830_keeps_28_bit_times_and_the_makers_own_exception_codes() -> None:
    profile = load_profile("chino-lt830")
    assert (profile.timing.t1_5, profile.timing.t3_5) == ("28bits", "28bits")
    assert profile.exceptions.documented == [1, 2, 3, 0x11, 0x12]
    assert profile.exception_name(0x11) == "value out of setting range"


def test_wago_reads_inputs_where_it_writes_outputs_and_reads_those_back_above() -> None:
    profile = load_profile("wago-750")
    for table, width, inputs, outputs in (
        (Table.HOLDING_REGISTERS, 0x100, "%IW", "%QW"),
        (Table.COILS, 0x200, "DI", "DO"),
    ):
        for address in (0, width - 1):
            read = write_reference(profile, table, address)
            written = write_reference(profile, table, address, writing=True)
            assert (read, written) == (f"{inputs}{address}", f"{outputs}{address}")
            assert write_reference(profile, table, 0x200 + address) == written
        assert profile.allows(table, range(width), writing=True)


@pytest.mark.parametrize("address", [0x0100, 0x01FF, 0x0300, 0x0FFF, 0x3000, 0x62FD, 0x72FD])
def test_wago_couplers_have_no_registers_of_a_program(address: int) -> None:
    profile = load_profile("wago-750")
    for table in (Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS):
        assert profile.area(table, address) is None


def test_wago_bits_and_registers_beyond_the_first_part_go_on_counting() -> None:
    profile = load_profile("wago-750")
    assert write_reference(profile, Table.DISCRETE_INPUTS, 0x3000) == "DI512"
    assert write_reference(profile, Table.COILS, 0x45F7) == "DO2039"
    assert write_reference(profile, Table.INPUT_REGISTERS, 0x6000) == "%IW512"
    assert write_reference(profile, Table.HOLDING_REGISTERS, 0x72FC) == "%QW1276"


def test_wago_constants_hold_what_a_master_tests_with() -> None:
    defaults = _defaults(load_profile("wago-750"))
    assert [defaults[address] for address in range(0x2000, 0x2009)] == [
        0x0000, 0xFFFF, 0x1234, 0xAAAA, 0x5555, 0x7FFF, 0x8000, 0x3FFF, 0x4000,
    ]  # fmt: skip


def test_wago_registers_are_read_or_written_as_its_list_says() -> None:
    profile = load_profile("wago-750")
    table = Table.HOLDING_REGISTERS
    for access, addresses in {
        "r": [0x1004, 0x1006, 0x1020, 0x1025, 0x1031, 0x2000, 0x2012, 0x2020, 0x2033],
        "rw": [0x1000, 0x1003, 0x1005, 0x1007, 0x100A, 0x1028, 0x1029, 0x1030],
        "w": [0x100B],
    }.items():
        for address in addresses:
            span = range(address, address + 1)
            assert profile.allows(table, span) == ("r" in access), hex(address)
            assert profile.allows(table, span, writing=True) == ("w" in access), hex(address)
    for address in range(0x2040, 0x2044):  # Commands, in the numbers of the list of modules.
        assert profile.allows(table, range(address, address + 1), writing=True)


def test_wago_functions_and_exceptions_are_those_of_both_generations() -> None:
    profile = load_profile("wago-750")
    assert " ".join(profile.functions) == "01 02 03 04 05 06 07 0B 0F 10 16 17"
    limits = _limits(profile)
    assert [limits[code] for code in ("01", "03", "0F", "10", "17")] == [2000, 125, 256, 100, 125]
    assert profile.exceptions.documented == [1, 2, 3, 4, 5, 6, 8, 0x0A, 0x0B]
    assert profile.exception_name(4) == "slave device failure"


def test_documentation_names_every_profile_and_key() -> None:
    text = DOCUMENTATION.read_text(encoding="utf-8")
    for name in builtin_profiles():
        assert f"| `{name}` |" in text
    for part in (Profile, Area, FunctionRule, AnswerWord, Exceptions, Point):
        for key in part.__struct_fields__:
            assert f"`{key}`" in text


def test_example_of_the_documentation_is_a_profile(tmp_path: Path) -> None:
    text = DOCUMENTATION.read_text(encoding="utf-8")
    example = text.partition("## A profile of your own")[2].partition('"pump.toml"\n')[2]
    (tmp_path / "pump.toml").write_text(example.partition("```")[0], encoding="utf-8")
    profile = load_profile(str(tmp_path / "pump.toml"))
    documented = [point.name for point in profile.points]
    assert documented[:4] == ["Speed", "Oil temperature", "State", "Alarms"]
    assert documented[4:] == ["CH{n} temperature", "Model"]
