"""Judgements of what registers hold."""

from __future__ import annotations

import math
import random
import struct
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import Table
from mbtool.values.judging import IN_DOUBT, SURE, Judged, WordHistory, judge
from mbtool.values.reasons import ValueRole
from mbtool.values.word_readings import Order, WordReading
from tests.adversary.values.generator import on_the_wire
from tests.adversary.values.measuring import measure

if TYPE_CHECKING:
    from collections.abc import Sequence

START_NS = 1_790_000_000_000_000_000


def history(rows: Sequence[Sequence[int]], first: int = 100) -> WordHistory:
    times = [START_NS + at * 1_000_000_000 for at in range(len(rows))]
    return WordHistory(Table.HOLDING_REGISTERS, first, times, [tuple(row) for row in rows])


def judged(*rows: Sequence[int]) -> list[Judged]:
    return judge([history(rows)])


def floats(*values: float, order: Order = Order.ABCD) -> list[int]:
    return [word for one in values for word in on_the_wire(struct.pack(">f", one), order)]


def int32s(*values: int, order: Order = Order.ABCD) -> list[int]:
    return [word for one in values for word in on_the_wire(struct.pack(">i", one), order)]


@pytest.mark.parametrize("order", list(Order))
def test_noisy_floats_are_known_in_every_order(order: Order) -> None:
    rng = random.Random(1)
    rows = [floats(230 + rng.gauss(0, 1), 50 + rng.gauss(0, 0.01), order=order) for _ in range(30)]
    found = judged(*rows)
    assert [(one.address, one.reading) for one in found] == [
        (100, WordReading(PointType.FLOAT32, order)),
        (102, WordReading(PointType.FLOAT32, order)),
    ]
    assert all(one.is_sure for one in found)


@pytest.mark.parametrize("order", list(Order))
def test_a_counter_is_known_by_its_carry(order: Order) -> None:
    rows = [int32s(7 * 65536 + 64_000 + 311 * at, order=order) for at in range(30)]
    (found,) = judged(*rows)
    assert (found.reading, found.role) == (
        WordReading(PointType.UINT32, order),
        ValueRole.COUNTER,
    )
    assert "one register goes up or down by one when the other starts again" in found.reason


def test_a_register_that_is_the_sign_of_another_makes_a_number_of_two() -> None:
    rng = random.Random(2)
    rows = [int32s(round(rng.gauss(0, 900)), -1486 + at % 5, order=Order.CDAB) for at in range(20)]
    found = judged(*rows)
    assert [one.reading for one in found] == [WordReading(PointType.INT32, Order.CDAB)] * 2
    assert "the last register is 0 or FFFFH, as the sign of the others" in found[0].reason


def test_two_small_numbers_are_two() -> None:
    rng = random.Random(3)
    rows = [[1200 + round(rng.gauss(0, 60)), 300 + round(rng.gauss(0, 9))] for _ in range(30)]
    assert [one.reading for one in judged(*rows)] == [WordReading(PointType.UINT16)] * 2


def test_a_number_that_moves_beside_a_zero_is_never_sure() -> None:
    # It looks exactly like a 32-bit number whose high word never moves.
    for row in ((0, 1000), (1000, 0)):
        rows = [[word + 7 * at if word else 0 for word in row] for at in range(30)]
        assert all(one.likelihood <= IN_DOUBT < SURE for one in judged(*rows))


def test_neighbours_with_a_sign_vouch_for_those_without() -> None:
    rng = random.Random(4)
    rows = [
        int32s(round(rng.gauss(0, 900)), 2370 + at % 7, -rng.randint(400, 500), 4100 + at % 3)
        for at in range(20)
    ]
    found = judged(*rows)
    assert [one.reading.type for one in found] == [PointType.INT32] * 4
    assert all(one.is_sure for one in found[1:3])


def test_a_request_that_ends_inside_a_value_speaks_against_it() -> None:
    rows = [(0x4366, 0x199A, 5), (0x4366, 0x1AE1, 6)]
    one, _ = judge([history(rows)])
    assert one.reading.type is PointType.FLOAT32
    parts = judge([history(rows), history([(0x4366,)]), history([(0x199A,)], 101)])
    assert len(parts) == 3


def test_a_number_that_goes_below_zero_is_signed() -> None:
    (one,) = judged([3], [0], [0xFFFE], [0xFFFD], [1])
    assert (one.reading.type, one.reason) == (PointType.INT16, "-3 to 3: goes below zero")


def test_a_text_is_known_by_its_letters_and_has_its_padding() -> None:
    words = [*struct.unpack(">5H", b"PUMP-7 A4\0"), 0, 0, 12]
    text, behind = judged(words, words)
    assert (text.reading.type, text.words, text.reason) == (
        PointType.STRING, 7, 'the text "PUMP-7 A4"',
    )  # fmt: skip
    assert behind.address == 107


def test_digits_of_four_bits_are_known_when_they_carry() -> None:
    rows = [[int(f"{1895 + at // 2:04d}", 16)] for at in range(60)]
    (one,) = judged(*rows)
    assert one.reading.type is PointType.BCD16
    assert one.reason == "1895 to 1924 in decimal digits of four bits each"


def test_bits_that_change_one_by_one_are_flags() -> None:
    words = [0x0180, 0x0180, 0x2180, 0x2180, 0x2100, 0x2100, 0x2100, 0x2140, 0x0140, 0x0140]
    (one,) = judged(*([word] for word in words))
    assert (one.reading.type, one.role) == (PointType.HEX16, ValueRole.FLAGS)
    assert one.reason == "bits 6, 7, 13 change one by one in 10 answers"


def test_the_clock_of_the_device_is_known_by_the_time_of_the_recording() -> None:
    rows = [int32s(START_NS // 1_000_000_000 + 3600 + at) for at in range(20)]
    (one,) = judged(*rows)
    assert (one.reading.type, one.role) == (PointType.UINT32, ValueRole.CLOCK)


def test_a_number_of_64_bits_is_known() -> None:
    rng = random.Random(5)
    rows = [struct.unpack(">4H", struct.pack(">d", 400 + rng.gauss(0, 2))) for _ in range(30)]
    (one,) = judged(*rows)
    assert one.reading == WordReading(PointType.FLOAT64)


def test_reasons_of_plain_numbers_say_what_was_seen() -> None:
    assert [one.reason for one in judged([0, 7], [1, 7], [2, 7])] == [
        "0, 1, 2 in 3 answers",
        "7 in all 3 answers",
    ]
    assert judged([0x8000])[0].reason == (
        "32768 in the only one of the answers (8000H, which often says that there is no value)"
    )
    assert judged(*([10 + 8 * at] for at in range(10)))[0].reason == (
        "10 to 82 in 10 answers: counts up"
    )


def test_generated_devices_are_judged_as_well_as_promised() -> None:
    found = measure([f"a fixed seed {number}" for number in range(20)])
    assert found.known_right >= 0.95 * found.known, found.wrong
    assert found.sure_wrong <= 0.01 * found.judged, found.wrong


@given(
    st.integers(1, 9).flatmap(
        lambda width: st.lists(
            st.lists(st.integers(0, 0xFFFF), min_size=width, max_size=width),
            min_size=1,
            max_size=8,
        )
    ),
    st.lists(st.tuples(st.integers(100, 112), st.integers(1, 5)), max_size=3),
)
def test_every_register_is_in_one_value(
    rows: list[list[int]], others: list[tuple[int, int]]
) -> None:
    more = [history([[0] * width], first) for first, width in others]
    found = judge([history(rows), *more])
    places = [at for one in found for at in range(one.address, one.address + one.words)]
    asked = {100 + at for at in range(len(rows[0]))}
    asked |= {first + at for first, width in others for at in range(width)}
    assert places == sorted(asked)
    assert all(one.reason and 0 <= one.likelihood <= 1 for one in found)
    assert not any(math.isnan(one.likelihood) for one in found)


def test_a_register_that_alternates_between_two_numbers_is_no_bcd() -> None:
    (one,) = judged(*([0x0064 if at % 2 else 0x0258] for at in range(20)))
    assert one.reading.type is PointType.UINT16


def test_one_constant_float_of_many_digits_is_never_sure() -> None:
    # It may be a half of a number of 64 bits.
    found = judged([0xC51F, 0xD117, 0xB2FB, 0xB64E], [0xC51F, 0xD117, 0xB2FB, 0xB64E])
    assert not any(one.is_sure for one in found)
