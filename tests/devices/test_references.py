from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import UsageError
from mbtool.devices import builtin_profiles, load_profile, parse_reference, write_reference
from mbtool.modbus.tables import Table


@pytest.mark.parametrize(
    ("table", "address", "quantity", "reference"),
    [
        (Table.HOLDING_REGISTERS, 107, 3, "holding 107..109"),
        (Table.COILS, 0, 1, "coil 0"),
        (Table.INPUT_REGISTERS, 3, 1, "input 3"),
        (Table.DISCRETE_INPUTS, 5, 1, "discrete 5"),
        (Table.COILS, 0xFFFF, 2, "coil 65535..65536"),
        (Table.COILS, 7, 0, "coil 7"),
        (Table.COILS, 7, None, "coil 7"),
    ],
)
def test_without_a_profile_the_wire_address_is_written(
    table: Table, address: int, quantity: int | None, reference: str
) -> None:
    assert write_reference(None, table, address, quantity) == reference


@pytest.mark.parametrize(
    ("device", "table", "address", "quantity", "reference"),
    [
        ("idec-ft1a-touch", Table.HOLDING_REGISTERS, 0, 2, "HR400001..400002"),
        ("idec-ft1a-touch", Table.COILS, 0, 11, "C1..11"),
        ("fa3-th1m16xc", Table.DISCRETE_INPUTS, 0, 16, "X0..XF"),
        ("fa3-at1m8x", Table.HOLDING_REGISTERS, 0x102, 1, "0102H"),
        ("fa3-at1m8x", Table.HOLDING_REGISTERS, 0x105, 10, "0105H..010EH"),
        ("fa3-at1m8x", Table.HOLDING_REGISTERS, 2, 8, "RWw2..RWw9"),
        ("fa3-at1m8x", Table.INPUT_REGISTERS, 0x1F, 1, "RWr1F"),
    ],
)
def test_range_is_written_as_the_manual_does(
    device: str, table: Table, address: int, quantity: int, reference: str
) -> None:
    assert write_reference(load_profile(device), table, address, quantity) == reference


def test_outside_its_area_the_only_notation_of_a_table_stays() -> None:
    profile = load_profile("idec-ft1a-touch")
    assert write_reference(profile, Table.HOLDING_REGISTERS, 4095, 2) == "HR404096..404097"


def test_outside_the_areas_of_two_notations_the_wire_address_is_written() -> None:
    profile = load_profile("fa3-at1m8x")
    assert write_reference(profile, Table.HOLDING_REGISTERS, 0x10) == "holding 16"
    assert write_reference(profile, Table.HOLDING_REGISTERS, 0x0F, 0x20) == "holding 15..46"


@pytest.mark.parametrize(
    ("device", "text", "table", "address"),
    [
        ("idec-ft1a-touch", "hr400017", Table.HOLDING_REGISTERS, 16),
        ("idec-ft1a-touch", " IR300001 ", Table.INPUT_REGISTERS, 0),
        ("fa3-at1m8x", "0102h", Table.HOLDING_REGISTERS, 0x102),
        ("fa3-at1m8x", "102H", Table.HOLDING_REGISTERS, 0x102),
        ("fa3-at1m8x", "rwrA", Table.INPUT_REGISTERS, 10),
        ("fa3-at1m8x", "x1f", Table.DISCRETE_INPUTS, 0x1F),
    ],
)
def test_reads_a_reference_in_any_case(device: str, text: str, table: Table, address: int) -> None:
    assert parse_reference(load_profile(device), text) == (table, address)


@pytest.mark.parametrize(
    "text",
    ["", "HR", "HR0", "HR400000", "HR404097", "400001", "HR4000x1", "HR٤00001", "C" + "0" * 5000],
)
def test_reference_that_is_not_there_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(UsageError, match=r"C1\.\.4096, .*, HR400001\.\.404096; .* example C1"):
        parse_reference(load_profile("idec-ft1a-touch"), text)


@given(st.sampled_from(builtin_profiles()), st.sampled_from(list(Table)), st.integers(0, 0xFFFF))
def test_what_is_written_is_read_back(device: str, table: Table, address: int) -> None:
    profile = load_profile(device)
    if profile.area(table, address) is not None:
        reference = write_reference(profile, table, address)
        assert parse_reference(profile, reference) == (table, address)
