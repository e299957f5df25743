"""Register lists of the kinds that vendors hand out, made up here, and what becomes of them."""

from __future__ import annotations

import csv
import io
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbtool.core.errors import ProfileError, UsageError
from mbtool.devices.importing.columns import Meaning
from mbtool.devices.importing.options import MAX_PROBLEMS, AddressStyle, ImportOptions, Scaling
from mbtool.devices.importing.register_list import (
    MAX_BYTES,
    MAX_ROWS,
    BadRowsError,
    ImportedList,
    import_register_list,
)
from mbtool.devices.loading import load_profile
from mbtool.devices.model import Access, Point, Radix
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.tables import Table

EUROPEAN = """\
Pump 7, register list;;;;;;
;;;;;;
Register;Bezeichnung;Datentyp;Einheit;Faktor;Zugriff;Beschreibung
40001;Drehzahl;UINT16;1/min;0,1;R;
40002;Zustand;INT;;;R/W;wird beim Start geprüft
40003;Durchfluss;REAL (swapped);m³/h;;R;
;Alarme;;;;;
40010.0;Motor 1 zu heiß;BOOL;;;R;
40010.3;Motor 1 zu kalt;BOOL;;;R;
40100;Seriennummer;STRING[16];;;R;
"""

INVERTER = """\
No.,Signal name,Read/write type,Type,Unit,Gain,Address,Quantity,Range
1,Model,RO,STR,,1,30000,15,
2,Input power,RO,I32,kW,1000,32064,2,
3,Phase A voltage,RO,U16,V,10,32069,1,
4,Active power limit,RW,U16,%,10,40125,1,"[0, 100]"
5,Time zone,RW,I16,min,1,43006,1,"-720 to 840"
"""

METER = """\
Address,Register,Action (R/W/WC),Size,Type,Units,Range,Description
0BB7,3000,R,2,FLOAT32,A,,Current A
0BB9,3002,R,2,FLOAT32,A,,Current B
0C83,3204,R/W,1,INT16U,,0 to 100,Setting
"""

TELEMETRY = """\
Name\tTable\tOffset\tData type\tWord order
Level\tInput register\t0\tfloat32\tCDAB
Pump on\tCoil\t0\tbool\t
Door\tDiscrete input\t3\tbool\t
Set point\tHolding register\t10\tuint32\tbig-endian word swap
"""


NAMED: dict[str, dict[str, Any]] = {
    METER: {"columns": {Meaning.ADDRESS: "Address"}},
    TELEMETRY: {"columns": {Meaning.ADDRESS: "Offset"}},
}
"""What the user has to say of a list."""


def imported(text: str, file: str = "map.csv", **options: Any) -> ImportedList:
    return import_register_list(text.encode(), file, ImportOptions(**options))


def points(text: str, **options: Any) -> dict[str, Point]:
    return {point.name: point for point in imported(text, **options).profile.points}


def problems(text: str, **options: Any) -> list[str]:
    with pytest.raises(BadRowsError) as caught:
        imported(text, **options)
    return caught.value.lines


def test_a_european_list_with_semicolons_commas_and_bits() -> None:
    profile = imported(EUROPEAN, "Pumpe 7.csv").profile
    assert profile.name == "pumpe-7"
    assert {area.name: (area.first, area.last, area.access) for area in profile.areas} == {
        "holding registers 40001..40010": (0, 9, Access.READ_WRITE),
        "holding registers 40100..40107": (99, 106, Access.READ),
    }
    found = {point.name: point for point in profile.points}
    assert found["Drehzahl"].scale == 0.1
    assert found["Drehzahl"].access is Access.READ
    assert found["Drehzahl"].unit == "1/min"
    assert found["Zustand"].note == "wird beim Start geprüft"
    assert found["Durchfluss"].type is PointType.FLOAT32
    assert found["Durchfluss"].word_order is WordOrder.LOW_FIRST
    assert found["40010"].bits == {0: "Motor 1 zu heiß", 3: "Motor 1 zu kalt"}
    assert found["Seriennummer"].length == 8
    assert list(profile.functions) == ["03", "06", "10"]


def test_a_list_of_an_inverter_with_gains_that_divide() -> None:
    found = points(INVERTER)
    assert found["Model"].length == 15
    assert found["Input power"].type is PointType.INT32
    assert found["Input power"].scale == 0.001
    assert found["Input power"].address == 32064
    assert found["Phase A voltage"].scale == 0.1
    assert found["Active power limit"].note == "range: [0, 100]"
    assert (found["Time zone"].minimum, found["Time zone"].maximum) == (-720, 840)


def test_numbers_that_cannot_be_references_are_addresses_and_that_is_told() -> None:
    assert (
        "addresses are zero-based, as nothing says otherwise: 30000 is address 30000 on the wire "
        "(--addresses says otherwise)"
    ) in imported(INVERTER).remarks


def test_a_gain_can_be_said_to_multiply() -> None:
    assert points(INVERTER, scaling=Scaling.MULTIPLY)["Phase A voltage"].scale == 10


def test_of_two_columns_of_addresses_the_user_says_which_counts() -> None:
    with pytest.raises(UsageError, match="'Address' and 'Register' may be columns of addresses"):
        imported(METER)
    by_wire = imported(METER, columns={Meaning.ADDRESS: "Address"})
    by_number = imported(
        METER, columns={Meaning.ADDRESS: "Register"}, addresses=AddressStyle.ONE_BASED
    )
    assert [one.address for one in by_wire.profile.points] == [0x0BB7, 0x0BB9, 0x0C83]
    assert [one.address for one in by_number.profile.points] == [0x0BB7, 0x0BB9, 0x0C83]
    assert by_number.profile.areas[0].reference(0x0BB7) == "3000"


def test_a_list_with_all_four_tables() -> None:
    profile = imported(TELEMETRY, **NAMED[TELEMETRY]).profile
    assert [(point.name, point.table, point.address) for point in profile.points] == [
        ("Pump on", Table.COILS, 0),
        ("Door", Table.DISCRETE_INPUTS, 3),
        ("Set point", Table.HOLDING_REGISTERS, 10),
        ("Level", Table.INPUT_REGISTERS, 0),
    ]
    assert list(profile.functions) == ["01", "02", "03", "04", "05", "06", "0F", "10"]
    assert {point.word_order for point in profile.points if point.type.words == 2} == {
        WordOrder.LOW_FIRST
    }


def test_a_heading_between_the_rows_names_the_table() -> None:
    found = points("address,name\nInput registers,\n0,Level\nHolding registers,\n0,Set point\n")
    assert found["Level"].table is Table.INPUT_REGISTERS
    assert found["Set point"].table is Table.HOLDING_REGISTERS


def test_a_type_column_that_names_tables_is_told_and_can_be_said() -> None:
    text = "address,name,type\n0,Level,Input Register\n1,Valve,Coil\n"
    assert problems(text) == [
        "map.csv: row 2, column \"type\": 'Input Register' is a table, not a type; "
        "--column table=HEADING says that the column has tables"
    ]
    found = points(text, columns={Meaning.TABLE: "type"})
    assert found["Level"].table is Table.INPUT_REGISTERS
    assert found["Valve"].type is PointType.BIT


@pytest.mark.parametrize(
    ("style", "address"),
    [
        (AddressStyle.ZERO_BASED, 40001),
        (AddressStyle.ONE_BASED, 40000),
        (AddressStyle.REFERENCES, 0),
    ],
)
def test_what_numbers_are_can_be_said(style: AddressStyle, address: int) -> None:
    assert points("register,name\n40001,a\n", addresses=style)["a"].address == address


def test_the_table_of_rows_that_name_none_can_be_said() -> None:
    found = imported("address,name\n5,a\n", table=Table.INPUT_REGISTERS)
    assert found.profile.points[0].table is Table.INPUT_REGISTERS
    assert not any("--table" in one for one in found.remarks)


def test_a_yes_or_no_without_a_table_is_a_coil_and_one_that_is_read_an_input() -> None:
    found = points("address,name,type,access\n5,a,BOOL,RW\n6,b,BOOL,R\n")
    assert found["a"].table is Table.COILS
    assert found["b"].table is Table.DISCRETE_INPUTS


def test_a_yes_or_no_in_a_register_is_off_or_on() -> None:
    point = points("register,name,type\n40001,a,BOOL\n")["a"]
    assert (point.type, point.texts) == (PointType.UINT16, {0: "off", 1: "on"})


def test_hexadecimal_addresses_keep_their_notation() -> None:
    area = imported("address,name\n0x0102,a\n0x010F,b\n").profile.areas[0]
    assert (area.radix, area.reference(0x102)) == (Radix.HEX, "0x0102")


def test_numbers_behind_letters_keep_them() -> None:
    profile = imported("address,name\nD100,a\nD101,b\n").profile
    assert profile.areas[0].span(100, 101) == "D100..101"


def test_4x_stands_for_the_table_and_counts_from_1() -> None:
    profile = imported("address,name\n4x0001,a\n0x0001,b\n").profile
    assert [(one.table, one.address) for one in profile.points] == [
        (Table.COILS, 0),
        (Table.HOLDING_REGISTERS, 0),
    ]
    assert profile.areas[1].reference(0) == "4x0001"


def test_values_become_texts_and_prose_a_note() -> None:
    found = points('register,name,values\n1,a,"0=off, 1=on"\n2,b,see chapter 3\n')
    assert found["a"].texts == {0: "off", 1: "on"}
    assert found["b"].note == "see chapter 3"


def test_a_row_of_several_values_is_a_series() -> None:
    point = imported("address,name,type,count\n10,Phase,UINT32,6\n").profile.points[0]
    assert (point.name, point.count, point.stride) == ("Phase {n}", 3, 2)


@pytest.mark.parametrize(
    ("meaning", "sizes"), [(Meaning.LENGTH_IN_BITS, (16, 32)), (Meaning.LENGTH_IN_BYTES, (2, 4))]
)
def test_lengths_count_registers_unless_the_user_says_otherwise(
    meaning: Meaning, sizes: tuple[int, int]
) -> None:
    text = "address,name,type,size\n0,a,UINT16,{}\n1,b,UINT32,{}\n".format(*sizes)
    assert problems(text) == [
        f"map.csv: row 3: '1' overlaps row 2, \"a\", which takes {sizes[0]} registers"
    ]
    found = points(text, columns={meaning: "size"})
    assert [point.type for point in found.values()] == ["uint16", "uint32"]


def test_both_orders_of_a_value_are_kept() -> None:
    point = points("address,name,type,byte order\n0,a,FLOAT32,DCBA\n")["a"]
    assert (point.word_order, point.byte_order) == (WordOrder.LOW_FIRST, ByteOrder.LOW_FIRST)


def test_names_that_repeat_get_their_reference() -> None:
    assert list(points("register,name\n40001,a\n40002,a\n40003,\n")) == ["a", "a (40002)", "40003"]


def test_a_factor_may_stand_before_the_unit() -> None:
    point = points("address,name,unit\n0,a,0.1 V\n")["a"]
    assert (point.scale, point.unit) == (0.1, "V")


def test_limits_of_a_scaled_value_are_a_note_since_lists_do_not_say_of_what() -> None:
    found = points("address,name,scale,min,max,default\n0,a,1,0,10,5\n1,b,0.1,0,10,5\n")
    assert (found["a"].minimum, found["a"].maximum, found["a"].default) == (0, 10, 5)
    assert found["b"].minimum is None
    assert found["b"].note == (
        "minimum in the list: 0; maximum in the list: 10; default in the list: 5"
    )


def test_a_value_only_for_writing_is_that() -> None:
    profile = imported("address,name,access\n0,a,RW\n1,Reset,W\n").profile
    assert [point.access for point in profile.points] == [None, Access.WRITE]


def test_functions_of_a_list_are_those_of_the_profile() -> None:
    profile = imported("address,name,function\n0,a,03/06\n1,b,03\n").profile
    assert list(profile.functions) == ["03", "06"]
    assert [point.access for point in profile.points] == [None, Access.READ]


def test_every_wrong_row_is_told_with_its_columns() -> None:
    text = (
        "register,name,type,scale,access,word order,function\n"
        "40001,a,FLOTE,0.1,R,ABCD,3\n"
        "x!,b,INT16,nil0,RX,XYZW,77\n"
        "40002,c,INT16,0,R,ABCD,3\n"
        "40003,d,INT16,1,RX,XYZW,77\n"
        "40005,d,FLOTE,1,R,ABCD,3\n"
    )
    assert problems(text) == [
        "map.csv: rows 2, 6, column \"type\": 'FLOTE' is no type, as UINT16, INT32, FLOAT32, BCD, "
        "BOOL or STRING[16] are",
        "map.csv: row 3, column \"register\": 'x!' is no address, as 40001, 4x0001, 12, 0x0102, "
        "0102H and HR12 are",
        "map.csv: row 4, column \"scale\": '0' is no factor, as 0.1, /10 or x0.1 are",
        "map.csv: row 5, column \"function\": '77' names no table, as holding register, 4x, HR, "
        "03, FC04 or coil do",
        "map.csv: row 5, column \"word order\": 'XYZW' is no order, as ABCD, CDAB, low word first "
        "or big-endian word swap are",
        "map.csv: row 5, column \"access\": 'RX' is no access, as R, W or RW are",
    ]


def test_what_cannot_be_together_is_told_too() -> None:
    text = (
        "register,name,type,access,function\n"
        "40001,a,FLOAT32,R,3\n"
        "40002,b,INT16,R,3\n"
        "30001,c,INT16,RW,4\n"
        "40010.17,d,BOOL,R,3\n"
        "40011,e,UINT32,R,\n"
        "40012,f,UINT32,R,\n"
    )
    assert problems(text) == [
        "map.csv: row 3: '40002' overlaps row 2, \"a\", which takes 2 registers",
        "map.csv: row 4, column \"register\": '30001' is in input_registers, which cannot be "
        "written, but its row says rw",
        "map.csv: row 5: '40010.17' names no bit from 0 to 15",
        "map.csv: row 7: '40012' overlaps row 6, \"e\", which takes 2 registers",
    ]


def test_no_register_has_a_bit_below_0() -> None:
    assert problems("address,bit\n0,-1\n")[0].endswith("names no bit from 0 to 15")


def test_number_and_row_must_agree_on_the_table() -> None:
    assert problems("address,name,table\n4x0001,a,coil\n") == [
        "map.csv: row 2, column \"address\": '4x0001' is in holding_registers by its number, "
        "but in coils by its row"
    ]


def test_a_delimiter_within_a_cell_is_a_problem_and_not_a_shift() -> None:
    assert problems("address,name,scale,unit\n0,a,0,1,V\n1,b,1,A\n") == [
        "map.csv: row 2: 'V' stands behind the last heading; "
        "a delimiter within a cell needs quotes around it"
    ]


def test_a_column_without_a_heading_is_told() -> None:
    said = imported("address,name,,\n0,a,7,\n1,b,,\n").remarks
    assert "columns without a heading, so not used: number 3" in said


def test_problems_are_bounded_and_every_row_is_named() -> None:
    rows = "".join(f"{at},n{at},FLOTE{at}\n" for at in range(150))
    with pytest.raises(BadRowsError, match="150 rows are wrong, so no profile was made") as caught:
        imported(f"address,name,type\n{rows}")
    assert len(caught.value.lines) == MAX_PROBLEMS + 1
    assert caught.value.lines[-1] == "map.csv: rows 102-151: other problems like these"


def test_rows_that_are_wrong_can_be_left_out_and_are_told() -> None:
    text = "register,name,type\n40001,a,UINT16\n40002,b,DATETIME\n40001,c,UINT16\n"
    found = imported(text, skip_bad=True)
    assert [point.name for point in found.profile.points] == ["a"]
    assert [one for one in found.remarks if one.startswith("left out")] == [
        "left out: row 3, column \"type\": 'DATETIME' is no type, as UINT16, INT32, FLOAT32, BCD, "
        "BOOL or STRING[16] are",
        "left out: row 4: '40001' overlaps row 2, \"a\"",
    ]


def test_a_list_of_wrong_rows_makes_no_profile() -> None:
    with pytest.raises(UsageError, match="no row below its headings"):
        imported("register,name,type\n40002,b,DATETIME\n", skip_bad=True)


def test_rows_that_are_reserved_are_left_out_and_that_is_said() -> None:
    found = imported("address,name\n1,a\n2,Reserved\n3,(spare)\n")
    assert [point.name for point in found.profile.points] == ["a"]
    assert "rows 3-4: reserved or unused, left out" in found.remarks


def test_a_factor_that_another_register_holds_is_a_note() -> None:
    found = points("address,name,type,scale factor\n0,A,uint16,A_SF\n1,A_SF,sunssf,\n")
    assert found["A"].note == "scaled by the power of ten in A_SF"
    assert found["A"].scale == 1


def test_what_is_left_out_is_said() -> None:
    text = "Pump 7,,\naddress,name,colour\n1,a,red\n,see page 4,\naddress,name,colour\n2,b,blue\n"
    said = imported(text).remarks
    assert "row 2 is taken for the headings, and the rows above it are left out" in said
    assert "row 4: no address, left out" in said
    assert "row 5: the headings again, left out" in said
    assert 'columns that are not used: "colour"' in said


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is empty"),
        (b"a,b\n1,2\n", "no row of headings"),
        (b"address,name\n", 'no row below its headings has an address in "address"'),
        (b"PK\x03\x04 and so on", "a spreadsheet; export it as CSV"),
        (b'address,name\n1,"open\n', "quote"),
        (b"address,name\n" + b"x" * MAX_BYTES, f"more than {MAX_BYTES} bytes"),
        (b"address,name\n" + b"1,a\n" * MAX_ROWS, f"more than {MAX_ROWS} rows"),
    ],
)
def test_what_is_no_list_is_said_in_a_line(data: bytes, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        import_register_list(data, "map.csv")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_the_encodings_of_spreadsheets_are_read(encoding: str) -> None:
    data = "address;name;unit\r\n1;Größe;°C\r\n".encode(encoding)
    found = import_register_list(data, "map.csv")
    assert found.profile.points[0].name == "Größe"
    assert found.profile.points[0].unit == "°C"
    assert any("Latin-1" in one for one in found.remarks) is (encoding == "cp1252")


@pytest.mark.parametrize("text", [EUROPEAN, INVERTER, METER, TELEMETRY])
def test_the_text_loads_as_the_profile(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    found = imported(text, **NAMED.get(text, {}))
    path = tmp_path_factory.mktemp("lists") / "map.toml"
    path.write_text(found.text, encoding="utf-8")
    assert load_profile(str(path)) == found.profile
    for remark in found.remarks:
        assert remark.split()[0] in found.text


@given(st.binary(max_size=400) | st.text(max_size=400).map(str.encode))
def test_no_bytes_make_it_fail_otherwise_than_in_words(data: bytes) -> None:
    with suppress(UsageError):
        assert import_register_list(data, "map.csv").profile.points


HEADINGS = st.sampled_from(
    [*map(str, Meaning), "register", "reference", "size", "count", "function", "swap", "colour"]
)
CELLS = st.sampled_from(
    [
        *("", "a", "a b", "{n}", "{reference}", '"', "-", "\\", "ä", "#", "=", "1\n2", "yes", "no"),
        *(
            "0",
            "1",
            "2",
            "3",
            "4",
            "10",
            "16",
            "32",
            "126",
            "127",
            "-1",
            "1.5",
            "0,1",
            "1e400",
            "nan",
        ),
        *("40001", "40002", "40003", "300001", "30001", "00001", "65535", "65536", "9999999999"),
        *("4x0001", "0x0001", "0x10", "0BB7", "10H", "HR1", "D5", "40001.0", "40001.3", "40001.17"),
        *("40001-40004", "1-9", "UINT16", "INT32", "FLOAT32", "float64", "BOOL", "BCD", "STRING"),
        *("STRING[16]", "hex", "bitfield", "CDAB", "DCBA", "R", "RW", "W", "coil", "holding", "03"),
        *(
            "input",
            "discrete",
            "04",
            "06",
            "03/06",
            "/10",
            "x0.1",
            "1e-3",
            "0=off,1=on",
            "0 to 100",
        ),
        *("0=a;70000=b", "0: off 1: on", "Bit0: a, Bit1: b", "Bit 17 = c", "FC 04", "FC 03/04"),
        *("Spulen", "UINT32 (low word first)", "DATETIME", "Bit 3", "1,000"),
    ]
)


@st.composite
def lists(draw: st.DrawFn) -> str:
    headings = ["address", *draw(st.lists(HEADINGS, min_size=1, max_size=7))]
    first = st.sampled_from(
        ["0", "1", "2", "5", "40001", "40002", "0x10", "4x0001", "D7", "40003.4"]
    )
    rows = draw(
        st.lists(st.tuples(first | CELLS, *(CELLS for _ in headings[1:])), min_size=1, max_size=6)
    )
    out = io.StringIO()
    csv.writer(out, delimiter=draw(st.sampled_from(",;\t"))).writerows([headings, *rows])
    return out.getvalue()


@settings(max_examples=300, deadline=None)
@given(lists(), st.booleans())
def test_any_list_becomes_a_profile_or_problems(text: str, skip_bad: bool) -> None:
    try:
        found = imported(text, skip_bad=skip_bad)
    except ProfileError as error:  # What a profile may not be is to be told as a row.
        raise AssertionError(str(error)) from error
    except UsageError:
        return
    assert found.profile.points


def test_what_becomes_of_a_text_without_a_length_is_said() -> None:
    text = "Address,Name,Type\n0,Model,STRING\n10,Serial,STRING[8]\n"
    assert points(text)["Model"].length == 1
    assert "row 2: a text without a length, taken as 1 register" in imported(text).remarks


def test_what_becomes_of_bits_in_several_registers_is_said() -> None:
    text = "Address,Name,Type\n0,State,bitfield16\n2,Faults,bitfield32\n4,More,BITMAP64\n"
    assert points(text)["Faults"].type is PointType.UINT32
    assert ("rows 3-4: bits in several registers cannot have names, so a whole number") in imported(
        text
    ).remarks


def test_what_becomes_of_the_range_of_a_scaled_value_is_said() -> None:
    text = (
        "Address,Name,Type,Scale,Min,Max,Default\n"
        "0,Flow,U16,0.1,0,100,\n1,Count,U16,1,0,100,5\n2,Level,U16,0.1,,,7\n3,T,U16,0.1,,,\n"
    )
    assert points(text)["Flow"].note == "minimum in the list: 0; maximum in the list: 100"
    assert points(text)["Count"].maximum == 100
    assert (
        "rows 2, 4: range or default kept as a note: it may be before or after scaling"
    ) in imported(text).remarks


def test_values_with_their_meaning_in_a_column_of_ranges_are_texts() -> None:
    text = (
        "Adresse;Bezeichnung;Typ;Wertebereich\n"
        "0;Betrieb;UINT16;0=Aus, 1=Heizen\n1;Druck;UINT16;0..100\n2;Art;UINT16;nach Modell\n"
    )
    found = points(text)
    assert (found["Betrieb"].texts, found["Betrieb"].note) == ({0: "Aus", 1: "Heizen"}, None)
    assert found["Druck"].maximum == 100
    assert found["Art"].note == "range: nach Modell"
    assert "row 4: range or values in words, kept as a note" in imported(text).remarks


def test_meanings_in_both_columns_are_both_kept() -> None:
    text = 'Address,Name,Type,Range,Values\n0,Mode,U16,"0=off, 1=on","0=Aus, 1=Ein"\n'
    mode = points(text)["Mode"]
    assert (mode.texts, mode.note) == ({0: "Aus", 1: "Ein"}, "range: 0=off, 1=on")


def test_what_the_user_says_of_addresses_is_no_guess() -> None:
    said = imported("Address,Name\n5,a\n", addresses=AddressStyle.ONE_BASED).remarks
    assert not any("on the wire" in one for one in said)


def test_control_characters_of_a_list_come_to_nothing() -> None:
    found = imported("Address,Name,Unit\n0,\x1b[31mFlow\x07,l\x1b/h\n")
    (point,) = found.profile.points
    assert (point.name, point.unit) == ("[31mFlow", "l/h")
