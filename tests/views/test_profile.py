"""Profiles as pages, at a width of 100."""

from __future__ import annotations

import io
from typing import Any

import msgspec
import pytest
from rich.console import Console, RenderableType

from mbtool.devices import (
    Access,
    ByteOrder,
    FunctionRule,
    Point,
    PointType,
    Profile,
    Timing,
    WordOrder,
    builtin_profiles,
    load_profile,
)
from mbtool.modbus.tables import Table
from mbtool.views.profile import profile_list, profile_page


def _lines(page: RenderableType, width: int = 100) -> list[str]:
    file = io.StringIO()
    Console(file=file, width=width, force_terminal=False).print(page)
    return [line.rstrip() for line in file.getvalue().splitlines()]


def test_the_list_has_a_line_for_each_profile() -> None:
    assert _lines(profile_list([load_profile(name) for name in builtin_profiles()])) == [
        "name                 device                                                transports  "
        "areas"
        "  points",
        "chino-lt830          LT830 digital indicating controller                   rtu, ascii  4"
        "      4",
        "fa3-at1m8x           FA3-AT1M8X analog input module, 8 channels            tcp         5"
        "      53",
        "fa3-at1m8y           FA3-AT1M8Y analog output module, 8 channels           tcp         5"
        "      45",
        "fa3-th1m16xc         FA3-TH1M16XC digital input module, 16 inputs          tcp         5"
        "      23",
        "fa3-th1m16y          FA3-TH1M16Y digital output module, 16 outputs         tcp         5"
        "      23",
        "fa3-th1m16ye         FA3-TH1M16YE digital output module, 16 outputs        tcp         5"
        "      23",
        "idec-ft1a-smartaxis  FT1A SmartAXIS Pro/Lite controller, Modbus RTU slave  rtu         13"
        "     1200",
        "idec-ft1a-touch      FT1A Touch operator interface, Modbus RTU slave       rtu         4"
        "      0",
        "wago-750             WAGO-I/O-SYSTEM 750 fieldbus coupler, ETHERNET        tcp         42"
        "     315",
    ]


def test_a_page_says_what_the_manual_says() -> None:
    assert _lines(profile_page(load_profile("idec-ft1a-touch")))[4:20] == [
        "area              references        addresses   table              access",
        "coil status       C1..4096          0000..0FFF  coils              read, write",
        "input status      I100001..104096   0000..0FFF  discrete inputs    read",
        "input register    IR300001..304096  0000..0FFF  input registers    read",
        "holding register  HR400001..404096  0000..0FFF  holding registers  read, write",
        "",
        "function  name                      at most",
        "01        Read coils                2000",
        "02        Read discrete inputs      2000",
        "03        Read multiple registers   125",
        "04        Read input registers      125",
        "05        Write coil                1",
        "06        Write single register     1",
        "10        Write multiple registers  100",
        "",
        "exceptions: 01 for a function that it lacks, 02 for an address outside its areas, 02 for a"
        " value or",
    ]


@pytest.mark.parametrize("name", builtin_profiles())
@pytest.mark.parametrize("width", [80, 100])
def test_each_page_names_all_that_its_profile_has(name: str, width: int) -> None:
    profile = load_profile(name)
    lines = _lines(profile_page(profile), width)
    words = " ".join(" ".join(lines).split())
    assert max(map(len, lines)) <= width
    for note in profile.notes:
        assert f"Note: {note}" in words
    for area in profile.areas:
        assert area.span(area.first, area.last) in words
    for code in profile.functions:
        assert any(line.startswith(f"{code}  ") for line in lines)
    assert "{" not in words


def test_values_stand_in_the_manuals_notation() -> None:
    page = "\n".join(_lines(profile_page(load_profile("fa3-at1m8x")), 200))
    for text in (
        "hex16         0E30H = alive check error, 0E40H = split reception monitoring error",
        "octets        default 192.168",
        "uint16        1..14400 s, default 600 s",
        "nibble-field  0 = sampling processing, 1 = time average, 2 = count average",
        "int16         in steps of 2 addresses",
        "X10 .. X17      CHn A/D conversion completion flag",
        "units: it answers whatever unit a request names",
    ):
        assert text in page


def test_a_note_that_several_points_share_is_told_once() -> None:
    lines = _lines(profile_page(load_profile("fa3-at1m8x")), 200)
    (note,) = (line for line in lines if "nearest limit" in line)
    assert note.startswith("Note: 00F2H, 00F3H, 00F4H, 00F5H: ")


def _with_point(**changes: object) -> Profile:
    profile = load_profile("fa3-at1m8x")
    (point,) = (one for one in profile.points if one.name.startswith("Split reception"))
    return msgspec.structs.replace(profile, points=[msgspec.structs.replace(point, **changes)])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"minimum": None}, "up to 1200 s, default 30 s"),
        ({"maximum": None}, "from 1 s on, default 30 s"),
        ({"minimum": None, "maximum": None, "default": None}, "in s"),
        ({"type": PointType.INT32, "default": 3}, "1..1200 s, default 3"),
    ],
)
def test_says_what_it_knows_of_a_range(changes: dict[str, object], text: str) -> None:
    assert any(line.endswith(f"  {text}") for line in _lines(profile_page(_with_point(**changes))))


def test_a_page_says_which_silences_a_device_keeps() -> None:
    profile = msgspec.structs.replace(
        load_profile("idec-ft1a-touch"), timing=Timing(t1_5="1ms", t3_5="28bits")
    )
    assert "timing: t1.5 1ms, t3.5 28bits" in _lines(profile_page(profile))


def test_a_page_says_what_holds_in_one_mode_only_and_what_a_code_means() -> None:
    lines = _lines(profile_page(load_profile("chino-lt830")), 200)
    assert "03        read holding registers    26, in ASCII 13" in lines
    assert any("11 value out of setting range, 12 programming disabled" in line for line in lines)


def test_a_page_says_how_far_apart_requests_are() -> None:
    smartaxis = load_profile("idec-ft1a-smartaxis")
    patient = msgspec.structs.replace(smartaxis, timing=Timing(request_interval="5ms"))
    assert "timing: at least 5ms before each request" in _lines(profile_page(patient))


def test_a_page_says_which_units_and_data_there_are() -> None:
    assert "units: 1 to 99" in _lines(profile_page(load_profile("chino-lt830")))
    lines = _lines(profile_page(load_profile("fa3-at1m8x")))
    assert "41        remote reset (data 00), without an answer" in [one.rstrip() for one in lines]


def test_a_page_tells_what_is_read_from_what_is_written() -> None:
    lines = _lines(profile_page(load_profile("wago-750")), 200)
    begin = next(at for at, line in enumerate(lines) if line.startswith("physical outputs (1)"))
    assert [line.split()[-4:] for line in lines[begin : begin + 5]] == [
        ["holding", "registers", "read,", "write"],
        ["0000..00FF", "holding", "registers", "write"],
        ["0200..02FF", "input", "registers", "read"],
        ["0000..00FF", "holding", "registers", "read"],
        ["0000..00FF", "input", "registers", "read"],
    ]
    assert "  %QW0..255 " in lines[begin]
    assert lines[begin + 3].split()[:4] == ["physical", "inputs", "(1)", "%IW0..255"]


def test_a_page_says_what_is_doubtful_and_which_functions_differ() -> None:
    controller = "\n".join(_lines(profile_page(load_profile("chino-lt830")), 200))
    assert "01        Read digital parameter    1, which is doubtful" in controller
    coupler = " ".join(" ".join(_lines(profile_page(load_profile("wago-750")), 200)).split())
    assert "it does not allow (02 of function 01, 02 of function 02); the manual lists" in coupler


def test_a_page_says_how_each_value_stands_in_its_registers() -> None:
    profile = msgspec.structs.replace(
        load_profile("fa3-at1m8x"),
        functions={"41": FunctionRule(title="remote reset", answers=False)},
        points=[
            _point("Flow", 0x100, type=PointType.INT16, scale=0.1, offset=-50.0, decimals=1,
                   minimum=-50, maximum=27.5, unit="degC"),
            _point("State", 0x101, type=PointType.FLAGS, bits={3: "ALARM", 0: "READY"}, default=9),
            _point("Total", 0x102, type=PointType.FLOAT64, word_order=WordOrder.LOW_FIRST,
                   byte_order=ByteOrder.LOW_FIRST, scale=10.0, decimals=2),
            _point("Model", 0x110, type=PointType.STRING, length=8, access=Access.READ),
            _point("Reset", 0x120, offset=3.0, access=Access.WRITE),
            _point("Second", 0x131, block=0x130),
            _point("Time", 0x140, scale=100.0, unit="ms"),
            _point("Delay", 0x141, unit="s"),
        ],
    )  # fmt: skip
    lines = _lines(profile_page(profile), 120)
    assert "41        remote reset, without an answer" in lines
    table = lines.index("reference     point   type                                     values")
    assert lines[table + 1 : table + 9] == [
        "0100H         Flow    int16                                    number x 0.1 - 50, "
        "1 decimal, -50..27.5 degC",
        "0101H         State   flags                                    bit 0 = READY, "
        "bit 3 = ALARM, default READY, ALARM",
        "0102H..0105H  Total   float64, low word first, low byte first  number x 10, 2 decimals",
        "0110H..0117H  Model   string, 8 registers                      read only",
        "0120H         Reset   uint16                                   number + 3, write only",
        "0131H         Second  uint16                                   in a read from 0130H on",
        "0140H         Time    uint16                                   number x 100 ms",
        "0141H         Delay   uint16                                   in s",
    ]


def _point(name: str, address: int, **fields: Any) -> Point:
    return Point(name=name, table=Table.HOLDING_REGISTERS, address=address, **fields)


def test_nothing_that_a_profile_says_is_obeyed() -> None:
    profile = load_profile("idec-ft1a-touch")
    area = profile.areas[0]
    point = Point(name="Alarm [/x]", table=area.table, address=0, type=PointType.BIT, note="a\nb")
    profile = msgspec.structs.replace(profile, title="[bold]\x1b[2J", points=[point])
    lines = _lines(profile_page(profile))
    assert lines[0] == "[bold]?[2J"
    assert any("Alarm [/x]" in line for line in lines)
    assert lines[-1] == "Note: C1: a b"
    assert any("[bold]?[2J" in line for line in _lines(profile_list([profile])))
