"""Guesses at what registers hold."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.drafting.guesses import Guess, guess_registers
from mbtool.devices.observed_slave import Samples
from mbtool.devices.point_types import PointType, WordOrder

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence


def guesses(*rows: Sequence[int], twos: Collection[int] = ()) -> list[Guess]:
    samples = Samples()
    for row in rows:
        samples.add(row)
    return guess_registers(100, samples, twos)


def floats(*values: float, low_first: bool = False) -> list[int]:
    words: list[int] = []
    for value in values:
        pair = struct.unpack(">HH", struct.pack(">f", value))
        words += pair[::-1] if low_first else pair
    return words


def test_small_numbers_are_numbers() -> None:
    found = guesses([0, 7, 1234], [1, 7, 1230], [2, 7, 1236])
    assert {one.type for one in found} == {PointType.UINT16}
    assert [one.reason for one in found] == [
        "0, 1, 2 in 3 answers",
        "7 in all 3 answers",
        "1230, 1234, 1236 in 3 answers",
    ]


def test_floats_of_few_digits_are_known_in_either_order() -> None:
    for low_first in (False, True):
        found = guesses(
            floats(230.1, 49.98, low_first=low_first), floats(229.8, 50.01, low_first=low_first)
        )
        order = WordOrder.LOW_FIRST if low_first else WordOrder.HIGH_FIRST
        assert [(one.address, one.type, one.word_order) for one in found] == [
            (100, PointType.FLOAT32, order),
            (102, PointType.FLOAT32, order),
        ]
        assert found[0].reason == "as a float 229.8 to 230.1, of few digits"


def test_a_float_that_moves_is_known_by_its_low_word() -> None:
    values = [21.0 + 0.0137731 * step for step in range(12)]
    (found,) = guesses(*(floats(value) for value in values))
    assert found.type is PointType.FLOAT32
    assert "the low word changes more often" in found.reason


def test_a_float_beside_another_is_one() -> None:
    (first, second) = guesses(floats(50.0, 0.2112345))
    assert (first.type, second.type) == (PointType.FLOAT32, PointType.FLOAT32)
    assert second.reason == "as a float 0.21123, beside another float"


def test_two_registers_that_are_requested_alone_are_one_value() -> None:
    (high,) = guesses([0, 500], [0, 510], twos=[100])
    (low,) = guesses([500, 0], [510, 0], twos=[100])
    (negative,) = guesses([0xFFFF, 0xFFF0], [0, 5], twos=[100])
    (unknown,) = guesses([3, 5], twos=[100])
    assert (high.type, high.word_order) == (PointType.UINT32, WordOrder.HIGH_FIRST)
    assert (low.type, low.word_order) == (PointType.UINT32, WordOrder.LOW_FIRST)
    assert negative.type is PointType.INT32
    assert unknown.reason == "asked for as two registers: last 196613, or low word first 327683"


def test_a_counter_of_two_registers_is_known_by_its_carry() -> None:
    rows = [[7, 65_000 + 100 * step] for step in range(6)]
    rows += [[8, 30 + 100 * step] for step in range(6)]
    (found,) = guesses(*rows)
    (turned,) = guesses(*(row[::-1] for row in rows))
    assert (found.type, found.word_order) == (PointType.UINT32, WordOrder.HIGH_FIRST)
    assert turned.word_order is WordOrder.LOW_FIRST


def test_a_number_that_goes_below_zero_is_signed() -> None:
    (found,) = guesses([3], [0], [0xFFFE], [0xFFFD])
    assert (found.type, found.reason) == (PointType.INT16, "-3 to 3: goes below zero")
    (unavailable,) = guesses([3], [0xFFFF])
    assert unavailable.type is PointType.UINT16


def test_a_text_is_known_by_its_letters() -> None:
    words = [*struct.unpack(">5H", b"PUMP-7 A4\0"), 0, 0, 12]
    (text, behind) = guesses(words, words)
    assert (text.type, text.length, text.reason) == (
        PointType.STRING, 7, 'the text "PUMP-7 A4"',
    )  # fmt: skip
    assert behind.address == 107


def test_counters_and_missing_values_are_mentioned() -> None:
    counter = [[value] for value in range(10, 90, 8)]
    assert guesses(*counter)[0].reason == "10 to 82 in 10 answers: counts up"
    assert guesses([0x8000])[0].reason == (
        "32768 in the only one of the answers (8000H, which often says that there is no value)"
    )


@given(
    st.integers(1, 12).flatmap(
        lambda width: st.lists(
            st.lists(st.integers(0, 0xFFFF), min_size=width, max_size=width),
            min_size=1,
            max_size=8,
        )
    ),
    st.sets(st.integers(100, 112)),
)
def test_every_register_is_in_one_guess(rows: list[list[int]], twos: set[int]) -> None:
    found = guesses(*rows, twos=twos)
    places = [at for one in found for at in range(one.address, one.address + one.words)]
    assert places == list(range(100, 100 + len(rows[0])))
    assert all(one.reason for one in found)
