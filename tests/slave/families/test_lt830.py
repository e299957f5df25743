"""A LT830 controller, seen through the responder."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.devices import Access, Area, Point, PointType, load_profile
from mbtool.modbus import Table
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from mbtool.slave.families.lt830 import Lt830

if TYPE_CHECKING:
    from mbtool.slave.device.responder import DeviceResponder

HOLDING = Table.HOLDING_REGISTERS
LT830 = load_profile("chino-lt830")


def _with_holes() -> DeviceResponder:
    """A LT830 by a table of references: 40001 to 40004 and 40011 to 40014, with ranges."""
    from msgspec.structs import replace

    def area(first: int) -> Area:
        return Area(
            name="analog parameter",
            table=HOLDING,
            first=first,
            last=first + 3,
            access=Access.READ_WRITE,
            base=40001,
        )

    points = [
        Point(name="SV", table=HOLDING, address=0, type=PointType.INT16, minimum=-10, maximum=100),
        Point(name="total", table=HOLDING, address=1, type=PointType.INT32, maximum=0x1FFFF),
        Point(name="PV", table=HOLDING, address=3, access=Access.READ),
    ]
    profile = replace(LT830, areas=[area(0), area(10)], points=points)
    return make_device(profile, RegisterImage.of(profile))


def _ask(device: DeviceResponder, request: str) -> str:
    answer = device.respond(2, bytes.fromhex(request), 0)
    assert answer is not None
    return answer.pdu.hex(" ")


def _built_in() -> DeviceResponder:
    return make_device(LT830, RegisterImage.of(LT830))


def test_its_addresses_are_1_to_99() -> None:
    assert (Lt830.units.start, Lt830.units.stop) == (1, 100)


def test_a_number_that_does_not_exist_reads_as_0_behind_one_that_does() -> None:
    device = _with_holes()
    device.image.set(HOLDING, 2, [7, 8])
    device.image.set(HOLDING, 10, [9])
    values = "00 07 00 08" + 6 * " 00 00" + " 00 09"
    assert _ask(device, "03 0002 0009") == f"03 12 {values}"
    assert _ask(device, "03 000D 0004") == "03 08" + 8 * " 00"


def test_a_start_number_that_does_not_exist_gives_02() -> None:
    device = _with_holes()
    assert _ask(device, "03 0004 0008") == "83 02"
    assert _ask(_built_in(), "03 270F 0001") == "83 02"


def test_a_range_beyond_the_last_address_gives_02() -> None:
    from msgspec.structs import replace

    end = replace(LT830.areas[3], last=0xFFFF)
    profile = replace(LT830, areas=[end])
    device = make_device(profile, RegisterImage.of(profile))
    assert _ask(device, "03 FFFF 0001") == "03 02 00 00"
    assert _ask(device, "03 FFFF 0002") == "83 02"


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("10 0003 0002 04 0001 0002", 0x02),  # the second does not exist
        ("10 0000 0002 04 0001 0002", 0x11),  # half of a number that is too large then
        ("10 0000 0001 02 0065", 0x11),
        ("06 0000 FFF5", 0x11),  # -11
        ("10 0002 0002 04 0001 0002", 0x12),  # PV is to be read
    ],
)
def test_any_error_leaves_the_whole_write_undone(request_: str, code: int) -> None:
    device = _with_holes()
    before = device.image.get(HOLDING, 0, 16)
    assert _ask(device, request_) == f"{int(request_[:2], 16) | 0x80:02x} {code:02x}"
    assert device.image.get(HOLDING, 0, 16) == before


def test_values_in_their_ranges_are_written() -> None:
    device = _with_holes()
    assert _ask(device, "10 0000 0003 06 FFF6 0001 FFFF") == "10 00 00 00 03"
    assert device.image.get(HOLDING, 0, 3) == [0xFFF6, 1, 0xFFFF]


def test_diagnosis_gives_its_two_bytes_back() -> None:
    device = _built_in()
    assert _ask(device, "08 0000 A55A") == "08 00 00 a5 5a"
    assert _ask(device, "08 0001 0000") == "88 01"
    assert _ask(device, "08 0000") == "88 03"
    assert _ask(device, "08 0000 0102 03") == "88 03"


def test_the_manuals_examples_come_out() -> None:
    device = _built_in()
    device.image.set(HOLDING, 0xCD, [0x1E, 0x78, 0x14])
    assert _ask(device, "01 0064 0001") == "01 01 00"
    assert _ask(device, "03 00CD 0003") == "03 06 00 1e 00 78 00 14"
    assert _ask(device, "0F 0064 0001 01 01") == "0f 00 64 00 01"
    assert _ask(device, "01 0064 0001") == "01 01 01"


def test_limits_are_those_of_the_mode() -> None:
    from mbtool.modbus import Transport

    ascii_mode = LT830.with_limits_of(Transport.ASCII)
    device = make_device(ascii_mode, RegisterImage.of(ascii_mode))
    assert _ask(device, "03 0000 000D")[:2] == "03"
    assert _ask(device, "03 0000 000E") == "83 03"
    assert _ask(device, "10 0000 000C 18" + 12 * "0000") == "90 03"
    assert _ask(_built_in(), "03 0000 001A")[:2] == "03"
    assert _ask(_built_in(), "03 0000 001B") == "83 03"


def test_several_switches_are_read_at_once_as_page_24_says() -> None:
    assert _ask(_built_in(), "01 0064 0008") == "01 01 00"
    assert _ask(_built_in(), "01 0064 07D1") == "81 03"  # More than the standard allows.
