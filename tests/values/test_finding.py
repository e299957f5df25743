"""Finding the registers that hold what a display shows."""

from __future__ import annotations

import random
import struct
from typing import TYPE_CHECKING

import pytest

from mbtool.devices.point_types import PointType
from mbtool.modbus.tables import Table
from mbtool.values.finding import (
    FoundPlace,
    Sighting,
    Wanted,
    WordsOfSlave,
    find,
    find_changed,
)
from mbtool.values.judging import WordHistory
from mbtool.values.word_readings import Order, WordReading
from tests.adversary.values.generator import on_the_wire

if TYPE_CHECKING:
    from collections.abc import Sequence

SECOND_NS = 1_000_000_000
START_NS = 1_790_000_000 * SECOND_NS


def words_of(
    rows: Sequence[Sequence[int]], first: int = 100, *, is_written: bool = False
) -> WordHistory:
    times = [START_NS + at * SECOND_NS for at in range(len(rows))]
    return WordHistory(
        Table.HOLDING_REGISTERS, first, times, [tuple(row) for row in rows], is_written=is_written
    )


def found(wanted: Wanted, *histories: WordHistory) -> list[FoundPlace]:
    (places,) = find([wanted], [WordsOfSlave("5", histories)])
    return places


def temperature_rows() -> list[list[int]]:
    rng = random.Random(1)
    rows = []
    for at in range(60):
        noise = rng.randint(0, 500)
        falling = on_the_wire(struct.pack(">f", 80 - at / 7), Order.CDAB)
        rows.append([noise, 234 + at, 7, *falling, 1000 - at])
    return rows


def test_a_number_is_found_in_its_register_type_and_scale() -> None:
    wanted = Wanted("", [Sighting(23.9, 0.05, START_NS + 5 * SECOND_NS)])
    best = found(wanted, words_of(temperature_rows()))[0]
    assert (best.address, best.reading.type, best.power) == (101, PointType.UINT16, -1)
    wanted = Wanted("", [Sighting(78.6, 0.05, START_NS + 10 * SECOND_NS)])
    best = found(wanted, words_of(temperature_rows()))[0]
    assert (best.address, best.reading, best.power) == (
        103, WordReading(PointType.FLOAT32, Order.CDAB), 0,
    )  # fmt: skip


def test_a_second_sighting_tells_a_moving_value_from_a_constant_one() -> None:
    rows = [[500, 500 + at, 500] for at in range(60)]
    once = Wanted("", [Sighting(50.0, 0.05, START_NS)])
    assert found(once, words_of(rows))[0].likelihood < 0.9
    twice = Wanted("", [*once.sightings, Sighting(53.0, 0.05, START_NS + 30 * SECOND_NS)])
    best = found(twice, words_of(rows))[0]
    assert (best.address, best.power) == (101, -1)
    assert best.likelihood > 0.9


def test_a_number_that_is_nowhere_has_no_place() -> None:
    places = found(Wanted("", [Sighting(-777_777.0, 0.5)]), words_of([[1, 2, 3]] * 10))
    assert not places or places[0].likelihood < 0.5


@pytest.mark.parametrize("at_ns", [None, START_NS + 3 * SECOND_NS])
def test_a_number_that_no_register_had_is_less_than_half_likely_and_marked(
    at_ns: int | None,
) -> None:
    rows = [[230 + at // 2 % 3, 7] for at in range(60)]  # 23.0 to 23.2
    best = found(Wanted("", [Sighting(23.9, 0.05, at_ns)]), words_of(rows))[0]
    assert (best.address, best.power, best.outside) == (100, -1, (23.9,))
    assert best.likelihood < 0.5
    inside = found(Wanted("", [Sighting(23.1, 0.05, at_ns)]), words_of(rows))[0]
    assert (inside.address, inside.power, inside.outside) == (100, -1, ())
    assert inside.likelihood > 0.5


def test_a_register_that_rises_may_show_a_little_more_than_at_the_last_poll() -> None:
    rows = [[2340 + 3 * at, 7] for at in range(60)]
    seen = [Sighting(234.0, 0.05, START_NS), Sighting(251.8, 0.05, START_NS + 59 * SECOND_NS)]
    best = found(Wanted("", seen), words_of(rows))[0]
    assert (best.address, best.power, best.outside) == (100, -1, ())
    assert best.likelihood > 0.9


def test_a_register_is_one_number_only() -> None:
    rows = [[2300, 2301] for _ in range(10)]
    wanted = [Wanted("a", [Sighting(230.0, 0.05)]), Wanted("b", [Sighting(230.1, 0.05)])]
    (first, *_), (second, *_) = find(wanted, [WordsOfSlave("5", [words_of(rows)])])
    assert (first.address, second.address) == (100, 101)


def test_numbers_at_equal_distances_vouch_for_each_other() -> None:
    # Three phases: voltage, current, power each. The voltages are so near that only the distance
    # tells them apart.
    rng = random.Random(2)
    rows = [
        [
            word
            for phase in range(3)
            for word in (
                2300 + rng.randint(-4, 4),
                1100 + 100 * phase + rng.randint(-5, 5),
                2500 + 210 * phase + rng.randint(-5, 5),
                7,
            )
        ]
        for _ in range(30)
    ]
    values = [1.102, 1.201, 1.299, 230.1, 229.9, 230.2, 250.2, 271.0, 292.1]
    wanted = [Wanted("", [Sighting(value, 0.0005 if value < 2 else 0.05)]) for value in values]
    places = find(wanted, [WordsOfSlave("5", [words_of(rows)])])
    assert [own[0].address for own in places] == [101, 105, 109, 100, 104, 108, 102, 106, 110]


def test_the_setting_that_was_changed_is_the_first() -> None:
    rng = random.Random(3)
    rows = [[rng.randint(200, 230), 45 if at < 30 else 50, at, 7] for at in range(60)]
    (first, *_) = find_changed(
        [WordsOfSlave("5", [words_of(rows)])],
        START_NS + 25 * SECOND_NS,
        START_NS + 35 * SECOND_NS,
    )
    assert (first.judged.address, first.before[-1], first.after[0]) == (101, 45, 50)
    assert first.likelihood > 0.9


def test_a_setting_that_a_master_wrote_comes_before_one_that_it_did_not() -> None:
    rows = [[45 if at < 30 else 50, 1 if at < 30 else 2] for at in range(60)]
    slave = WordsOfSlave("5", [words_of(rows), words_of([[50]], 100, is_written=True)])
    (first, second) = find_changed([slave], START_NS, START_NS + 59 * SECOND_NS)
    assert (first.judged.address, first.is_written, second.is_written) == (100, True, False)


@pytest.mark.parametrize("rows", [[[0]], [[0xFFFF, 0x7FC0]], []])
def test_words_of_any_kind_raise_nothing(rows: list[list[int]]) -> None:
    histories = [words_of(rows)] if rows else []
    find([Wanted("", [Sighting(0.0, 0.5, START_NS)])], [WordsOfSlave("5", histories)])
    find_changed([WordsOfSlave("5", histories)], START_NS, START_NS + 1)


def test_a_register_that_several_requests_write_has_all_their_values() -> None:
    alone = WordHistory(
        Table.HOLDING_REGISTERS, 105, [START_NS + 5 * SECOND_NS], [(1500,)], is_written=True
    )
    together = WordHistory(
        Table.HOLDING_REGISTERS, 104, [START_NS + 15 * SECOND_NS], [(1, 1600, 0)], is_written=True
    )
    later = Sighting(1600.0, 0.5, START_NS + 16 * SECOND_NS)
    for sightings in ([later], [Sighting(1500.0, 0.5, START_NS + 6 * SECOND_NS), later]):
        best = found(Wanted("", sightings), alone, together)[0]
        assert (best.address, best.reading.type) == (105, PointType.UINT16)
        assert best.likelihood > 0.9


def test_a_whole_number_shows_nothing_between_two_of_its_values() -> None:
    rows = [[21, 220 + at % 20] for at in range(60)]
    assert [one.address for one in found(Wanted("", [Sighting(21.3, 0.05)]), words_of(rows))][
        :1
    ] == [101]


def test_a_constant_is_no_number_two_percent_away() -> None:
    rows = [[2287, 230 + at % 9] for at in range(60)]
    places = found(Wanted("", [Sighting(23.4, 0.05)]), words_of(rows))
    assert places[0].address == 101
    assert all(one.address != 100 or one.likelihood < 0.01 for one in places)


def test_numbers_much_larger_than_a_tolerance_raise_nothing() -> None:
    huge = on_the_wire(struct.pack(">d", 3.3e11), "ABCD")
    rows = [[*huge, 230 + at % 9] for at in range(60)]
    seen = Sighting(3.4e11, 1e-9, START_NS + 5 * SECOND_NS)
    assert found(Wanted("", [seen]), words_of(rows)) is not None
