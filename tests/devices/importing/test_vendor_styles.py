"""Three styles of register lists of vendors: what becomes of each row, and what is told."""

from __future__ import annotations

from typing import Any

import pytest

from mbtool.core.errors import UsageError
from mbtool.devices.importing.columns import Meaning
from mbtool.devices.importing.options import ImportOptions
from mbtool.devices.importing.register_list import (
    BadRowsError,
    ImportedList,
    import_register_list,
)
from mbtool.devices.model import Access, Point
from mbtool.devices.point_types import PointType, WordOrder
from mbtool.modbus.tables import Table

WORD_SWAPPED = """\
Power meter, Modbus map,,,,,,
Register,Parameter,Data Type,Scale,Units,R/W,Values,Notes
Holding registers,,,,,,,
400001,Serial number,"UINT32 (big-endian, word swapped)",,,R,,
400003,Active power,INT32 (low word first),0.1,kW,R,,signed
400005,Clock,DATETIME,,,RW,,
400009,Pulse outputs,U16x2,,,RW,,
400011,Reset energy,UINT16,,,RC/WC,,write 1 to reset
400012,Mode,UINT16,,,RW,"0=Off, 1=Auto",
400013,Relay,UINT16,,,RW,0: off 1: on,
400014,Alarms,UINT16,,,R,"Bit0: Over voltage, Bit3: Phase loss",
400015,Energy,UINT64,,Wh,R,,
Input registers (FC 04),,,,,,,
300001,Voltage L1,FLOAT32 (word swapped),,V,R,,
300003,Model,STRING[16],,,R,,
"""

HEXADECIMAL = """\
Addr (hex),Description,Format,Size (bytes),Access,Resolution,Unit
0000,Voltage,u16,2,R,0.1,V
0001,Current,u32,4,R,0.001,A
0003,Power,s32,4,R,0.1,W
0010,Baud rate,u16,2,R/W,,
"""

GERMAN = """\
Wärmepumpe WP-12;;;;;;
Modbus-Adresse;Bezeichnung;Datentyp;Einheit;Faktor;Zugriff;Bemerkung
Eingangsregister (FC 04);;;;;;
0;Außentemperatur;INT16;°C;0,1;R;
1;Wärmemenge;UINT32;kWh;0,1;R;
3;Störungen;UINT16;;;R;Bit0: Hochdruck, Bit1: Niederdruck
Diskrete Eingänge (FC 02);;;;;;
0;Verdichter läuft;BOOL;;;R;
Halteregister (FC 03/06/16);;;;;;
10;Sollwert;INT16;°C;0,5;R/W;
11;Betriebsart;UINT16;;;R/W;0=Aus, 1=Auto
12;Zustand;UINT16;;;R;
;Bit 0 = Pumpe;;;;;
;Bit 3 = Alarm;;;;;
Spulen;;;;;;
5;Quittieren;BOOL;;;R/W;
"""


def imported(text: str, encoding: str = "utf-8", **options: Any) -> ImportedList:
    return import_register_list(text.encode(encoding), "map.csv", ImportOptions(**options))


def points(found: ImportedList) -> dict[str, Point]:
    return {point.name: point for point in found.profile.points}


def test_rows_that_no_profile_can_express_are_one_error_that_names_them_all() -> None:
    with pytest.raises(BadRowsError, match="3 rows are wrong, so no profile was made") as caught:
        imported(WORD_SWAPPED)
    wanted = "is no type, as UINT16, INT32, FLOAT32, BCD, BOOL or STRING[16] are"
    assert caught.value.lines == [
        f"map.csv: row 6, column \"Data Type\": 'DATETIME' {wanted}",
        f"map.csv: row 7, column \"Data Type\": 'U16x2' {wanted}",
        "map.csv: row 8, column \"R/W\": 'RC/WC' is no access, as R, W or RW are",
    ]


def test_references_with_swapped_words() -> None:
    found = imported(WORD_SWAPPED, skip_bad=True)
    assert {name: (one.table, one.address, one.type) for name, one in points(found).items()} == {
        "Serial number": (Table.HOLDING_REGISTERS, 0, PointType.UINT32),
        "Active power": (Table.HOLDING_REGISTERS, 2, PointType.INT32),
        "Mode": (Table.HOLDING_REGISTERS, 11, PointType.UINT16),
        "Relay": (Table.HOLDING_REGISTERS, 12, PointType.UINT16),
        "Alarms": (Table.HOLDING_REGISTERS, 13, PointType.FLAGS),
        "Energy": (Table.HOLDING_REGISTERS, 14, PointType.UINT64),
        "Voltage L1": (Table.INPUT_REGISTERS, 0, PointType.FLOAT32),
        "Model": (Table.INPUT_REGISTERS, 2, PointType.STRING),
    }
    swapped = [one.name for one in points(found).values() if one.word_order == "low-first"]
    assert swapped == ["Serial number", "Active power", "Voltage L1"]
    assert points(found)["Mode"].texts == {0: "Off", 1: "Auto"}
    assert points(found)["Relay"].texts == {0: "off", 1: "on"}
    assert points(found)["Alarms"].bits == {0: "Over voltage", 3: "Phase loss"}
    assert found.profile.areas[0].reference(0) == "400001"
    assert list(found.remarks) == [
        "row 2 is taken for the headings, and the rows above it are left out",
        'column "Register" is taken for the address',
        'column "Parameter" is taken for the name',
        'column "Data Type" is taken for the type',
        'column "Scale" is taken for the scale',
        'column "Units" is taken for the unit',
        'column "R/W" is taken for the access',
        'column "Values" is taken for the texts',
        'column "Notes" is taken for the description',
        'numbers are multiplied by "Scale", as some factors are less than 1 '
        "(--scaling says otherwise)",
        'row 3: "Holding registers": the rows below are holding registers',
        'row 13: "Input registers (FC 04)": the rows below are input registers',
        "addresses are references, as every one of 300001..400015 can be one: 400001 is address 0 "
        "on the wire (--addresses says otherwise)",
        "rows 4-5, 14: word order as named there",
        "row 15: the length of a text counts characters, two in a register",
        "word order of the others: high word first, as nothing says otherwise (--word-order)",
        *(
            f"left out: {line}"
            for line in (
                "row 6, column \"Data Type\": 'DATETIME' is no type, as UINT16, INT32, FLOAT32, "
                "BCD, BOOL or STRING[16] are",
                "row 7, column \"Data Type\": 'U16x2' is no type, as UINT16, INT32, FLOAT32, "
                "BCD, BOOL or STRING[16] are",
                "row 8, column \"R/W\": 'RC/WC' is no access, as R, W or RW are",
            )
        ),
    ]


def test_a_word_order_that_is_said_is_that_of_the_values_that_name_none() -> None:
    found = imported(WORD_SWAPPED, skip_bad=True, word_order=WordOrder.LOW_FIRST)
    assert points(found)["Energy"].word_order is WordOrder.LOW_FIRST
    assert "word order of the others: low word first, as --word-order says" in found.remarks


def test_hexadecimal_addresses_without_a_sign() -> None:
    found = imported(HEXADECIMAL)
    assert {name: (one.address, one.type) for name, one in points(found).items()} == {
        "Voltage": (0x0000, "uint16"),
        "Current": (0x0001, "uint32"),
        "Power": (0x0003, "int32"),
        "Baud rate": (0x0010, "uint16"),
    }
    assert found.profile.areas[0].span(0x00, 0x10) == "0000..0010"
    assert list(found.remarks) == [
        'column "Addr (hex)" is taken for the address',
        'column "Description" is taken for the description',
        'column "Format" is taken for the type',
        'column "Size (bytes)" is taken for the length-in-bytes',
        'column "Access" is taken for the access',
        'column "Resolution" is taken for the scale',
        'column "Unit" is taken for the unit',
        'numbers are multiplied by "Resolution", as its heading says (--scaling says otherwise)',
        "addresses are hexadecimal, as letters in them or the heading show: 0000 is address 0 "
        "on the wire (--addresses says otherwise)",
        "rows 2-5: no table named, taken as holding_registers (--table says otherwise)",
        "word order: high word first, as nothing says otherwise (--word-order)",
    ]


def test_what_the_user_names_is_not_guessed() -> None:
    headings = {
        Meaning.ADDRESS: "Addr (hex)",
        Meaning.NAME: "Description",
        Meaning.TYPE: "format",
        Meaning.LENGTH_IN_BYTES: "Size (bytes)",
        Meaning.ACCESS: "Access",
        Meaning.SCALE: "Resolution",
        Meaning.UNIT: "Unit",
    }
    found = imported(HEXADECIMAL, columns=headings, table=Table.INPUT_REGISTERS, skip_bad=True)
    assert {one.table for one in found.profile.points} == {Table.INPUT_REGISTERS}
    assert [one for one in found.remarks if "is taken for" in one or "table named" in one] == []
    assert found.remarks[-1] == (
        "left out: row 5, column \"Addr (hex)\": '0010' is in input_registers, which cannot be "
        "written, but its row says rw"
    )


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_a_german_list_with_headings_between_its_rows(encoding: str) -> None:
    found = imported(GERMAN, encoding)
    assert {name: (one.table, one.address) for name, one in points(found).items()} == {
        "Quittieren": (Table.COILS, 5),
        "Verdichter läuft": (Table.DISCRETE_INPUTS, 0),
        "Sollwert": (Table.HOLDING_REGISTERS, 10),
        "Betriebsart": (Table.HOLDING_REGISTERS, 11),
        "Zustand": (Table.HOLDING_REGISTERS, 12),
        "Außentemperatur": (Table.INPUT_REGISTERS, 0),
        "Wärmemenge": (Table.INPUT_REGISTERS, 1),
        "Störungen": (Table.INPUT_REGISTERS, 3),
    }
    assert (points(found)["Außentemperatur"].scale, points(found)["Sollwert"].scale) == (0.1, 0.5)
    assert points(found)["Betriebsart"].texts == {0: "Aus", 1: "Auto"}
    assert points(found)["Störungen"].bits == {0: "Hochdruck", 1: "Niederdruck"}
    assert points(found)["Zustand"].bits == {0: "Pumpe", 3: "Alarm"}
    latin = ["not UTF-8, so read as Latin-1: check °, µ and umlauts"]
    assert list(found.remarks) == [
        *(latin if encoding == "latin-1" else []),
        "row 2 is taken for the headings, and the rows above it are left out",
        'column "Modbus-Adresse" is taken for the address',
        'column "Bezeichnung" is taken for the name',
        'column "Datentyp" is taken for the type',
        'column "Einheit" is taken for the unit',
        'column "Faktor" is taken for the scale',
        'column "Zugriff" is taken for the access',
        'column "Bemerkung" is taken for the description',
        'numbers are multiplied by "Faktor", as its heading says (--scaling says otherwise)',
        'row 3: "Eingangsregister (FC 04)": the rows below are input registers',
        "rows 6, 11: values listed in the description, taken as texts",
        'row 7: "Diskrete Eingänge (FC 02)": the rows below are discrete inputs',
        'row 9: "Halteregister (FC 03/06/16)": the rows below are holding registers',
        "rows 13-14: no address, taken for values of the row above",
        'row 15: "Spulen": the rows below are coils',
        "addresses are zero-based, as one of them is 0: 0 is address 0 on the wire (--addresses "
        "says otherwise)",
        "word order: high word first, as nothing says otherwise (--word-order)",
    ]


@pytest.mark.parametrize(
    ("heading", "table"),
    [
        ("FC 01", Table.COILS),
        ("FC 2", Table.DISCRETE_INPUTS),
        ("Function code: 0x04", Table.INPUT_REGISTERS),
        ("Ausgänge (FC 05/15)", Table.COILS),
        ("Parameter (FC06, FC16)", Table.HOLDING_REGISTERS),
        ("Funktionscode 03 und 06", Table.HOLDING_REGISTERS),
        ("Halteregister (FC 04)", Table.INPUT_REGISTERS),
        ("Digitale Eingänge", Table.DISCRETE_INPUTS),
        ("Analogeingänge", Table.INPUT_REGISTERS),
        ("Holdingregister", Table.HOLDING_REGISTERS),
        ("Input registers", Table.INPUT_REGISTERS),
        ("Coils", Table.COILS),
    ],
)
def test_function_codes_then_words_of_a_heading_name_the_table(heading: str, table: Table) -> None:
    (point,) = imported(f"Adresse;Name\n{heading};\n5;a\n").profile.points
    assert point.table is table


def test_function_codes_may_stand_in_a_second_cell() -> None:
    found = imported("Adresse;Name;Typ\nMesswerte;FC 04;\n5;a;INT\n")
    assert found.profile.points[0].table is Table.INPUT_REGISTERS


def test_a_mistyped_address_is_no_heading_whatever_its_function() -> None:
    with pytest.raises(BadRowsError) as caught:
        imported("Adresse;Funktion\n4000l;FC 03\n40002;FC 03\n")
    assert caught.value.lines[0].startswith(
        "map.csv: row 2, column \"Adresse\": '4000l' is no addr"
    )


def test_a_heading_whose_functions_are_of_several_tables_is_wrong() -> None:
    with pytest.raises(UsageError) as caught:
        imported("Adresse;Name\nRegister (FC 03/04);\n5;a\n")
    assert isinstance(caught.value, BadRowsError)
    assert caught.value.lines == [
        "map.csv: row 2: 'Register (FC 03/04)' names functions of several tables"
    ]


def test_bits_below_a_row_that_is_wrong_do_not_go_to_the_row_before() -> None:
    text = "Adresse;Name;Typ\n1;a;INT\nx!;b;INT\n;Bit 0 = c;\n"
    found = imported(text, skip_bad=True)
    assert [(one.name, one.bits) for one in found.profile.points] == [("a", {})]
    assert "row 4: no address, left out" in found.remarks


def test_bits_may_stand_in_the_column_of_addresses() -> None:
    text = "Adresse;Name;Typ\n7;Zustand;UINT16\nBit 0;Pumpe;BOOL\nBit 3;Alarm;BOOL\n"
    (point,) = imported(text).profile.points
    assert (point.name, point.address) == ("Zustand", 7)
    assert point.bits == {0: "Pumpe", 3: "Alarm"}


def test_bits_of_a_row_that_is_left_out_are_a_point_of_their_own() -> None:
    text = "Register,Name,Type\n40001,a,DATETIME\n40001.3,b,BOOL\n"
    (point,) = imported(text, skip_bad=True).profile.points
    assert (point.name, point.bits) == ("40001", {3: "b"})


def test_a_bit_that_is_wrong_makes_no_point() -> None:
    found = imported("Register,Name,Type\n40001.17,a,BOOL\n40002,b,INT\n", skip_bad=True)
    assert [one.name for one in found.profile.points] == ["b"]


def test_rights_follow_the_functions_of_the_heading() -> None:
    found = imported("Adresse;Name\nRegister (FC 03);\n5;a\nRegister (FC 03/06);\n9;b\n")
    assert [(one.name, one.access) for one in found.profile.points] == [
        ("a", Access.READ),
        ("b", None),
    ]


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("5,a,STRING[8],,", "row 2: the length of a text counts characters, two in a register"),
        ("5,a,INT16,2,", "row 2: whole numbers are divided as their decimals say"),
        ('5,a,INT16,,"10,000"', "row 2: comma taken for a decimal comma: 1,000 is 1"),
    ],
)
def test_a_guess_about_one_row_is_told(row: str, told: str) -> None:
    assert told in imported(f"address,name,type,decimals,max\n{row}\n").remarks
