"""Registers in the formats that a user can choose."""

from __future__ import annotations

import pytest

from mbtool.watching.value_formats import ValueFormat, float_text, register_texts


@pytest.mark.parametrize(
    ("form", "texts"),
    [
        (ValueFormat.NAMED, ["1", "65535", "32768"]),
        (ValueFormat.DECIMAL, ["1", "65535", "32768"]),
        (ValueFormat.HEX, ["0001H", "FFFFH", "8000H"]),
        (ValueFormat.SIGNED, ["1", "-1", "-32768"]),
    ],
)
def test_each_register_in_a_format(form: ValueFormat, texts: list[str]) -> None:
    assert register_texts([1, 65535, 32768], form) == texts


@pytest.mark.parametrize(  # 12.5 is 41480000H.
    ("form", "first", "second"),
    [
        (ValueFormat.FLOAT_ABCD, 0x4148, 0x0000),
        (ValueFormat.FLOAT_CDAB, 0x0000, 0x4148),
        (ValueFormat.FLOAT_BADC, 0x4841, 0x0000),
        (ValueFormat.FLOAT_DCBA, 0x0000, 0x4841),
    ],
)
def test_a_float_in_each_word_order(form: ValueFormat, first: int, second: int) -> None:
    assert float_text(first, second, form) == "12.5"
    assert register_texts([first, second, 7], form) == ["12.5", "-"]


def test_word_orders_differ_in_every_byte() -> None:
    texts = {form: float_text(0x3F9D, 0xF3B6, form) for form in ValueFormat if form.is_float}
    assert texts[ValueFormat.FLOAT_ABCD] == "1.234"  # 3F9DF3B6H
    assert len(set(texts.values())) == 4


def test_a_pattern_that_is_no_number_is_told() -> None:
    assert float_text(0x7FC0, 0, ValueFormat.FLOAT_ABCD) == "nan"


def test_one_goes_through_all_formats() -> None:
    form = ValueFormat.NAMED
    seen = [form := form.next for _ in ValueFormat]
    assert set(seen) == set(ValueFormat)
