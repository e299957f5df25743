"""Adapters that hear what they send, so that each request comes twice."""

from __future__ import annotations

import pytest

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.modbus.adu import Adu, Skipped
from mbtool.modbus.adu_bytes import rtu_adu
from mbtool.serial_line import RtuSplitter
from mbtool.serial_line.adapter_echo import ECHO, ECHOES, ENOUGH_COPIES, ENOUGH_SINGLE
from tests.feeding import Line, feed_all
from tests.modbus.reading import adus

FORMAT = SerialFormat(19200, 8, "E", 1)
MS = 1_000_000
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
READ = rtu_adu(0x11, bytes.fromhex("03 006B 0003"))
ANSWER = rtu_adu(0x11, bytes.fromhex("03 06 022B 0000 0064"))
WRITE = rtu_adu(0x11, bytes.fromhex("06 0001 0003"))


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
