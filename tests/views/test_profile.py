"""Profiles as pages, at a width of 100."""

from __future__ import annotations

import io

import msgspec
import pytest
from rich.console import Console, RenderableType

from mbtool.devices import PointType, Profile, Timing, builtin_profiles, load_profile
from mbtool.views.profile import profile_list, profile_page


def _lines(page: RenderableType, width: int = 100) -> list[str]:
    file = io.StringIO()
    Console(file=file, width=width, force_terminal=False).print(page)
    return [line.rstrip() for line in file.getvalue().splitlines()]


def test_the_list_has_a_line_for_each_profile() -> None:
    assert _lines(profile_list([load_profile(name) for name in builtin_profiles()])) == [
        "name             device                                           transports  areas"
        "  points",
        "fa3-at1m8x       FA3-AT1M8X analog input module, 8 channels       tcp         5      53",
        "fa3-at1m8y       FA3-AT1M8Y analog output module, 8 channels      tcp         5      45",
        "fa3-th1m16xc     FA3-TH1M16XC digital input module, 16 inputs     tcp         5      23",
        "fa3-th1m16y      FA3-TH1M16Y digital output module, 16 outputs    tcp         5      23",
        "fa3-th1m16ye     FA3-TH1M16YE digital output module, 16 outputs   tcp         5      23",
        "idec-ft1a-touch  FT1A Touch operator interface, Modbus RTU slave  rtu         4      0",
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
        "01        read coils                2000",
        "02        read discrete inputs      2000",
        "03        read holding registers    125",
        "04        read input registers      125",
        "05        write single coil         1",
        "06        write single register     1",
        "10        write multiple registers  100",
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
