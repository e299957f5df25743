"""Rows of register lists."""

from __future__ import annotations

import pytest

from mbtool.devices.importing.rows import MAX_COMPLAINTS, MAX_NAME, Complaints, Scaling
from mbtool.devices.model import Access
from tests.devices.importing.listing import read_items


def scales(heading: str, *cells: str, scaling: Scaling | None = None) -> list[float]:
    rows = "".join(f"{at};a;{cell}\n" for at, cell in enumerate(cells))
    items, complaints, _ = read_items(f"address;name;{heading}\n{rows}", scaling)
    assert complaints.lines == []
    return [item.scale for item in items]


def test_factors_multiply_where_one_is_less_than_1() -> None:
    assert scales("scale", "0.1", "10", "1") == [0.1, 10, 1]


def test_factors_divide_where_none_is_less_than_1() -> None:
    assert scales("scale", "10", "100", "1") == [0.1, 0.01, 1]
    assert scales("gain", "10", "1") == [0.1, 1]


def test_a_heading_may_say_what_factors_are_for() -> None:
    assert scales("multiplier", "10", "100") == [10, 100]
    assert scales("divisor", "10", "0,5") == [0.1, 2]


def test_a_factor_that_says_itself_what_it_is_for_counts() -> None:
    assert scales("gain", "/10", "x10", "100") == [0.1, 10, 0.01]


def test_the_user_has_the_last_word() -> None:
    assert scales("gain", "10", scaling=Scaling.MULTIPLY) == [10]


def test_decimals_without_a_factor_make_one() -> None:
    items, _, _ = read_items("address,name,type,decimals\n0,a,INT16,2\n1,b,FLOAT32,2\n")
    assert [(item.scale, item.decimals) for item in items] == [(0.01, 2), (1.0, 2)]


@pytest.mark.parametrize(
    ("heading", "size", "registers"),
    [("size", 2, 2), ("length (bytes)", 4, 2), ("number of registers", 1, 1)],
)
def test_a_size_is_in_registers_unless_its_heading_says_otherwise(
    heading: str, size: int, registers: int
) -> None:
    items, _, _ = read_items(f"address,name,{heading}\n0,a,{size}\n")
    assert items[0].registers == registers


def test_little_in_a_column_of_word_orders_says_nothing_of_bytes() -> None:
    items, _, _ = read_items("address,name,word order\n0,a,little endian\n")
    assert items[0].order == ("low-first", "high-first")


def test_a_column_that_asks_whether_it_can_be_written_is_answered_with_yes_or_no() -> None:
    items, _, _ = read_items("address,name,writable\n0,a,yes\n1,b,no\n2,c,\n")
    assert [item.access for item in items] == [Access.READ_WRITE, Access.READ, None]


def test_a_name_is_one_line_without_braces_and_not_endless() -> None:
    items, _, _ = read_items(f'address,name\n0,"a\n {{n}}  b"\n1,{"x" * 300}\n')
    assert items[0].name == "a (n) b"
    assert len(items[1].name) == MAX_NAME


def test_a_description_is_the_name_where_there_is_no_other() -> None:
    items, _, _ = read_items("address,name,description\n0,,Flow\n1,Level,of the tank\n")
    assert [(item.name, item.note) for item in items] == [("Flow", None), ("Level", "of the tank")]


def test_complaints_come_in_the_order_of_their_rows() -> None:
    complaints = Complaints("map.csv")
    for row in range(MAX_COMPLAINTS + 5, 0, -1):
        complaints.add(row, None, "x" * 100, "is wrong")
    assert complaints.count == MAX_COMPLAINTS + 5
    assert len(complaints.lines) == MAX_COMPLAINTS
    assert complaints.lines[0] == f"map.csv: row 6: '{'x' * 40}...' is wrong"
