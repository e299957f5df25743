from __future__ import annotations

from typing import Any

import pytest

from mbtool.core.errors import ProfileError
from mbtool.devices.model import Point
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.devices.validation import PartErrors, validate_point
from mbtool.modbus.tables import Table

HOLDING = Table.HOLDING_REGISTERS


def _point(name: str = "Speed", address: int = 3, **fields: Any) -> Point:
    return Point(**{"name": name, "table": HOLDING, "address": address, **fields})


def _flags(*bits: int, **fields: Any) -> Point:
    return _point(type=PointType.FLAGS, bits={bit: f"B{bit}" for bit in bits}, **fields)


@pytest.mark.parametrize(
    "point",
    [
        _point(),
        _point("{reference}", count=3, stride=4, type=PointType.INT64),
        _point(type=PointType.STRING, length=8, byte_order=ByteOrder.LOW_FIRST),
        _point(type=PointType.BCD32, scale=0.01, decimals=2, unit="m3", word_order="low-first"),
        _point(type=PointType.INT16, texts={-1: "none"}, offset=-50.0, minimum=-50.0, maximum=0.5),
        _point(scale=0.1, default=275, minimum=20, maximum=27.5),
        _point(type=PointType.INT16, default=0xFFFF, minimum=-1),
        _point(type=PointType.FLAGS, bits={0: "a", 15: "b"}, default=0x8000),
        _point(type=PointType.BIT_FIELD, texts={0: "on"}, channels=16),
        _point(type=PointType.BIT, table=Table.COILS, texts={0: "open"}, default=1),
    ],
)
def test_sound_point_passes(point: Point) -> None:
    validate_point(point, PartErrors("pump.toml", "points"))


@pytest.mark.parametrize(
    ("point", "key", "problem"),
    [
        (_point(type=PointType.BIT), "type", "uint16 would be right"),
        (_point(table=Table.COILS), "type", "bit would be right"),
        (_point("{n}", 0, count=2, type=PointType.INT32), "stride", "less than the 2"),
        (_point("{n}", 0, count=2, type=PointType.STRING, length=8), "stride", "less than the 8"),
        (_point("CH", 0, count=2), "name", "{n} or {reference}"),
        (_point("CH{x}"), "name", "only {n} and {reference}"),
        (_point(length=4), "length", "only a string has a length, not uint16"),
        (_point(type=PointType.STRING), "length", "how many registers the string takes"),
        (_point(type=PointType.STRING, length=2, word_order=WordOrder.LOW_FIRST), "word_order",
         "swap bytes by 'byte_order'"),
        (_point(scale=0.0), "scale", "scales nothing"),
        (_point(scale=float("inf")), "scale", "scales nothing"),
        (_point(offset=float("nan")), "offset", "nan is no number to add"),
        (_flags(0, scale=0.1), "scale", "only numbers have it, for example int16, not flags"),
        (_flags(0, offset=1.0), "offset", "not flags"),
        (_point(type=PointType.HEX16, decimals=1), "decimals", "not hex16"),
        (_flags(0, scale_from="SF"), "scale_from", "only numbers have it"),
        (_point(no_value=-1), "no_value", "-1 does not fit uint16, which holds 0..65535"),
        (_point(type=PointType.FLOAT32, no_value=0), "no_value", "not float32"),
        (_point(channels=4), "channels", "not uint16"),
        (_point(type=PointType.NIBBLE_FIELD, channels=5), "channels", "4 at most"),
        (_point(bits={0: "a"}), "bits", "only flags have named bits, not uint16"),
        (_flags(), "bits", "this key is missing; name the bits"),
        (_flags(0, 16), "bits", "a register has no bit 16, only 0 to 15"),
        (_flags(-1), "bits", "a register has no bit -1"),
        (_flags(0, texts={1: "x"}), "texts", "flags has no texts; 'bits' name them"),
        (_point(type=PointType.FLOAT32, texts={1: "x"}), "texts", "only whole numbers have"),
        (_point(type=PointType.INT16, texts={0xFFFF: "x"}), "texts",
         "65535 does not fit int16, which holds -32768..32767"),
        (_point(type=PointType.HEX16, texts={0x10000: "x"}), "texts", "holds 0..65535"),
        (_point(type=PointType.BIT_FIELD, texts={2: "x"}), "texts",
         "2 does not fit the 1 bit of each channel, which holds 0..1"),
        (_point(name=" "), "name", "is empty"),
        (_point(minimum=5, maximum=4), "minimum", "more than the maximum"),
        (_point(maximum=float("inf")), "maximum", "inf is no limit; leave the key out"),
        (_point(minimum=5, maximum=9, default=4), "default", "4 is less than the minimum, 5"),
        (_point(maximum=9, default=10), "default", "10 is more than the maximum, 9"),
        (_point(scale=0.1, maximum=20, default=210), "default",
         "210, a value of 21.0, is more than the maximum, 20"),
        (_point(type=PointType.BCD16, default=0x1A), "default", "0x001A is no bcd16"),
        (_point(type=PointType.FLOAT32, default=1), "default", "not the 2 of this"),
        (_point(table=Table.COILS, type=PointType.BIT, default=2), "default", "0 or 1"),
    ],
)  # fmt: skip
def test_point_that_cannot_be_is_refused(point: Point, key: str, problem: str) -> None:
    with pytest.raises(ProfileError) as caught:
        validate_point(point, PartErrors("pump.toml", f'points "{point.name}"'))
    assert caught.value.file == "pump.toml"
    assert caught.value.key == f'points "{point.name}".{key}'
    assert problem in caught.value.problem
