"""Numbers of several registers in the live view."""

from __future__ import annotations

import random
import struct
from typing import TYPE_CHECKING

from mbtool.modbus.tables import Table
from mbtool.watching.guessed_points import JUDGED_AT, MAX_POLLS, GuessedPoints
from mbtool.watching.watched import Watched
from tests.ledger.requests import request

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction


def reads(count: int) -> list[NamedTransaction]:
    """A unit that holds 7, then about 230 V as a float, low word first."""
    rng = random.Random(1)
    found = []
    for at in range(count):
        high, low = struct.unpack(">HH", struct.pack(">f", 230 + rng.gauss(0, 2)))
        found.append(
            request(at * 1000, 10, quantity=4, response_values=[7, low, high, 40 + at % 5])
        )
    return found


def shown(watched: Watched) -> dict[str, str]:
    return {row.reference: row.text for row in watched.whole.points.values()}


def test_registers_that_are_surely_one_number_become_one_row() -> None:
    watched = Watched()
    some = reads(JUDGED_AT[0] + 5)
    for one in some[: JUDGED_AT[0] - 1]:
        watched.add(one)
    assert list(shown(watched)) == ["holding 10", "holding 11", "holding 12", "holding 13"]
    for one in some[JUDGED_AT[0] - 1 :]:
        watched.add(one)
    rows = shown(watched)
    assert set(rows) == {"holding 10", "holding 11..12 float32 CDAB ?", "holding 13"}
    assert 200 < float(rows["holding 11..12 float32 CDAB ?"]) < 260


def test_words_are_shown_if_the_user_wants_them() -> None:
    watched = Watched()
    watched.show_words()
    for one in reads(JUDGED_AT[-1] + 5):
        watched.add(one)
    assert len(shown(watched)) == 4


def test_memory_is_bounded() -> None:
    guesses = GuessedPoints()
    for unit in range(MAX_POLLS + 50):
        for at in range(JUDGED_AT[-1] + 5):
            guesses.learn("line", unit, Table.HOLDING_REGISTERS, 0, [at, 1], at)
    assert len(guesses._judged) == MAX_POLLS
    assert not guesses._rows
