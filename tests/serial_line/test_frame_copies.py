"""Adapters that hear what they send, and repeaters: frames come twice."""

from __future__ import annotations

from itertools import pairwise

import pytest

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.modbus.adu import Adu, Skipped, rtu_adu
from mbtool.serial_line import RtuSplitter
from mbtool.serial_line.bus_model import SURE
from mbtool.serial_line.frame_copies import (
    ECHO,
    ECHOES,
    ENOUGH_COPIES,
    ENOUGH_SINGLE,
    REPEAT,
    REPEATS,
)
from tests.feeding import Line, feed_all
from tests.modbus.reading import adus

FORMAT = SerialFormat(19200, 8, "E", 1)
MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
READ = rtu_adu(0x11, bytes.fromhex("03 006B 0003"))
ANSWER = rtu_adu(0x11, bytes.fromhex("03 06 022B 0000 0064"))
WRITE = rtu_adu(0x11, bytes.fromhex("06 0001 0003"))
OTHER_READ = rtu_adu(0x12, bytes.fromhex("03 03 50 0007"))
"""Its third byte is 03, so it is as long as a response with three bytes of data."""
OTHER_ANSWER = rtu_adu(0x12, bytes.fromhex("03 0E 06C6 0000 0B97 0001 003A 0001 0002"))


def echoing(rounds: int, *, read_first: bool = True) -> tuple[Line, list[bytes]]:
    """A line with reads and writes, each request twice, and the frames without the copies."""
    sent, frames = Line(FORMAT), []
    pairs = [(READ, ANSWER), (WRITE, WRITE)]
    for request, response in (pairs if read_first else pairs[::-1]) * rounds:
        sent.frame(request, 30 * MS).frame(request, MS // 2).frame(response, 4 * MS)
        frames += [request, response]
    return sent, frames


def heard(sent: Line, *, timed: bool = True) -> list[Adu | Skipped]:
    return feed_all(RtuSplitter(FORMAT, timed=timed), sent.reads())


def echoes(events: list[Adu | Skipped]) -> list[Skipped]:
    return [one for one in events if isinstance(one, Skipped) and one.kind is EventKind.ECHO]


def test_second_copy_of_each_request_is_an_event() -> None:
    sent, frames = echoing(20)
    events = heard(sent)
    assert [one.raw for one in adus(events)] == frames
    assert [one.direction for one in adus(events)] == [REQUEST, RESPONSE] * 40
    assert [one.raw for one in echoes(events)] == frames[::2]
    assert b"".join(one.raw for one in events) == sent.data


def test_without_silences_three_copied_requests_in_a_row_are_an_echo() -> None:
    sent = Line(FORMAT)
    for _ in range(4):
        sent.frame(READ, 30 * MS).frame(READ, MS // 2).frame(ANSWER, 4 * MS)
    assert [one.raw for one in echoes(heard(sent, timed=False))] == [READ]


def test_adapter_is_told_once() -> None:
    events = heard(echoing(20)[0])
    assert [one.reason for one in echoes(events)] == [ECHOES, *[ECHO] * 39]


def test_copies_without_times_are_events_once_some_requests_came_twice() -> None:
    sent, frames = echoing(20)
    events = heard(sent, timed=False)
    assert len(echoes(events)) >= 40 - 2 * ENOUGH_COPIES
    late = [one.raw for one in adus(events)][-2 * 30 :]
    assert late == frames[-2 * 30 :]
    assert [one.direction for one in adus(events)][-2 * 30 :] == [REQUEST, RESPONSE] * 30


def test_capture_that_begins_with_a_write_is_read_from_the_first_read_on() -> None:
    sent, frames = echoing(10, read_first=False)
    assert [one.raw for one in adus(heard(sent))][-38:] == frames[-38:]


@pytest.mark.parametrize("timeout_ms", [20, 100, 500])
def test_retries_are_no_copies(timeout_ms: int) -> None:
    """A slave that is absent: the master asks it the same again and again."""
    sent = Line(FORMAT)
    for _ in range(20):
        sent.frame(READ, timeout_ms * MS)
    for timed in (True, False):
        events = heard(sent, timed=timed)
        assert [one.raw for one in adus(events)] == [READ] * 20
        assert echoes(events) == []


def test_one_glued_retry_on_a_line_without_echo_is_no_copy() -> None:
    sent = Line(FORMAT)
    for _ in range(10):
        sent.frame(READ, 30 * MS).frame(ANSWER, 4 * MS)
    sent.frame(READ, 30 * MS).frame(READ, MS // 2).frame(ANSWER, 4 * MS)
    events = heard(sent)
    assert [one.raw for one in adus(events)][-3:] == [READ, READ, ANSWER]
    assert echoes(events) == []


def test_adapter_may_be_exchanged_for_one_that_does_not_echo() -> None:
    sent, _ = echoing(5)
    for _ in range(ENOUGH_SINGLE + 1):
        sent.frame(READ, 30 * MS).frame(ANSWER, 4 * MS)
    sent.frame(READ, 30 * MS).frame(READ, 300 * MS).frame(ANSWER, 4 * MS)
    events = heard(sent)
    assert [one.raw for one in adus(events)][-3:] == [READ, READ, ANSWER]
    assert len(echoes(events)) == 10


def test_retry_has_its_own_copy() -> None:
    sent, _ = echoing(5)
    for _ in range(2):
        sent.frame(READ, 300 * MS).frame(READ, MS // 2)
    sent.frame(ANSWER, 4 * MS)
    events = heard(sent)
    assert [one.raw for one in adus(events)][-3:] == [READ, READ, ANSWER]
    assert len(echoes(events)) == 12


def test_copied_read_that_has_the_length_of_a_response_shows_the_echo_as_well() -> None:
    """A poll list of a single read. No slave answers it with the same bytes."""
    sent = Line(FORMAT)
    for _ in range(10):
        sent.frame(OTHER_READ, 30 * MS).frame(OTHER_READ, MS // 2).frame(OTHER_ANSWER, 4 * MS)
    assert len(echoes(heard(sent, timed=False))) == 10 - ENOUGH_COPIES


def test_copied_requests_without_response_do_not_put_the_recognition_off() -> None:
    """Between two polls, a unit without power is asked each time."""
    sent, absent = Line(FORMAT), rtu_adu(0x22, bytes.fromhex("03 006B 0003"))
    for _ in range(5):
        sent.frame(READ, 30 * MS).frame(READ, MS // 2).frame(ANSWER, 4 * MS)
        sent.frame(absent, 30 * MS).frame(absent, MS // 2)
    assert len(echoes(heard(sent, timed=False))) == 10 - (2 * ENOUGH_COPIES - 1)


def test_copied_write_is_a_retry_however_soon_it_comes() -> None:
    """Only what the master sends is copied: no slave has responded after 90 ms."""
    sent, _ = echoing(2)
    for silence_ms in (30, 90, 90):
        sent.frame(WRITE, silence_ms * MS).frame(WRITE, MS // 2)
    sent.frame(READ, 120 * MS).frame(READ, MS // 2).frame(ANSWER, 4 * MS)
    events = heard(sent)
    directions = [one.direction for one in adus(events)]
    assert directions == [REQUEST, RESPONSE] * 4 + [REQUEST] * 4 + [RESPONSE]


def test_copied_write_is_answered_by_a_frame_without_copy() -> None:
    sent, _ = echoing(10)
    sent.frame(WRITE, 90 * MS).frame(WRITE, MS // 2).frame(WRITE, 90 * MS)
    sent.frame(READ, 30 * MS).frame(READ, MS // 2).frame(ANSWER, 4 * MS)
    events = heard(sent)
    assert [one.direction for one in adus(events)] == [REQUEST, RESPONSE] * 22


def test_copied_write_after_copied_reads_is_no_response() -> None:
    sent = Line(FORMAT)
    for _ in range(ENOUGH_COPIES):
        sent.frame(READ, 30 * MS).frame(READ, MS // 2).frame(ANSWER, 4 * MS)
    for _ in range(2):
        sent.frame(WRITE, 30 * MS).frame(WRITE, MS // 2).frame(WRITE, 4 * MS)
    events = heard(sent, timed=False)
    assert [one.direction for one in adus(events)][-4:] == [REQUEST, RESPONSE] * 2


def test_requests_that_come_twice_are_ambiguous_until_the_echo_is_recognised() -> None:
    events = heard(echoing(20)[0], timed=False)
    copies = [before for before, after in pairwise(adus(events)) if before.raw == after.raw == READ]
    assert len(copies) == ENOUGH_COPIES
    assert all(one.confidence < SURE for one in copies[1:])


def repeated(rounds: int, copy_ns: int) -> tuple[Line, list[bytes]]:
    """A line with a repeater: each request and each response comes twice."""
    sent, frames = Line(FORMAT), []
    for request, response in ((READ, ANSWER), (WRITE, WRITE)) * rounds:
        for frame, silence_ns in ((request, 30 * MS), (response, 6 * MS)):
            sent.frame(frame, silence_ns).frame(frame, copy_ns)
            frames.append(frame)
    return sent, frames


@pytest.mark.parametrize("copy_ns", [MS, 3 * MS])
@pytest.mark.parametrize("timed", [True, False])
def test_the_copies_of_a_repeater_are_events(copy_ns: int, timed: bool) -> None:
    sent, frames = repeated(20, copy_ns)
    events = heard(sent, timed=timed)
    assert b"".join(one.raw for one in events) == sent.data
    assert [one.raw for one in adus(events)][-56:] == frames[-56:]
    assert [one.direction for one in adus(events)][-56:] == [REQUEST, RESPONSE] * 28
    copies = [one for one in events if isinstance(one, Skipped) and one.kind is EventKind.REPEATED]
    assert len(copies) >= 40 - 2 * ENOUGH_COPIES
    assert [one.reason for one in copies] == [REPEATS, *[REPEAT] * (len(copies) - 1)]


def test_a_repeater_may_be_taken_away() -> None:
    sent, _ = repeated(5, 3 * MS)
    for _ in range(10):
        sent.frame(READ, 30 * MS).frame(ANSWER, 4 * MS)
    sent.frame(READ, 30 * MS).frame(ANSWER, 4 * MS).frame(ANSWER, 4 * MS)
    events = heard(sent)
    assert [one.raw for one in adus(events)][-3:] == [READ, ANSWER, ANSWER]
