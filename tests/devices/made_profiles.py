"""Profiles that hypothesis makes: any that a user's file could say."""

from __future__ import annotations

from typing import Any

import msgspec
from hypothesis import strategies as st

from mbtool.devices.model import (
    Access,
    AnswerWord,
    Area,
    BehaviourName,
    Exceptions,
    FunctionRule,
    Point,
    Profile,
    Radix,
    Timing,
)
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.adu import Transport
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import Table

TEXT = st.text(
    st.characters(exclude_categories=["Cs", "Cc", "Zl", "Zp"], exclude_characters="{"), max_size=30
)
PROSE = st.text(st.characters(exclude_categories=["Cs", "Cc"], include_characters="\n\t"))
PREFIXES = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,12}", fullmatch=True)
SHORT_SILENCES = st.none() | st.sampled_from(["15bits", "1.5chars", "750us"])
SILENCES = st.none() | st.sampled_from(["28bits", "3.5chars", "5ms", "1750us", "0.875 ms"])
AREA_ADDRESSES = 1000


@st.composite
def profiles(draw: st.DrawFn) -> Profile:
    # One behind the other, so that none overlap, each with a name of its own.
    areas = [
        Area(
            **fields,
            name=f"{fields['prefix']} {index}",
            first=index * AREA_ADDRESSES,
            last=index * AREA_ADDRESSES + draw(st.integers(200, AREA_ADDRESSES - 1)),
        )
        for index, fields in enumerate(draw(st.lists(_areas(), max_size=4)))
    ]
    return Profile(
        name=draw(PREFIXES),
        title=draw(TEXT),
        vendor=draw(TEXT),
        transports=[Transport.ASCII, *draw(st.lists(st.sampled_from(Transport)))],
        source=draw(TEXT),
        areas=areas,
        functions=draw(
            st.dictionaries(st.integers(1, 0x7F), _rules()).map(
                lambda rules: {f"{code:02X}": _fitting(code, rule) for code, rule in rules.items()}
            )
        ),
        exceptions=draw(_exceptions()),
        timing=Timing(
            t1_5=draw(SHORT_SILENCES), t3_5=draw(SILENCES), request_interval=draw(SILENCES)
        ),
        points=[point for area in areas for point in draw(_points(area))],
        behaviour=draw(st.none() | st.sampled_from(BehaviourName)),
        finding_prefix=draw(st.none() | PREFIXES),
        model_code=draw(st.none() | st.integers(0, 0xFFFF)),
        last_unit=draw(st.none() | st.integers(1, 255)),
        any_unit=draw(st.booleans()),
        notes=draw(st.lists(PROSE, max_size=3)),
    )


def _areas() -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(
        {
            "table": st.sampled_from([Table.COILS, Table.HOLDING_REGISTERS]),
            "access": st.sampled_from(Access),
            "prefix": TEXT,
            "base": st.integers(0, 1_000_000),
            "radix": st.sampled_from(Radix),
            "width": st.integers(0, 8),
            "suffix": TEXT,
        }
    )


def _fitting(code: int, rule: FunctionRule) -> FunctionRule:
    """Only what has a quantity has limits."""
    known = FUNCTIONS.get(code)
    if known is not None and known.table is not None:
        limit = 9 if code == 0x17 else None
        return msgspec.structs.replace(rule, write_limit=limit)
    return msgspec.structs.replace(rule, limit=None, ascii_limit=None)


def _rules() -> st.SearchStrategy[FunctionRule]:
    answers = st.builds(AnswerWord, name=TEXT, texts=_texts(0, 0xFFFF))
    return st.builds(
        FunctionRule,
        limit=st.none() | st.just(1),
        ascii_limit=st.none() | st.just(1),
        data=st.none() | st.sampled_from(["00", "0000", "fF01"]),
        title=st.none() | TEXT,
        answer=st.none() | answers,
    ) | st.builds(FunctionRule, answers=st.just(False))


@st.composite
def _exceptions(draw: st.DrawFn) -> Exceptions:
    texts = draw(_texts(1, 0xFF))
    used = [draw(st.integers(1, 0xFF)) for _ in range(3)]
    return Exceptions(
        function=used[0],
        address=used[1],
        value=used[2],
        documented=[*used, *texts],
        texts=texts,
    )


def _texts(low: int, high: int, least: int = 0) -> st.SearchStrategy[dict[int, str]]:
    return st.dictionaries(st.integers(low, high), TEXT, min_size=least, max_size=6)


@st.composite
def _points(draw: st.DrawFn, area: Area) -> list[Point]:
    points: list[Point] = []
    at = area.first
    for index in range(draw(st.integers(0, 3))):
        kinds = [PointType.BIT] if area.table.is_bits else list(PointType)[1:]
        type_ = draw(st.sampled_from(kinds))
        fields = draw(_values(type_))
        words = type_.words or fields.get("length", 1)
        count, stride = draw(st.integers(1, 4)), words + draw(st.integers(0, 2))
        access = [None, area.access] if area.access is not Access.READ_WRITE else list(Access)
        points.append(
            Point(
                name=f"{draw(TEXT)} {area.name} {index} {'{n}' if count > 1 else ''}",
                table=area.table,
                address=at,
                type=type_,
                count=count,
                stride=stride if count > 1 else 1,
                counted_from=draw(st.integers(-9, 99)) if count > 1 else 1,
                access=draw(st.sampled_from(access)),
                block=draw(st.none() | st.integers(area.first, at)),
                unit=draw(st.none() | TEXT),
                note=draw(st.none() | PROSE),
                **fields,
            )
        )
        at += count * stride
    return points


@st.composite
def _values(draw: st.DrawFn, type_: PointType) -> dict[str, Any]:
    """What a point of one type says of its value."""
    fields: dict[str, Any] = {"channel": draw(TEXT), "first_channel": draw(st.integers(0, 9))}
    finite = st.floats(allow_nan=False, allow_infinity=False)
    numbers = type_.whole_numbers
    if type_ is PointType.STRING:
        fields["length"] = draw(st.integers(1, 12))
    elif type_ is not PointType.BIT:
        orders = list(WordOrder) if type_.words > 1 else [WordOrder.HIGH_FIRST]
        fields["word_order"] = draw(st.sampled_from(orders))
        fields["byte_order"] = draw(st.sampled_from(ByteOrder))
    if type_.is_number:
        fields["scale"] = draw(finite.filter(bool))
        fields["offset"] = draw(finite)
        fields["decimals"] = draw(st.none() | st.integers(0, 15))
        ends = sorted(draw(st.lists(finite | st.integers(-(2**31), 2**31), min_size=2, max_size=2)))
        fields["minimum"], fields["maximum"] = ends
    elif type_.words == 1:
        highest = 1 if type_ is PointType.BIT else 0xFFFF
        fields["default"] = draw(st.none() | st.integers(0, highest))
    if numbers is not None:
        fields["no_value"] = draw(st.none() | st.integers(numbers[0], min(numbers[-1], 2**63 - 1)))
        fields["texts"] = draw(_texts(numbers[0], numbers[-1]))
    elif type_ is PointType.HEX16:
        fields["texts"] = draw(_texts(0, 0xFFFF))
    elif type_ is PointType.FLAGS:
        fields["bits"] = draw(_texts(0, 15, least=1))
    elif type_.channel_bits:
        fields["channels"] = draw(st.none() | st.integers(1, 16 // type_.channel_bits))
        fields["texts"] = draw(_texts(0, (1 << type_.channel_bits) - 1))
    return fields
