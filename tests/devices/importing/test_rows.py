"""Rows of register lists."""

from __future__ import annotations

import pytest

from mbtool.devices.importing.options import MAX_PROBLEMS, ImportReport, Scaling
from mbtool.devices.importing.rows import MAX_NAME
from mbtool.devices.model import Access
from tests.devices.importing.listing import read_rows


def scales(heading: str, *cells: str, scaling: Scaling | None = None) -> list[float]:
    lines = "".join(f"{at};a;{cell}\n" for at, cell in enumerate(cells))
    rows, report = read_rows(f"address;name;{heading}\n{lines}", scaling)
    assert report.problem_lines == []
    return [row.scale for row in rows]


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
    rows, _ = read_rows("address,name,type,decimals\n0,a,INT16,2\n1,b,FLOAT32,2\n")
    assert [(row.scale, row.decimals) for row in rows] == [(0.01, 2), (1.0, 2)]


@pytest.mark.parametrize(
    ("heading", "size", "registers"),
    [("size", 2, 2), ("length (bytes)", 4, 2), ("number of registers", 1, 1)],
)
def test_a_size_is_in_registers_unless_its_heading_says_otherwise(
    heading: str, size: int, registers: int
) -> None:
    rows, _ = read_rows(f"address,name,{heading}\n0,a,{size}\n")
    assert rows[0].registers == registers


def test_little_in_a_column_of_word_orders_says_nothing_of_bytes() -> None:
    rows, _ = read_rows("address,name,word order\n0,a,little endian\n")
    assert rows[0].order == ("low-first", "high-first")


def test_a_column_that_asks_whether_it_can_be_written_is_answered_with_yes_or_no() -> None:
    rows, _ = read_rows("address,name,writable\n0,a,yes\n1,b,no\n2,c,\n")
    assert [row.access for row in rows] == [Access.READ_WRITE, Access.READ, None]


def test_a_name_is_one_line_without_braces_and_not_endless() -> None:
    rows, _ = read_rows(f'address,name\n0,"a\n {{n}}  b"\n1,{"x" * 300}\n')
    assert rows[0].name == "a (n) b"
    assert len(rows[1].name) == MAX_NAME


def test_a_description_is_the_name_where_there_is_no_other() -> None:
    rows, _ = read_rows("address,name,description\n0,,Flow\n1,Level,of the tank\n")
    assert [(row.name, row.note) for row in rows] == [("Flow", ""), ("Level", "of the tank")]


def test_problems_come_in_the_order_of_their_rows_and_name_every_row() -> None:
    report = ImportReport()
    for row in range(MAX_PROBLEMS + 5, 0, -1):
        report.add_problem(row, None, "x" * 100, f"is wrong {row}")
    lines = report.problem_lines
    assert lines[0] == f"row 1: '{'x' * 40}...' is wrong 1"
    assert (
        lines[MAX_PROBLEMS]
        == f"rows {MAX_PROBLEMS + 1}-{MAX_PROBLEMS + 5}: other problems like these"
    )
    assert len(report.bad_rows) == MAX_PROBLEMS + 5


def test_equal_problems_are_one_line_with_all_rows() -> None:
    report = ImportReport()
    for row in (2, 9, 4, 3):
        report.add_problem(row, "Type", "DATE", "is no type")
    assert report.problem_lines == ["rows 2-4, 9, column \"Type\": 'DATE' is no type"]
