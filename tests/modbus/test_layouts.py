"""The building blocks of the function table."""

from __future__ import annotations

import pytest

from mbtool.modbus.layouts import (
    NO_LENGTH,
    Bits,
    Bytes,
    Choice,
    CoilValue,
    Layout,
    Registers,
    UncountedRegisters,
    Value,
)

FIXED = Layout(("first", 1), ("second", 2))
COUNTED = Layout(("quantity", 2), tail=Registers(quantity="quantity"))


def test_fixed_fields_are_read_in_order() -> None:
    fields: dict[str, Value] = {"first": 1, "second": 0x203}
    assert FIXED.parse(b"\x55\x01\x02\x03") == (fields, None)
    assert FIXED.encode(fields) == b"\x01\x02\x03"
    assert FIXED.length(b"\x55") == 4


@pytest.mark.parametrize(
    ("pdu", "fields"),
    [("55", {}), ("55 01", {"first": 1}), ("55 01 02", {"first": 1})],
)
def test_short_pdu_keeps_the_fields_that_are_whole(pdu: str, fields: dict[str, Value]) -> None:
    held, problem = FIXED.parse(bytes.fromhex(pdu))
    assert held == fields
    assert problem == f"{len(bytes.fromhex(pdu))} bytes, where its function has 4"


def test_long_pdu_keeps_its_fields() -> None:
    fields, problem = FIXED.parse(b"\x55\x01\x02\x03\x04")
    assert fields == {"first": 1, "second": 0x203}
    assert problem == "5 bytes, where its function has 4"


def test_error_for_short_fixed_fields_says_that_more_may_follow() -> None:
    assert COUNTED.parse(b"\x55\x00")[1] == "2 bytes, where its function has at least 3"


@pytest.mark.parametrize(
    ("pdu", "values", "problem"),
    [
        ("55 0001 02 1234", (0x1234,), None),
        ("55 0001", (), "its byte count is missing"),
        ("55 0001 02", (), "byte count 2, but 0 bytes follow"),
        ("55 0001 02 1234 56", (0x1234,), "byte count 2, but 3 bytes follow"),
        ("55 0001 03 1234 56", (0x1234,), "an odd number of bytes for registers"),
        ("55 0002 02 1234", (0x1234,), "1 registers for a quantity of 2"),
    ],
)
def test_registers_are_kept_and_their_faults_named(
    pdu: str, values: tuple[int, ...], problem: str | None
) -> None:
    fields, told = COUNTED.parse(bytes.fromhex(pdu))
    assert fields["values"] == values
    assert told == problem


def test_bits_beyond_their_quantity_are_padding() -> None:
    layout = Layout(("quantity", 2), tail=Bits(quantity="quantity"))
    assert layout.parse(b"\x55\x00\x03\x01\xff") == ({"quantity": 3, "values": (1, 1, 1)}, None)
    assert layout.parse(b"\x55\x00\x09\x01\xff")[1] == "1 bytes of bits for a quantity of 9"


def test_bits_without_a_quantity_are_all_kept() -> None:
    fields, problem = Layout(tail=Bits()).parse(b"\x55\x01\x05")
    assert (fields, problem) == ({"values": (1, 0, 1, 0, 0, 0, 0, 0)}, None)


def test_uncounted_bytes_have_no_length() -> None:
    layout = Layout(tail=Bytes(count_width=0))
    assert layout.length(b"\x55\x01\x02") == NO_LENGTH
    assert layout.parse(b"\x55\x01\x02") == ({"data": b"\x01\x02"}, None)


def test_length_needs_the_byte_count() -> None:
    assert COUNTED.length(b"\x55\x00\x01") is None
    assert COUNTED.length(b"\x55\x00\x01\x04") == 8


def test_uncounted_registers_are_all_remaining_words_and_at_least_one() -> None:
    layout = Layout(tail=UncountedRegisters())
    assert layout.parse(b"\x08\x00\x01\x00\x02") == ({"values": (1, 2)}, None)
    assert layout.parse(b"\x08")[1] == "its data is missing"
    assert layout.parse(b"\x08\x00")[1] == "an odd number of bytes for registers"


def test_coil_value_is_on_or_off() -> None:
    layout = Layout(("address", 2), tail=CoilValue())
    assert layout.parse(bytes.fromhex("05 0001 FF00")) == ({"address": 1, "value": 0xFF00}, None)
    for pdu, problem in (
        ("05 0001 1234", "value 1234H for a coil"),
        ("05 0001", "its value is missing"),
        ("05 0001 FF00 00", "6 bytes, where its function has 5"),
    ):
        assert layout.parse(bytes.fromhex(pdu))[1] == problem


def test_choice_keeps_data_of_unknown_types_as_bytes() -> None:
    layout = Layout(tail=Choice("kind", {1: Layout(("value", 2))}))
    assert layout.parse(b"\x2b\x01\x00\x05") == ({"kind": 1, "value": 5}, None)
    assert layout.parse(b"\x2b\x02\x00\x05") == ({"kind": 2, "data": b"\x00\x05"}, None)
    assert layout.parse(b"\x2b") == ({}, "1 bytes, where its function has more")
    assert (layout.length(b"\x2b"), layout.length(b"\x2b\x01"), layout.length(b"\x2b\x02")) == (
        None, 4, NO_LENGTH,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("layout", "fields", "problem"),
    [
        (FIXED, {"first": 1}, "'second' is missing"),
        (FIXED, {"first": 256, "second": 0}, "does not fit its width"),
        (FIXED, {"first": b"1", "second": 0}, "does not fit its width"),
        (Layout(tail=Registers()), {}, "'values' is missing"),
        (Layout(tail=Registers()), {"values": (b"x",)}, "must be a sequence of integers"),
        (Layout(tail=Registers()), {"values": 5}, "must be a sequence of integers"),
        (Layout(tail=Registers()), {"values": (70000,)}, r"0\.\.65535"),
        (Layout(tail=Registers()), {"values": (0,) * 128}, "do not fit a byte count"),
        (Layout(tail=Bits()), {"values": (2,)}, "bits are 0 or 1"),
        (Layout(tail=Bytes()), {}, "'data' is missing"),
        (Layout(tail=Bytes()), {"data": 5}, "must be bytes"),
        (Layout(tail=UncountedRegisters()), {}, "'values' is missing"),
        (Layout(tail=CoilValue()), {"value": b""}, "must be an integer"),
        (Layout(tail=Choice("kind", {})), {"kind": b""}, "must be an integer"),
    ],
)
def test_fields_that_cannot_be_sent_are_refused(
    layout: Layout, fields: dict[str, Value], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        layout.encode(fields)


@pytest.mark.parametrize(("width", "most"), [(1, 255), (2, 65535)])
def test_data_are_as_long_as_their_byte_count_can_say(width: int, most: int) -> None:
    layout = Layout(tail=Bytes(count_width=width))
    for size in (0, 1, most - 1, most):
        pdu = b"\x55" + layout.encode({"data": bytes(size)})
        assert pdu == b"\x55" + size.to_bytes(width) + bytes(size)
        assert layout.parse(pdu) == ({"data": bytes(size)}, None)
        assert layout.length(pdu[: 1 + width]) == len(pdu)
        assert layout.length(pdu[:width]) is None
    with pytest.raises(ValueError, match=f"fit a byte count of {width} bytes"):
        layout.encode({"data": bytes(most + 1)})


def test_the_heads_are_the_integers_and_the_byte_count_with_their_widths() -> None:
    assert FIXED.heads == [("first", 1), ("second", 2)]
    assert COUNTED.heads == [("quantity", 2), ("byte_count", 1)]
    assert Layout(tail=Registers(count_width=2)).heads == [("byte_count", 2)]
    assert Layout(tail=Bits()).heads == [("byte_count", 1)]
    assert Layout(tail=Bytes(count_width=0)).heads == []
    assert Layout(("sub", 2), tail=UncountedRegisters()).heads == [("sub", 2)]


def test_a_short_pdu_keeps_each_field_that_it_has() -> None:
    layout = Layout(("a", 2), ("b", 1), ("c", 2))
    pdu = bytes.fromhex("55 0102 03 0405")
    kept = [len(layout.parse(pdu[:size])[0]) for size in range(1, 7)]
    assert kept == [0, 0, 1, 2, 2, 3]
    assert layout.parse(pdu[:5])[0] == {"a": 0x0102, "b": 3}


def test_a_choice_counts_its_own_byte() -> None:
    layout = Layout(("x", 1), tail=Choice("kind", {1: Layout(("value", 2)), 2: Layout()}))
    assert [layout.length(bytes((0x2B, 9, kind))) for kind in (1, 2, 3)] == [5, 3, NO_LENGTH]
    assert layout.parse(bytes((0x2B, 9, 2))) == ({"x": 9, "kind": 2}, None)
    assert layout.encode({"x": 9, "kind": 1, "value": 5}) == bytes((9, 1, 0, 5))
