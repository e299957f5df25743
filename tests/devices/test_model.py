from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.loading import load_profile
from mbtool.devices.model import Access, Area, Exceptions, Point, Radix
from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import Table


def _area(**fields: object) -> Area:
    defaults: dict[str, object] = {
        "name": "area",
        "table": Table.HOLDING_REGISTERS,
        "first": 0,
        "last": 99,
        "access": Access.READ_WRITE,
    }
    return Area(**{**defaults, **fields})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("area", "one", "several"),
    [
        (_area(prefix="HR", base=400001), "HR400017", "HR400017..400018"),
        (_area(prefix="X", radix=Radix.HEX), "X10", "X10..X11"),
        (_area(radix=Radix.HEX, width=4, suffix="H"), "0010H", "0010H..0011H"),
        (_area(prefix="M", radix=Radix.OCTAL_DIGIT), "M20", "M20..21"),
        (_area(prefix="M", radix=Radix.OCTAL_DIGIT, width=4, base=-9), "M0007", "M0007..0010"),
        (_area(prefix="D", base=-16), "D0", "D0..1"),
    ],
)
def test_area_writes_addresses_as_its_manual_does(area: Area, one: str, several: str) -> None:
    assert area.reference(16) == one
    assert area.span(16, 16) == one
    assert area.span(16, 17) == several


@pytest.mark.parametrize(
    ("number", "digits"), [(0, "0"), (7, "7"), (8, "10"), (79, "97"), (80, "100"), (261, "325")]
)
def test_only_the_last_digit_of_octal_digit_stops_at_seven(number: int, digits: str) -> None:
    assert Radix.OCTAL_DIGIT.write(number) == digits
    assert Radix.OCTAL_DIGIT.read(digits) == number


@pytest.mark.parametrize(
    ("radix", "digits"),
    [(Radix.OCTAL_DIGIT, "328"), (Radix.OCTAL_DIGIT, "3A1"), (Radix.DECIMAL, "1F"),
     (Radix.HEX, "1G"), (Radix.HEX, ""), (Radix.OCTAL_DIGIT, ""), (Radix.DECIMAL, "٤")],
)  # fmt: skip
def test_digits_of_another_radix_are_no_number(radix: Radix, digits: str) -> None:
    with pytest.raises(ValueError, match=f"no {radix} number"):
        radix.read(digits)


@given(st.sampled_from(Radix), st.integers(0, 1_065_535))
def test_every_number_is_read_back(radix: Radix, number: int) -> None:
    assert radix.read(radix.write(number)) == number


def test_the_access_chooses_between_two_areas_at_one_address() -> None:
    profile = msgspec.structs.replace(
        load_profile("idec-ft1a-touch"),
        areas=[
            _area(name="inputs", first=0, last=9, access=Access.READ),
            _area(name="outputs", first=5, last=19, access=Access.WRITE),
        ],
    )

    def name(address: int, quantity: int = 1, *, writing: bool = False) -> str | None:
        area = profile.area(Table.HOLDING_REGISTERS, address, quantity, writing=writing)
        return None if area is None else area.name

    assert (name(7), name(7, writing=True)) == ("inputs", "outputs")
    assert (name(3, writing=True), name(15)) == ("inputs", "outputs")  # What one cannot do there.
    assert (name(8, 4), name(20)) == ("outputs", None)
    allowed = [
        (first, last, writing)
        for first, last in ((0, 9), (5, 9), (5, 19), (9, 10))
        for writing in (False, True)
        if profile.allows(Table.HOLDING_REGISTERS, range(first, last + 1), writing=writing)
    ]
    assert allowed == [
        (0, 9, False), (5, 9, False), (5, 9, True), (5, 19, True), (9, 10, True)
    ]  # fmt: skip


def test_exception_has_the_makers_text_or_the_standards() -> None:
    profile = msgspec.structs.replace(
        load_profile("idec-ft1a-touch"), exceptions=Exceptions(texts={0x11: "out of range"})
    )
    assert profile.exception_name(0x11) == "out of range"
    assert profile.exception_name(2) == "illegal data address"


def test_an_area_holds_only_ranges_that_are_completely_inside() -> None:
    area = _area(first=10, last=19)
    assert area.holds(Table.HOLDING_REGISTERS, 10, 10)
    assert not area.holds(Table.HOLDING_REGISTERS, 10, 11)
    assert not area.holds(Table.HOLDING_REGISTERS, 9)
    assert not area.holds(Table.COILS, 10)


def test_point_says_where_each_of_several_begins() -> None:
    point = Point(name="{n}", table=Table.HOLDING_REGISTERS, address=0x134, count=3, stride=2)
    assert list(point.addresses) == [0x134, 0x136, 0x138]


def test_words_and_channels_follow_from_the_type() -> None:
    assert PointType.FLOAT32.words == 2
    assert PointType.INT16.words == 1
    assert PointType.NIBBLE_FIELD.channel_bits == 4
    assert PointType.UINT16.channel_bits == 0
    assert [type_ for type_ in PointType if type_.words == 4] == ["uint64", "int64", "float64"]
    text = Point(
        name="p", table=Table.HOLDING_REGISTERS, address=0, type=PointType.STRING, length=8
    )
    assert text.words == 8


def test_profile_finds_the_rule_and_the_area() -> None:
    profile = load_profile("idec-ft1a-touch")
    rule = profile.rule(0x10)
    assert rule is not None
    assert rule.limit == 100
    assert profile.rule(0x0F) is None
    area = profile.area(Table.INPUT_REGISTERS, 4095)
    assert area is not None
    assert area.prefix == "IR"
    assert profile.area(Table.INPUT_REGISTERS, 4095, 2) is None
