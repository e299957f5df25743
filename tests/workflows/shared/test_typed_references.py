"""References with a type."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.devices import (
    Assignment,
    Assignments,
    ByteOrder,
    Namer,
    PointType,
    Who,
    WordOrder,
    load_profile,
)
from mbtool.workflows.shared.questions import Wording
from mbtool.workflows.shared.typed_references import typed_points, typed_references, with_points
from tests.devices.transactions import transaction

FT1A = load_profile("idec-ft1a-touch")


@pytest.mark.parametrize(
    ("text", "address", "type_", "words", "bytes_"),
    [
        ("hr10:f32cdab", 10, "float32", "low-first", "high-first"),
        ("holding 10:u32", 10, "uint32", "high-first", "high-first"),
        ("40011:i32dcba", 10, "int32", "low-first", "low-first"),
        ("400011:f64badc", 10, "float64", "high-first", "low-first"),
        ("hr 0x10:uint16", 16, "uint16", "high-first", "high-first"),
        ("hr10:bcd32", 10, "bcd32", "high-first", "high-first"),
        ("hr10:float32 CDAB", 10, "float32", "low-first", "high-first"),
        ("hr10:hex", 10, "hex16", "high-first", "high-first"),
    ],
)
def test_a_type_and_an_order_are_read(
    text: str, address: int, type_: str, words: str, bytes_: str
) -> None:
    (point,) = typed_points([text])
    assert (point.address, point.type) == (address, PointType(type_))
    assert (point.word_order, point.byte_order) == (WordOrder(words), ByteOrder(bytes_))


def test_a_range_is_as_many_values_as_fit() -> None:
    assert [(one.name, one.address) for one in typed_points(["hr10..15:f32", "T=ir0..1:i16"])] == [
        ("HR10", 10),
        ("HR12", 12),
        ("HR14", 14),
        ("T 1", 0),
        ("T 2", 1),
    ]
    (text,) = typed_points(["hr20:str8"])
    assert (text.type, text.length) == (PointType.STRING, 4)


def test_texts_to_read_and_to_write_lose_their_types() -> None:
    plain, profile = typed_references(["hr10:f32cdab", "hr 20..23:i32", "coil 3"], None)
    assert plain == ["HR10", "holding 20..23", "coil 3"]
    wording = Wording(profile)
    assert [pdu.hex() for text in plain for pdu in wording.reads(text)] == [
        "03000a0002",
        "0300140004",
        "0100030001",
    ]
    plain, profile = typed_references(["hr10=23.4:f32cdab"], None, writes=True)
    assert Wording(profile).write(plain[0]).hex() == "10000a000204333341bb"


def test_typed_registers_get_their_numbers_and_break_no_rule() -> None:
    profile = with_points(None, typed_points(["Flow=hr11:f32cdab"]))
    namer = Namer(Assignments([Assignment(Who(), profile)]))
    named = namer.name(transaction(3, 10, quantity=3, response_values=[7, 0x3333, 0x41BB]))
    assert [(point.name, point.text) for point in named.points] == [("HR10", "7"), ("Flow", "23.4")]
    assert (named.device, named.reference, named.findings) == (None, "holding 10..12", [])


def test_a_type_takes_the_place_of_the_points_of_a_profile() -> None:
    plain, profile = typed_references(["HR400011:f32"], FT1A)
    assert plain == ["HR10"]
    assert profile is not None
    assert profile.has_rules
    assert [one.type for one in profile.points if 10 in one.all_addresses][-1] == "float32"


def test_without_types_nothing_changes() -> None:
    assert typed_references(["hr:10", "holding 0..9"], None) == (["hr:10", "holding 0..9"], None)
    assert typed_references(["HR400001"], FT1A)[1] is FT1A


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("hr10:f33", "is no type; write u16"),
        ("hr10..12:f32", "3 registers are no whole number of 2 each"),
        ("hr65535:u32", "would end after register 65535"),
        ("coil 3:u16", "a coil or discrete input has no type"),
        ("nothing:u16", "is no range of registers"),
        ("hr10:str0", "is no type"),
        ("hr10", "write REFERENCE:TYPE"),
        ("hr10:f32abdc", "ABDC is no order; write ABCD"),
        ("hr10:float32bacd", "BACD is no order; write ABCD .* behind float32"),
        ("hr10:u16cdab", "uint16 has one register"),
        ("hr10:scan", "'scan' is no type; write u16"),
    ],
)
def test_a_wrong_type_is_one_clear_line(text: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        typed_points([text])


def test_one_register_has_one_type() -> None:
    with pytest.raises(UsageError, match="has two types"):
        typed_references(["hr10:f32", "hr11:u16"], None)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("hr40=1,5:f32", "a type is that of one value"),
        ("hr10:f32cdab=23.4", "write the value before the type: hr10=23.4:f32cdab"),
    ],
)
def test_a_typed_write_of_a_wrong_form_is_refused(text: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        typed_references([text], None, writes=True)
