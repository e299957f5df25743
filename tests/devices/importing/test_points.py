"""Areas and points from the rows of a list."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices.importing.areas import MAX_HOLE, make_areas
from mbtool.devices.importing.points import RowPoint, make_points
from mbtool.devices.model import Access
from mbtool.devices.point_types import PointType
from tests.devices.importing.listing import locate

if TYPE_CHECKING:
    from mbtool.devices.importing.options import ImportReport


def made(text: str) -> tuple[list[RowPoint], ImportReport]:
    located, report = locate(text)
    return make_points(located, None, report), report


def test_bits_of_a_register_are_one_point_called_as_the_row_of_the_whole() -> None:
    found, report = made("register,name\n40001,Status\n40001.0,on\n40001.15,fault\n")
    assert report.problem_lines == []
    (one,) = found
    assert (one.point.name, one.point.type) == ("Status", PointType.FLAGS)
    assert one.point.bits == {0: "on", 15: "fault"}


def test_a_bit_that_has_two_rows_is_a_problem() -> None:
    _, report = made("register,name\n40001.3,a\n40001.3,b\n")
    assert report.problem_lines == ["row 3: '40001.3' names a bit that another row names"]


def test_an_area_goes_on_over_a_small_hole_and_ends_at_a_large_one() -> None:
    last = MAX_HOLE - 1
    found, _ = made(f"address,name\n0,a\n{last},b\n{last + MAX_HOLE + 1},c\n")
    areas, _, _ = make_areas(found)
    assert [(area.first, area.last) for area in areas] == [
        (0, last),
        (last + MAX_HOLE + 1, last + MAX_HOLE + 1),
    ]


def test_a_point_says_its_rights_where_they_differ_from_its_areas() -> None:
    found, _ = made("address,name,access\n0,a,R\n1,b,RW\n100,c,R\n200,d,W\n")
    areas, points, functions = make_areas(found)
    assert [area.access for area in areas] == [Access.READ_WRITE, Access.READ, Access.WRITE]
    assert [point.access for point in points] == [Access.READ, None, None, None]
    assert list(functions) == ["03", "06", "10"]


def test_a_value_that_ends_beyond_the_last_address_is_a_problem() -> None:
    found, report = made("address,name,type\n65535,a,UINT32\n0,b,UINT16\n")
    assert [one.point.name for one in found] == ["b"]
    assert report.problem_lines == ["row 2: '65535' leaves no room for its 2 registers"]


def test_a_size_that_does_not_fit_the_type_is_a_problem() -> None:
    _, report = made("address,name,type,size\n0,a,FLOAT32,3\n4,b,UINT16,1\n")
    assert report.problem_lines == ["row 2: '0' has 3 registers, but its type takes 2"]


def test_a_register_type_in_a_table_of_bits_is_a_problem() -> None:
    _, report = made("address,name,type,table\n0,a,UINT16,coil\n")
    assert report.problem_lines == [
        "row 2: '0' is in coils, which hold bits, not uint16; BOOL would be right"
    ]


def test_a_factor_of_what_is_no_number_is_a_problem() -> None:
    _, report = made("address,name,type,scale\n0,a,STRING[4],0.1\n")
    assert report.problem_lines == ["row 2: '0' has a factor, but string is no number"]


def test_texts_that_the_type_cannot_have_are_a_note() -> None:
    found, _ = made('address,name,type,values\n0,a,FLOAT32,"0=off, 1=on"\n')
    assert found[0].point.note == "0 = off; 1 = on"
