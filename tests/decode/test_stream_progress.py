"""Which bytes of one direction were captured, and which the other end shows to be lost."""

from __future__ import annotations

import pytest

from mbtool.core import StreamPlace
from mbtool.decode.stream_progress import StreamProgress
from mbtool.packets.stream import LEAD


def begun(*sizes: int, start: int = LEAD) -> StreamProgress:
    """A stream of which so many bytes were captured and read as ADUs."""
    progress = StreamProgress()
    at = start
    for size in sizes:
        progress.take(StreamPlace(at, None), size)
        assert progress.read(at, at + size) == 0
        progress.unread = 0
        at += size
    return progress


def test_all_that_is_captured_and_acknowledged_is_not_lost() -> None:
    progress = begun(12, 12)
    assert progress.acknowledge(LEAD + 24) == progress.acknowledge(LEAD) == 0
    assert progress.acknowledge(None) == progress.end() == 0


@pytest.mark.parametrize("lost", [1, 12])
def test_bytes_that_are_acknowledged_and_not_captured_are_lost_once(lost: int) -> None:
    progress = begun(12)
    assert progress.acknowledge(LEAD + 12 + lost) == lost
    assert progress.acknowledge(LEAD + 12 + lost) == 0
    assert (progress.captured, progress.end()) == (LEAD + 12 + lost, 0)


@pytest.mark.parametrize(
    ("first", "lost"), [(LEAD // 2 - 1, LEAD // 2 - 1), (LEAD // 2, 0), (LEAD, 0), (0, 0)]
)
def test_a_stream_begins_with_its_first_position_unless_that_is_near_the_beginning(
    first: int, lost: int
) -> None:
    """Near position 0 the capture has the beginning of the connection, or lacks bytes of it."""
    progress = StreamProgress()
    assert progress.acknowledge(first) == lost
    progress = StreamProgress()
    progress.take(StreamPlace(first, 7), 12)
    assert (progress.captured, progress.received) == (first + 12, 7)


@pytest.mark.parametrize(("held", "is_told_later"), [(7, False), (8, True), (12, True)])
def test_behind_the_known_start_of_a_response_the_gap_tells_what_is_lost(
    held: int, is_told_later: bool
) -> None:
    progress = begun(12)
    progress.take(StreamPlace(LEAD + 12, None), held)
    lost = progress.acknowledge(LEAD + 30, of_responses=True)
    assert (lost == 0) is is_told_later
    assert progress.has_part is is_told_later
    assert progress.acknowledge(LEAD + 20, of_responses=True) == 0
    assert progress.end() == (18 if is_told_later else 0)
    if is_told_later:
        assert progress.acknowledge(LEAD + 12 + held, of_responses=True) == 0
        assert not progress.has_part


def test_a_part_of_a_request_does_not_hide_that_bytes_are_lost() -> None:
    progress = begun(12)
    progress.take(StreamPlace(LEAD + 12, None), 8)
    assert progress.acknowledge(LEAD + 30) == 18
    assert not progress.has_part


@pytest.mark.parametrize(("known", "lost"), [(0, 20), (5, 15), (20, 0)])
def test_a_gap_is_lost_but_for_the_end_of_an_adu_that_was_read(known: int, lost: int) -> None:
    progress = begun(12)
    progress.skip(20, known, 99)
    assert progress.lost_ns == 99
    assert not progress.is_at_rest(LEAD + 12)
    assert progress.captured == LEAD + 32
    progress.take(StreamPlace(LEAD + 32, None), 12)
    # What is read behind it begins where the gap ends; the known bytes are those of an ADU.
    if known:
        progress.read(LEAD + 12, LEAD + 12 + known)
        assert progress.acknowledge(LEAD + 32) == 0
    else:
        assert progress.read(LEAD + 32, LEAD + 44) == lost
        assert progress.read(LEAD + 44, LEAD + 56) == 0


def test_an_acknowledgement_ends_a_gap_at_once() -> None:
    progress = begun(12)
    progress.skip(20, 0)
    assert progress.acknowledge(LEAD + 32) == 20
    assert progress.acknowledge(LEAD + 32) == 0


def test_a_stream_ends_with_the_lost_bytes_of_its_last_gap() -> None:
    progress = begun(12)
    progress.skip(20, 0)
    assert progress.end() == 20
    assert StreamProgress().end() == 0


def test_without_positions_gaps_tell_the_number_of_lost_bytes() -> None:
    progress = StreamProgress()
    progress.skip(20, 5)
    progress.skip(7, 0)
    assert progress.captured is None
    assert (progress.take_missing_bytes(), progress.take_missing_bytes()) == (22, 0)


def test_a_stream_is_at_rest_when_all_bytes_before_a_position_are_read() -> None:
    progress = begun(12)
    assert progress.is_at_rest(LEAD + 12)
    assert not progress.is_at_rest(LEAD + 11)
    assert not progress.is_at_rest(LEAD + 13)
    progress.take(StreamPlace(LEAD + 12, None), 8)
    assert not progress.is_at_rest(LEAD + 20)
    assert not StreamProgress().is_at_rest(0)


def test_adus_that_were_read_elsewhere_move_everything_on() -> None:
    progress = begun(12)
    progress.pass_plain(100, 77)
    assert progress.is_at_rest(LEAD + 112)
    assert progress.received == 77
    assert progress.acknowledge(LEAD + 112 + 5) == 5
