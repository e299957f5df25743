"""References and values of a user, as requests."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from mbtool.core import UsageError
from mbtool.devices import Point, PointType, load_profile
from mbtool.modbus import Table
from mbtool.modbus.adu import Transport
from mbtool.workflows.shared.questions import Wording

FT1A = load_profile("idec-ft1a-touch")
FA3 = load_profile("fa3-at1m8x")
LT830 = load_profile("chino-lt830")
WAGO = load_profile("wago-750")


def _hex(*requests: bytes) -> list[str]:
    return [pdu.hex() for pdu in requests]


@pytest.mark.parametrize(
    ("text", "request_hex"),
    [
        ("holding 0..3", "0300000004"),
        ("hr 0x10", "0300100001"),
        ("ir:7", "0400070001"),
        ("coil 5..12", "0100050008"),
        ("di 3", "0200030001"),
        ("HR400001..400010", "030000000a"),
        ("HR400001..HR400010", "030000000a"),
        ("400010", "0300090001"),
        ("300001..300002", "0400000002"),
        ("100001", "0200000001"),
        ("000008", "0100070001"),
    ],
)
def test_reads_without_a_profile(text: str, request_hex: str) -> None:
    assert _hex(*Wording().reads(text)) == [request_hex]


@pytest.mark.parametrize(
    ("text", "request_hex"),
    [
        ("0102H", "0301020001"),
        ("X0..XF", "0200000010"),
        ("holding 0x102..0x104", "0301020003"),
        ("A/D conversion enable/disable setting", "0301020001"),
    ],
)
def test_reads_with_a_profile(text: str, request_hex: str) -> None:
    assert _hex(*Wording(FA3).reads(text)) == [request_hex]


def test_a_function_makes_an_address_alone_a_reference() -> None:
    assert _hex(*Wording(function=4).reads("0x10..0x1f")) == ["0400100010"]
    assert _hex(*Wording(FT1A, 1).reads("7")) == ["0100070001"]
    assert _hex(Wording(function=16).write("7=1")) == ["1000070001020001"]
    assert _hex(Wording(function=5).write("7=on")) == ["050007ff00"]


def test_a_long_range_is_divided_as_the_standard_or_the_device_asks() -> None:
    assert _hex(*Wording().reads("holding 0..249")) == ["030000007d", "03007d007d"]
    assert _hex(*Wording().reads("coil 0..2000")) == ["01000007d0", "0107d00001"]
    rule = LT830.with_limits_of(Transport.ASCII).functions["03"]
    assert rule.limit is not None
    first, *_ = Wording(LT830.with_limits_of(Transport.ASCII)).reads(f"holding 0..{rule.limit}")
    assert int.from_bytes(first[3:]) == rule.limit < 125


def test_a_division_leaves_a_value_of_two_registers_whole() -> None:
    floats = Point(
        name="T{n}",
        table=Table.HOLDING_REGISTERS,
        address=1,
        type=PointType.FLOAT32,
        count=100,
        stride=2,
    )
    first, second = Wording(replace(FT1A, points=[floats])).reads("HR400001..400200")
    assert _hex(first, second) == ["030000007d", "03007d004b"]  # 1 and 62 whole values, then 37
    first, second = Wording(replace(FT1A, points=[floats])).reads("HR400002..400201")
    assert _hex(first, second) == ["030001007c", "03007d004c"]
    assert _hex(*Wording(replace(FT1A, points=[floats])).reads("HR400002")) == ["0300010002"]


def test_a_point_of_a_block_is_read_from_the_beginning_of_the_block() -> None:
    assert _hex(*Wording(WAGO).reads("BadLength statistics")) == ["0310290003"]


@pytest.mark.parametrize(
    ("text", "request_hex"),
    [
        ("holding 0=4660", "0600001234"),
        ("holding 0 = -1", "060000ffff"),
        ("hr 0x10=0xBEEF", "060010beef"),
        ("HR400001=1,2,3", "10000000030600010002" + "0003"),
        ("coil 3=on", "050003ff00"),
        ("coil 3=0", "0500030000"),
        ("000004=1,0,1", "0f000300030105"),
    ],
)
def test_writes_without_a_profile(text: str, request_hex: str) -> None:
    assert _hex(Wording().write(text)) == [request_hex]


def test_writes_the_value_of_a_point_in_its_unit_or_its_words() -> None:
    assert _hex(Wording(FA3).write("Split reception monitoring timer=7")) == ["0600f50007"]
    assert _hex(Wording(WAGO).write("Boot configuration=DHCP")) == ["0610280002"]
    assert _hex(Wording(WAGO).write("Boot configuration=1")) == ["0610280001"]


def test_a_device_without_the_function_for_one_value_gets_the_one_for_several() -> None:
    rules = {code: rule for code, rule in FT1A.functions.items() if code != "06"}
    only_several = replace(FT1A, functions=rules)
    assert _hex(Wording(only_several).write("HR400001=1")) == ["1000000001020001"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("40000", "'40000': vendors mean different registers by five digits; write 'holding 0'"),
        ("nonsense", "'nonsense' is no range of registers; write 'holding 10..20'"),
        ("D100", "as the device's manual does, with --device"),
        ("holding 9..0", "from the lower to the higher"),
        ("holding 65530..65536", "up to 65535"),
        ("000000", "'000000' is no range"),
        ("400001..300002", "'400001..300002' is no range"),
    ],
)
def test_a_reference_that_names_nothing_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Wording().reads(text)


@pytest.mark.parametrize(
    ("wording", "text", "message"),
    [
        (Wording(), "holding 0", "write REFERENCE=VALUE"),
        (Wording(), "=5", "write REFERENCE=VALUE"),
        (Wording(), "holding 0=", "write REFERENCE=VALUE"),
        (Wording(), "holding 0=70000", "-32768 to 65535"),
        (Wording(), "holding 0=much", "-32768 to 65535"),
        (Wording(), "coil 0=2", "from 0 to 1"),
        (Wording(), "input 0=2", "inputs can only be read"),
        (Wording(), "holding 0..1=2", "name the first address"),
        (Wording(), "holding 0=1,,2", "-32768 to 65535"),
        (Wording(function=3), "holding 0=1", "--function 3 does not fit"),
        (Wording(function=6), "holding 0=1,2", "--function 6 does not fit 'holding 0=1,2'"),
        (Wording(FT1A), f"HR400001={','.join('1' * 124)}", "a write is not divided"),
        (Wording(FT1A), "C1=1,0,1", "idec-ft1a-touch has no function 0F to write several at once"),
        (Wording(FA3), "A/D conversion enable/disable setting=1,2", "a name is one value"),
        (Wording(FA3), "A/D conversion enable setting=1", "did you mean"),
    ],
)
def test_a_write_that_cannot_be_is_refused(wording: Wording, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        wording.write(text)


def test_a_function_that_does_not_fit_is_refused() -> None:
    with pytest.raises(UsageError, match="does not fit 'coil 0', for which it is 1"):
        Wording(function=3).reads("coil 0")
    with pytest.raises(UsageError, match="--function 23: write one of 1, 2, 3, 4, 5, 6, 15, 16"):
        Wording(function=23)
