from __future__ import annotations

import contextlib
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import UsageError
from mbtool.devices.loading import builtin_profiles, load_profile
from mbtool.devices.model import Access, Area, Profile, Radix
from mbtool.devices.references import parse_reference, write_reference
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


def test_outside_the_only_area_of_a_table_its_notation_continues() -> None:
    profile = load_profile("idec-ft1a-touch")
    assert write_reference(profile, Table.HOLDING_REGISTERS, 4095, 2) == "HR404096..404097"


def test_range_from_one_area_into_another_of_its_notation_keeps_it() -> None:
    profile = load_profile("wago-750")
    assert write_reference(profile, Table.HOLDING_REGISTERS, 0x1003, 4) == "0x1003..0x1006"


def test_range_from_one_notation_into_another_has_each_end_in_its_own() -> None:
    wago, fa3 = load_profile("wago-750"), load_profile("fa3-at1m8x")
    assert write_reference(wago, Table.HOLDING_REGISTERS, 0xFF, 0x102) == "%IW255..%QW0"
    assert write_reference(fa3, Table.HOLDING_REGISTERS, 0x0F, 0xF4) == "RWwF..0102H"


@pytest.mark.parametrize(
    ("device", "table", "address", "quantity", "reference"),
    [
        ("idec-ft1a-smartaxis", Table.COILS, 0x808, 1, "M1320"),  # 11-14: 1320 is 0808H.
        ("idec-ft1a-smartaxis", Table.COILS, 0x7E7, 2, "M1277..1280"),
        ("idec-ft1a-smartaxis", Table.HOLDING_REGISTERS, 2000, 3, "D2000..2002"),
        ("fa3-at1m8x", Table.HOLDING_REGISTERS, 0x10, 1, "RWw10"),
        ("fa3-at1m8x", Table.HOLDING_REGISTERS, 0x0F, 8, "RWwF..RWw16"),
        ("fa3-at1m8x", Table.HOLDING_REGISTERS, 0x5000, 2, "5000H..5001H"),
    ],
)
def test_outside_the_areas_the_notation_of_the_area_below_continues(
    device: str, table: Table, address: int, quantity: int, reference: str
) -> None:
    assert write_reference(load_profile(device), table, address, quantity) == reference


def test_below_all_areas_the_notation_of_the_one_above_begins_earlier() -> None:
    profile = _profile(_area("M", 1001, 2000), _area("Q", 3000, 4000))
    assert write_reference(profile, Table.COILS, 999, 2) == "M999..1000"


def test_a_reference_outside_the_areas_never_means_another_address() -> None:
    profile = _profile(
        _area("M", 0, 9), _area("M", 100, 109, base=-90), _area("Q", 200, 209, base=-200)
    )
    assert write_reference(profile, Table.COILS, 10) == "coil 10"  # M10 is at 100.
    assert write_reference(profile, Table.COILS, 30, 2) == "M30..31"
    assert write_reference(profile, Table.COILS, 9, 2) == "coil 9..10"
    # Its coils are 1 to 9999, and 10001 is a discrete input.
    assert write_reference(load_profile("chino-lt830"), Table.COILS, 10_000) == "coil 10000"


def test_the_access_chooses_between_two_areas_with_one_end() -> None:
    profile = load_profile("wago-750")
    assert write_reference(profile, Table.HOLDING_REGISTERS, 0x6300) == "%IW1280"
    assert write_reference(profile, Table.HOLDING_REGISTERS, 0x6300, writing=True) == "%QW1280"


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


def _profile(*areas: Area) -> Profile:
    return msgspec.structs.replace(load_profile("idec-ft1a-touch"), areas=list(areas))


def _area(prefix: str, first: int, last: int, base: int = 0, **fields: Any) -> Area:
    return Area(
        **{
            "name": prefix,
            "table": Table.COILS,
            "first": first,
            "last": last,
            "access": Access.READ_WRITE,
            "prefix": prefix,
            "base": base,
            **fields,
        }
    )


def test_area_that_begins_above_its_first_number_is_written_and_read() -> None:
    profile = _profile(
        _area("Q", 0, 99, radix=Radix.OCTAL_DIGIT),
        _area("M", 1001, 2000, -1001, radix=Radix.OCTAL_DIGIT),
    )
    assert write_reference(profile, Table.COILS, 1262) == "M325"
    assert write_reference(profile, Table.COILS, 1008, 2) == "M7..10"
    assert parse_reference(profile, "m325") == (Table.COILS, 1262)
    with pytest.raises(UsageError, match="write one of them, for example Q0"):
        parse_reference(profile, "M328")


def test_address_below_the_numbers_of_the_only_notation_is_written_as_on_the_wire() -> None:
    profile = _profile(_area("M", 1001, 2000, -1001))
    assert write_reference(profile, Table.COILS, 1000, 2) == "coil 1000..1001"
    assert write_reference(profile, Table.COILS, 2001) == "M1000"


def test_reads_and_writes_at_one_address_have_separate_notations() -> None:
    profile = _profile(
        _area("I", 0, 99, access=Access.READ), _area("Q", 0, 49, access=Access.WRITE)
    )
    assert write_reference(profile, Table.COILS, 7, 2) == "I7..8"
    assert write_reference(profile, Table.COILS, 7, 2, writing=True) == "Q7..8"
    assert write_reference(profile, Table.COILS, 60, writing=True) == "I60"
    assert parse_reference(profile, "Q7") == parse_reference(profile, "I7") == (Table.COILS, 7)


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
    reference = write_reference(profile, table, address)
    if profile.area(table, address) is None:
        with contextlib.suppress(UsageError):
            assert parse_reference(profile, reference)[0] is not table
    else:
        read = parse_reference(profile, reference)
        # A manual may write several tables alike (T5: contact, current and preset value); then the
        # profile's first is meant.
        assert read == (table, address) or read[0] is not table
        assert write_reference(profile, *read) == reference
