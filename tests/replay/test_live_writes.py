"""Values that a live master has written, at places of a recording."""

from __future__ import annotations

import pytest

from mbtool.modbus import Table
from mbtool.replay.player import LiveWrites, Place
from mbtool.replay.recording import Recording
from tests.replay.recorded import MS, answered

HELD = Table.HOLDING_REGISTERS
AT = 1, HELD, 0
"""Unit, table and address of the register that the recording writes."""


def _writes() -> LiveWrites:
    """Of a recording that reads a register at 0 ms, writes 5 at 100 and 7 at 300, reads at 500."""
    transactions = [
        answered(at, request, response, latency_ns=0)
        for at, request, response in (
            (0, "03 0000 0001", "03 02 0001"),
            (100, "06 0000 0005", "06 0000 0005"),
            (300, "06 0000 0007", "06 0000 0007"),
            (500, "03 0000 0001", "03 02 0008"),
        )
    ]
    return LiveWrites(Recording.of(transactions))


def _place(at_ms: int, lap: int = 0) -> Place:
    return Place(lap, at_ms * MS)


def _kept(value: int, at_ms: int, recorded: int, lap: int = 0) -> LiveWrites:
    writes = _writes()
    writes.keep(*AT, value, recorded=recorded, place=_place(at_ms, lap))
    return writes


def test_a_register_that_was_not_written_has_its_recorded_value() -> None:
    assert _writes().shown(*AT, 1, _place(50)) == 1
    assert _writes().overlay_on_recorded(1, HELD, 0, [1, 2], _place(50)) == [1, 2]


@pytest.mark.parametrize(("at_ms", "shown"), [(0, 9), (50, 9), (299, 9), (300, 42), (900, 42)])
def test_a_live_write_lasts_until_the_next_recorded_one(at_ms: int, shown: int) -> None:
    assert _kept(9, 150, 5).shown(*AT, 42, _place(at_ms)) == shown
    assert _kept(9, 150, 5).overlay_on_recorded(1, HELD, 0, [42], _place(at_ms)) == [shown]


def test_after_the_last_recorded_write_it_lasts_until_the_next_lap_writes() -> None:
    writes = _kept(9, 400, 7)
    for at_ms, lap, shown in ((500, 0, 9), (0, 1, 9), (99, 1, 9), (100, 1, 42), (0, 3, 42)):
        assert writes.shown(*AT, 42, _place(at_ms, lap)) == shown


def test_what_the_recording_has_shown_is_not_taken_back_by_an_older_answer() -> None:
    writes = _kept(9, 150, 5)
    answers = [(7, 310), (1, 160), (8, 500), (7, 320), (1, 0)]
    shown = [
        writes.overlay_on_recorded(1, HELD, 0, [value], _place(at_ms)) for value, at_ms in answers
    ]
    assert shown == [[7], [7], [8], [8], [8]]
    assert writes.shown(*AT, 1, _place(160)) == 8


def test_a_look_at_the_image_ends_nothing() -> None:
    writes = _kept(9, 150, 5)
    assert writes.shown(*AT, 8, _place(500)) == 8
    assert writes.overlay_on_recorded(1, HELD, 0, [5], _place(160)) == [9]


def test_a_second_live_write_counts_from_the_latest_place_shown() -> None:
    writes = _kept(9, 0, 1)
    assert writes.overlay_on_recorded(1, HELD, 0, [8], _place(500)) == [8]
    writes.keep(*AT, 3, recorded=1, place=_place(0))
    assert writes.overlay_on_recorded(1, HELD, 0, [8], _place(500)) == [3]


def test_a_live_write_of_what_the_recording_wrote_shows_what_came_of_it() -> None:
    writes = _kept(7, 310, 7)
    assert writes.shown(*AT, 7, _place(320)) == 7
    assert writes.shown(*AT, 8, _place(500)) == 8
    assert writes.overlay_on_recorded(1, HELD, 0, [5], _place(200)) == [7]  # From before the write.


@pytest.mark.parametrize(("value", "recorded"), [(7, 8), (8, 8)])
def test_a_live_write_of_a_value_that_has_changed_since_is_kept(value: int, recorded: int) -> None:
    writes = _kept(value, 500, recorded)
    assert writes.shown(*AT, 42, _place(900)) == value


def test_only_the_written_addresses_of_an_answer_are_shown() -> None:
    writes = _kept(9, 150, 5)
    writes.keep(1, HELD, 3, 4, recorded=0, place=_place(0))
    assert writes.overlay_on_recorded(1, HELD, 0, [1, 2, 3], _place(160)) == [9, 2, 3]
    assert writes.overlay_on_recorded(1, HELD, 2, [3, 5], _place(160)) == [3, 4]
    assert writes.overlay_on_recorded(2, HELD, 0, [1], _place(160)) == [1]
    assert writes.overlay_on_recorded(1, Table.COILS, 0, [1], _place(160)) == [1]
