"""Tables and addresses of the rows of a list."""

from __future__ import annotations

import pytest

from mbtool.devices.model import Access, Radix
from mbtool.modbus.tables import Table
from tests.devices.importing.listing import locate


def test_a_number_says_its_table_before_the_row_does() -> None:
    located, report = locate("address,name\n40011,a\n30012,b\n")
    assert [(one.area.table, one.area.first) for one in located] == [
        (Table.HOLDING_REGISTERS, 10),
        (Table.INPUT_REGISTERS, 11),
    ]
    assert not any("--table" in one for one in report.remarks)


def test_a_row_may_say_it() -> None:
    located, _ = locate("address,name,function\n11,a,4\n12,b,coil\n")
    assert [(one.area.table, one.area.first) for one in located] == [
        (Table.INPUT_REGISTERS, 11),
        (Table.COILS, 12),
    ]


def test_a_guess_is_said() -> None:
    _, report = locate("address,name\n11,a\n")
    assert "row 2: no table named, taken as holding_registers (--table says otherwise)" in (
        report.remarks
    )


@pytest.mark.parametrize(
    ("function", "access"),
    [("3", Access.READ), ("3/6", Access.READ_WRITE), ("6", Access.WRITE), ("4", Access.READ)],
)
def test_functions_tell_what_a_row_may_be_used_for(function: str, access: Access) -> None:
    located, _ = locate(f"address,name,function\n11,a,{function}\n")
    assert located[0].area.access is access


def test_what_nobody_calls_read_only_is_both_and_that_is_said() -> None:
    located, report = locate("address,name\n11,a\n")
    assert located[0].area.access is Access.READ_WRITE
    assert "row 2: no access named, taken as read and write" in report.remarks


def test_an_address_beyond_the_wires_is_a_complaint() -> None:
    located, report = locate("address,name\n0,a\n70000,b\n")
    assert [one.area.first for one in located] == [0]
    assert report.problem_lines == [
        "row 3, column \"address\": '70000' would be address 70000 on the wire; "
        "addresses are 0 to 65535"
    ]


def test_a_notation_has_the_width_that_all_of_it_has() -> None:
    located, _ = locate("address,name\n0x0102,a\n0x0103,b\n")
    assert located[0].area.notation == ("0x", 0, Radix.HEX, 4, "")
    located, _ = locate("address,name\nD7,a\nD100,b\n")
    assert located[0].area.notation == ("D", 0, Radix.DECIMAL, 0, "")
