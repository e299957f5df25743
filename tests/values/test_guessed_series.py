"""Series of registers that are joined into series of numbers."""

from __future__ import annotations

import random
import struct

from mbtool.modbus.tables import Table
from mbtool.values.guessed_series import with_guesses
from mbtool.values.value_series import MAX_CHANGES, ValueSeries
from mbtool.values.values import RequestedSpan, SeriesKey
from mbtool.values.word_readings import Order
from tests.adversary.values.generator import on_the_wire

SECOND_NS = 1_000_000_000


def series_of(
    rows: list[list[int]], first: int = 10, word: str = "holding"
) -> dict[SeriesKey, ValueSeries]:
    found = {
        SeriesKey("line", 5, f"{word} {first + at}"): ValueSeries(f"{word} {first + at}")
        for at in range(len(rows[0]))
    }
    for at, row in enumerate(rows):
        for one, value in zip(found.values(), row, strict=True):
            one.add(at * SECOND_NS, value)
    return found


def float_rows(count: int) -> list[list[int]]:
    rng = random.Random(1)
    return [
        [3, *on_the_wire(struct.pack(">f", 230 + rng.gauss(0, 2)), Order.CDAB), 40 + at % 5]
        for at in range(count)
    ]


def test_two_registers_that_are_surely_one_number_are_one_series() -> None:
    rows = float_rows(40)
    found = with_guesses(series_of(rows))
    assert [key.name for key in found] == [
        "holding 10",
        "holding 11..12 float32 CDAB ?",
        "holding 13",
    ]
    joined = found[SeriesKey("line", 5, "holding 11..12 float32 CDAB ?")]
    assert joined.changes == 39
    assert all(200 < sample.value < 260 for sample in joined.samples)
    assert joined.samples[0].ts_ns == 0


def test_words_stay_where_nothing_is_sure() -> None:
    series = series_of([[0, 100 + at] for at in range(30)])
    assert with_guesses(series) == series
    assert with_guesses({}) == {}


def test_a_point_of_a_profile_and_a_bit_stay_as_they_are() -> None:
    named = series_of(float_rows(40), word="HR4000")
    assert with_guesses(named) == named


def test_a_series_that_was_thinned_out_is_not_joined() -> None:
    series = series_of(float_rows(MAX_CHANGES + 100))
    assert with_guesses(series).keys() == series.keys()


def test_a_request_for_one_of_the_registers_keeps_them_apart() -> None:
    rows = [[0x0008, 64_000 + 311 * at] if at < 5 else [0x0009, 19 + 311 * at] for at in range(9)]
    asked = [
        RequestedSpan("line", 5, Table.HOLDING_REGISTERS, range(at, at + 1)) for at in (10, 11)
    ]
    assert len(with_guesses(series_of(rows), asked)) == 2


def test_registers_stay_where_a_row_that_is_not_judged_holds_no_digits() -> None:
    digits = [f"{12_345_678 + 41 * at:08d}" for at in range(400)]
    rows = [[int(one[:4], 16), int(one[4:], 16)] for one in digits]
    (joined,) = with_guesses(series_of(rows))
    assert joined.name == "holding 10..11 bcd32 ABCD ?"
    rows[202][1] = 0xABCD  # Each third of 400 rows is judged.
    series = series_of(rows)
    assert with_guesses(series) == series
