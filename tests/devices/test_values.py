from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import UsageError
from mbtool.devices.loading import load_profile
from mbtool.devices.model import Access, Point
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.devices.values import (
    _MAX_CACHED,
    PointInstance,
    point_instances,
    point_values,
    registers_of,
)
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import PointValue

WORDS = st.integers(0, 0xFFFF)


def _point(type_: PointType, **fields: Any) -> Point:
    return Point(name="p", table=Table.HOLDING_REGISTERS, address=0, type=type_, **fields)


def _value(type_: PointType, *raw: int, **fields: Any) -> PointValue:
    return PointInstance(_point(type_, **fields), 0, "R0").value(raw)


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
        (_value(PointType.FLOAT32, 0x4048, 0xF5C3, decimals=1), pytest.approx(3.14), "3.1"),
        (
            _value(PointType.FLOAT32, 0x4049, 0x0FDB, scale=2.0),
            pytest.approx(6.2831855),
            "6.283185",
        ),
        (_value(PointType.UINT64, 1, 2, 3, 4), 0x1_0002_0003_0004, "281483566841860"),
        (_value(PointType.UINT64, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF), 2**64 - 1, str(2**64 - 1)),
        (
            _value(PointType.INT64, 0xFFFE, 0xFFFF, 0xFFFF, 0xFFFF, word_order=WordOrder.LOW_FIRST),
            -2,
            "-2",
        ),
        (_value(PointType.FLOAT64, 0x4009, 0x21FB, 0x5444, 0x2D18), math.pi, "3.14159265358979"),
        (_value(PointType.FLOAT64, 0x7FF0, 0, 0, 0), None, "inf"),
        (_value(PointType.BCD16, 0x1234), 1234, "1234"),
        (_value(PointType.BCD16, 0x0275, scale=0.1, unit="degC"), 27.5, "27.5 degC"),
        (_value(PointType.BCD16, 0x12A4), None, "12A4H, which is not BCD"),
        (_value(PointType.BCD32, 0x0012, 0x3456), 123456, "123456"),
        (_value(PointType.BCD32, 0x3456, 0x0012, word_order=WordOrder.LOW_FIRST), 123456, "123456"),
        (_value(PointType.UINT16, 0x3412, byte_order=ByteOrder.LOW_FIRST), 0x1234, "4660"),
        (
            _value(PointType.UINT32, 0x3412, 0x7856, byte_order=ByteOrder.LOW_FIRST),
            0x12345678,
            "305419896",
        ),
        (
            _value(
                PointType.UINT32,
                0x7856,
                0x3412,
                byte_order=ByteOrder.LOW_FIRST,
                word_order=WordOrder.LOW_FIRST,
            ),
            0x12345678,
            "305419896",
        ),
        (_value(PointType.UINT16, 275, scale=0.1, offset=-50, unit="degC"), -22.5, "-22.5 degC"),
        (_value(PointType.INT16, 0xFFFF, offset=0.5), -0.5, "-0.5"),
        (_value(PointType.UINT16, 2500, scale=0.01, decimals=2, unit="bar"), 25.0, "25.00 bar"),
        (_value(PointType.UINT16, 5, decimals=1), 5, "5.0"),
        (_value(PointType.UINT16, 2999, scale=0.001, decimals=1), 2.999, "3.0"),
        (_value(PointType.UINT16, 7, texts={7: "run"}, scale=0.1, decimals=2), 0.7, "run"),
        (
            _value(PointType.INT64, 0x7FFF, 0xFFFF, 0xFFFF, 0xFFFF, scale=0.001),
            9223372036854775.807,
            "9.22337203685478e+15",
        ),
        (_value(PointType.STRING, 0x4654, 0x3141, 0x2020, length=3), None, "FT1A"),
        (
            _value(PointType.STRING, 0x5446, 0x4131, length=2, byte_order=ByteOrder.LOW_FIRST),
            None,
            "FT1A",
        ),
        (_value(PointType.STRING, 0x4100, 0x0042, 0x0000, length=3), None, "A\\x00\\x00B"),
        (_value(PointType.STRING, 0xFF1B, 0x0A41, length=2), None, "\\xff\\x1b\\x0aA"),
        (_value(PointType.STRING, 0xC2B0, 0x4300, length=2), None, "°C"),
        (_value(PointType.STRING, 0, 0, length=2), None, "(empty)"),
        (_value(PointType.FLAGS, 0b1001, bits={3: "ALARM", 0: "READY"}), 9, "READY, ALARM"),
        (_value(PointType.FLAGS, 0, bits={0: "READY"}), 0, "none"),
        (
            _value(PointType.FLAGS, 0x8101, bits={0: "READY"}),
            0x8101,
            "READY, unassigned bits 8100H",
        ),
        (
            _value(PointType.FLAGS, 0x0100, bits={0: "READY"}, byte_order=ByteOrder.LOW_FIRST),
            1,
            "READY",
        ),
        (_value(PointType.BIT, 1), 1, "on"),
        (_value(PointType.BIT, 0, texts={0: "disabled"}), 0, "disabled"),
    ],
)
def test_value_and_text_follow_from_the_type(
    value: PointValue, number: float | None, text: str
) -> None:
    assert (value.value, value.text) == (number, text)


@pytest.mark.parametrize(
    ("type_", "fields", "value", "raw"),
    [
        (PointType.BIT, {}, True, [1]),
        (PointType.UINT16, {}, 65535, [65535]),
        (PointType.INT16, {}, -1, [0xFFFF]),
        (PointType.INT16, {"scale": 0.1, "offset": -50.0}, -22.5, [275]),
        (PointType.UINT16, {"scale": 0.1}, 27.54, [275]),
        (PointType.UINT32, {"word_order": WordOrder.LOW_FIRST}, 0x12345678, [0x5678, 0x1234]),
        (PointType.UINT32, {"byte_order": ByteOrder.LOW_FIRST}, 0x12345678, [0x3412, 0x7856]),
        (PointType.INT64, {}, -2, [0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE]),
        (PointType.FLOAT32, {}, 3.14, [0x4048, 0xF5C3]),
        (PointType.FLOAT64, {}, math.pi, [0x4009, 0x21FB, 0x5444, 0x2D18]),
        (PointType.BCD16, {}, 275, [0x0275]),
        (PointType.BCD32, {}, 12345678, [0x1234, 0x5678]),
        (PointType.STRING, {"length": 3}, "FT1A", [0x4654, 0x3141, 0]),
        (PointType.UINT16, {"texts": {7: "run"}}, "run", [7]),
        (PointType.FLAGS, {"bits": {0: "READY"}}, 9, [9]),
        (PointType.OCTETS, {}, 0x03FA, [0x03FA]),
    ],
)
def test_value_is_put_into_registers(
    type_: PointType, fields: dict[str, Any], value: float | str, raw: list[int]
) -> None:
    assert registers_of(_point(type_, **fields), value) == raw


@pytest.mark.parametrize(
    ("type_", "fields", "value", "problem"),
    [
        (PointType.BIT, {}, 2, "2: a bit is 0 or 1"),
        (PointType.UINT16, {}, -1, "-1 does not fit uint16, which holds 0..65535"),
        (PointType.UINT16, {}, 2.5, "2.5 does not fit uint16, which holds 0..65535"),
        (PointType.UINT16, {}, float("nan"), "nan does not fit uint16, which holds 0..65535"),
        (PointType.UINT16, {"scale": 0.1}, 6553.6,
         "6553.6 does not fit uint16, which holds 0.0..6553.5"),
        (PointType.BCD16, {}, 10000, "10000 does not fit bcd16, which holds 0..9999"),
        (PointType.FLOAT32, {}, 1e39, "1e+39 is too large for float32"),
        (PointType.STRING, {"length": 2}, "FT1A-",
         "'FT1A-' is too long: its 2 registers hold 4 bytes"),
        (PointType.STRING, {"length": 2}, 5, "5: expected a text of at most 4 bytes"),
        (PointType.UINT16, {}, "run", "'run': expected a number"),
        (PointType.UINT16, {"texts": {1: "on", 2: "off"}}, "run",
         "'run': expected a number or one of on, off"),
    ],
)  # fmt: skip
def test_value_that_does_not_fit_is_told(
    type_: PointType, fields: dict[str, Any], value: float | str, problem: str
) -> None:
    with pytest.raises(UsageError) as caught:
        registers_of(_point(type_, **fields), value)
    assert str(caught.value) == problem


_WHOLE = [type_ for type_ in PointType if type_.whole_numbers is not None]
_ORDERS = {"word_order": st.sampled_from(WordOrder), "byte_order": st.sampled_from(ByteOrder)}


@given(st.sampled_from(_WHOLE), st.fixed_dictionaries(_ORDERS), st.data())
def test_every_whole_number_is_read_back(
    type_: PointType, orders: dict[str, Any], data: st.DataObject
) -> None:
    allowed = type_.whole_numbers
    assert allowed is not None
    number = data.draw(st.integers(allowed[0], allowed[-1]))
    point = _point(type_, **orders)
    assert _value(type_, *registers_of(point, number), **orders).value == number


@given(
    st.sampled_from([type_ for type_ in _WHOLE if type_.words < 4]),
    st.sampled_from([0.1, 0.25, 0.001, 10.0, -0.5, 1e-6]),
    st.sampled_from([0.0, -50.0, 0.1, 1000.0]),
    st.data(),
)
def test_scaled_values_come_back_to_the_same_registers(
    type_: PointType, scale: float, offset: float, data: st.DataObject
) -> None:
    allowed = type_.whole_numbers
    assert allowed is not None
    raw = registers_of(_point(type_), data.draw(st.integers(allowed[0], allowed[-1])))
    value = _value(type_, *raw, scale=scale, offset=offset).value
    assert value is not None
    assert registers_of(_point(type_, scale=scale, offset=offset), value) == raw


@given(st.floats(allow_nan=False, allow_infinity=False), st.fixed_dictionaries(_ORDERS))
def test_every_float64_is_read_back(number: float, orders: dict[str, Any]) -> None:
    raw = registers_of(_point(PointType.FLOAT64, **orders), number)
    assert _value(PointType.FLOAT64, *raw, **orders).value == number


@given(
    st.text(st.characters(categories=("L", "N", "P")), min_size=1, max_size=10),
    st.sampled_from(ByteOrder),
)
def test_every_text_is_read_back(text: str, byte_order: ByteOrder) -> None:
    fields: dict[str, Any] = {"length": 20, "byte_order": byte_order}
    raw = registers_of(_point(PointType.STRING, **fields), text)
    assert _value(PointType.STRING, *raw, **fields).text == text


def test_point_instances_of_a_table_are_those_that_can_be_read_or_written() -> None:
    def point(name: str, address: int, access: Access | None) -> Point:
        return Point(
            name=name,
            table=Table.HOLDING_REGISTERS,
            address=address,
            access=access,
            type=PointType.UINT32,
        )

    profile = msgspec.structs.replace(
        load_profile("idec-ft1a-touch"),
        points=[
            point("speed", 4, None),
            point("status", 0, Access.READ),
            point("command", 0, Access.WRITE),
            point("serial", 2, Access.READ),
        ],
    )

    def names(*, writing: bool) -> list[tuple[str, str]]:
        places = point_instances(profile, Table.HOLDING_REGISTERS, writing=writing)
        return [(place.reference, place.name) for place in places]

    rest = [("HR400003..400004", "serial"), ("HR400005..400006", "speed")]
    assert names(writing=False) == [("HR400001..400002", "status"), *rest]
    assert names(writing=True) == [("HR400001..400002", "command"), *rest]


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


def test_each_point_of_a_series_has_its_own_name() -> None:
    several = Point(
        name="CH{n} at {reference}", table=Table.HOLDING_REGISTERS, address=8, count=4, stride=2
    )
    assert PointInstance(several, 12, "R12").name == "CH3 at R12"


@given(
    st.sampled_from(list(PointType)),
    st.lists(st.integers(-1, 0x10000), min_size=4, max_size=4),
    st.sampled_from(WordOrder),
    st.sampled_from(ByteOrder),
    st.sampled_from([0.1, 1.0, 3e300]),
)
def test_any_registers_have_a_text(
    type_: PointType, raw: list[int], words: WordOrder, byte_order: ByteOrder, scale: float
) -> None:
    size = type_.words or 4
    fields = {"word_order": words, "byte_order": byte_order, "scale": scale, "length": size}
    assert _value(type_, *raw[:size], **fields).text


@pytest.mark.parametrize(("scale", "most"), [(1.0, 0), (0.1, _MAX_CACHED)], ids=["plain", "scaled"])
def test_memory_is_bounded(scale: float, most: int) -> None:
    place = PointInstance(_point(PointType.UINT16, scale=scale), 0, "R0")
    for word in range(3 * _MAX_CACHED):
        assert place.value([word]).value == pytest.approx(word * scale)
    assert len(place._cache) <= most


@given(
    st.sampled_from(list(PointType)),
    st.lists(st.lists(st.integers(-1, 3) | WORDS, min_size=4, max_size=4), max_size=12),
    st.sampled_from([0.1, 1.0]),
)
def test_earlier_values_do_not_change_a_value(
    type_: PointType, readings: list[list[int]], scale: float
) -> None:
    size = type_.words or 4
    point = _point(type_, scale=scale, length=size)
    place = PointInstance(point, 0, "R0")
    for raw in readings:
        assert place.value(raw[:size]) == PointInstance(point, 0, "R0").value(raw[:size])


@given(
    st.sampled_from([PointType.UINT16, PointType.INT16]),
    st.sampled_from([1.0, 0.1, 0.01, 0.25, 3.0, 1 / 3, 2.5e-7, 1e10, -0.5]),
    st.sampled_from([0.0, -40.0, 0.5, 1e-3]),
    WORDS,
)
def test_the_fast_path_for_plain_numbers_gives_the_same(
    type_: PointType, scale: float, offset: float, word: int
) -> None:
    plain = _point(type_, scale=scale, offset=offset, unit="V")
    # Texts for what the register does not hold change nothing but the way.
    other = _point(type_, scale=scale, offset=offset, unit="V", texts={word ^ 1: "other"})
    assert PointInstance(plain, 0, "R0").value([word]) == PointInstance(other, 0, "R0").value(
        [word]
    )


@given(st.lists(WORDS, max_size=5), st.integers(0, 3), st.integers(0, 3))
def test_each_complete_point_of_a_range_has_its_own_value(
    words: list[int], first: int, second: int
) -> None:
    long = PointInstance(_point(PointType.UINT32), 0, "R0")
    short = PointInstance(_point(PointType.INT16), 0, "R1")
    said = point_values([(first, long), (second, short)], words)
    assert said == [
        *([long.value(words[first : first + 2])] if first + 2 <= len(words) else []),
        *([short.value([words[second]])] if second < len(words) else []),
    ]


def test_value_a_little_below_zero_is_not_minus_zero() -> None:
    point = Point(
        name="Flow",
        table=Table.HOLDING_REGISTERS,
        address=0,
        type=PointType.FLOAT32,
        decimals=2,
        unit="l/h",
    )
    registers = [int.from_bytes(part) for part in _halves(struct.pack(">f", -0.004))]
    assert PointInstance(point, 0, "").value(registers).text == "0.00 l/h"
    registers = [int.from_bytes(part) for part in _halves(struct.pack(">f", -0.006))]
    assert PointInstance(point, 0, "").value(registers).text == "-0.01 l/h"


def _halves(data: bytes) -> tuple[bytes, bytes]:
    return data[:2], data[2:]
