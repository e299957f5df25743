from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices import Point, PointType, PointValue, WordOrder
from mbtool.devices.values import _MAX_REMEMBERED, Place
from mbtool.modbus.tables import Table


def _value(type_: PointType, *raw: int, **fields: Any) -> PointValue:
    point = Point(name="p", table=Table.HOLDING_REGISTERS, address=0, type=type_, **fields)
    return Place(point, 0, "R0").value(raw)


@pytest.mark.parametrize(
    ("value", "number", "text"),
    [
        (_value(PointType.UINT16, 65535), 65535, "65535"),
        (_value(PointType.INT16, 0xFFFF), -1, "-1"),
        (_value(PointType.INT16, 0x8000), -32768, "-32768"),
        (_value(PointType.UINT16, 275, scale=0.1, unit="s"), 27.5, "27.5 s"),
        (_value(PointType.UINT16, 3, scale=0.1), 0.3, "0.3"),
        (_value(PointType.UINT16, 600, unit="s"), 600, "600 s"),
        (_value(PointType.UINT16, 2, texts={2: "run"}, unit="s"), 2, "run"),
        (_value(PointType.HEX16, 0x0E30, texts={0x0E30: "alarm"}), 0x0E30, "0E30H alarm"),
        (_value(PointType.HEX16, 0x0E31, texts={0x0E30: "alarm"}), 0x0E31, "0E31H"),
        (_value(PointType.OCTETS, 0x03FA), 0x03FA, "3.250"),
        (_value(PointType.UINT32, 0x0001, 0x0002), 0x10002, "65538"),
        (_value(PointType.UINT32, 1, 2, word_order=WordOrder.LOW_FIRST), 0x20001, "131073"),
        (_value(PointType.INT32, 0xFFFF, 0xFFFE), -2, "-2"),
        (_value(PointType.UINT32, 0xFFFF, 0xFFFF, scale=0.1), 429496729.5, "429496729.5"),
        (_value(PointType.FLOAT32, 0x4048, 0xF5C3), pytest.approx(3.14), "3.14"),
        (_value(PointType.FLOAT32, 0x7FC0, 0x0000), None, "nan"),
        (_value(PointType.FLOAT32, 0xFF80, 0x0000, unit="s"), None, "-inf s"),
        (_value(PointType.BIT, 1), 1, "on"),
        (_value(PointType.BIT, 0, texts={0: "disabled"}), 0, "disabled"),
    ],
)
def test_value_and_text_follow_from_the_type(
    value: PointValue, number: float | None, text: str
) -> None:
    assert (value.value, value.text) == (number, text)


@pytest.mark.parametrize(
    ("word", "fields", "text"),
    [
        (0x005C, {"channels": 8, "texts": {0: "enabled"}}, "CH1 CH2 CH6 CH8 enabled"),
        (0x00FF, {"channels": 8, "texts": {0: "enabled"}}, "none enabled"),
        (0x0003, {"channels": 4, "texts": {0: "off", 1: "on"}}, "CH1 CH2 on, CH3 CH4 off"),
        (0x8001, {}, "CH1 CH16 on"),
        (0x0000, {}, "none on"),
        (0x0101, {"channels": 8, "channel": "DO"}, "DO1 on, unassigned bits 0100H"),
    ],
)
def test_bit_field_names_the_channels_whose_bit_has_a_text(
    word: int, fields: dict[str, Any], text: str
) -> None:
    assert _value(PointType.BIT_FIELD, word, **fields).text == text


@pytest.mark.parametrize(
    ("word", "fields", "text"),
    [
        (0x1010, {"first_channel": 5, "texts": {0: "CLEAR", 1: "HOLD"}},
         "CH5 CH7 CLEAR, CH6 CH8 HOLD"),
        (0x0007, {"texts": {0: "CLEAR"}}, "CH1 7, CH2 CH3 CH4 CLEAR"),
        (0x9012, {"channels": 3}, "CH1 2, CH2 1, CH3 0, unassigned bits 9000H"),
    ],
)  # fmt: skip
def test_nibble_field_names_the_channels_by_what_they_are(
    word: int, fields: dict[str, Any], text: str
) -> None:
    assert _value(PointType.NIBBLE_FIELD, word, **fields).text == text


def test_place_among_several_has_its_own_name() -> None:
    several = Point(
        name="CH{n} at {reference}", table=Table.HOLDING_REGISTERS, address=8, count=4, stride=2
    )
    assert Place(several, 12, "R12").name == "CH3 at R12"


@given(st.sampled_from(list(PointType)), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF))
def test_any_registers_have_a_text(type_: PointType, first: int, second: int) -> None:
    assert _value(type_, *(first, second)[: type_.words]).text


def test_memory_is_bounded() -> None:
    place = Place(Point(name="p", table=Table.HOLDING_REGISTERS, address=0), 0, "R0")
    for word in range(3 * _MAX_REMEMBERED):
        assert place.value([word]).value == word
    assert len(place._remembered) <= _MAX_REMEMBERED
