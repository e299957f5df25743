"""Which unit sent a frame with a wrong CRC."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.responses import DamagedFrames
from mbtool.devices.checking.sliding_window import MAX_ENTRIES
from mbtool.modbus.response import MAX_FRAMES
from tests.devices.checking.talk import LINK, START_NS, event, line_event, transaction

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

MESSAGE = "8 bytes: a wrong CRC"


def damaged(at_ms: float) -> WireEvent:
    return event(EventKind.BAD_CHECK, at_ms=at_ms, message=MESSAGE, raw=bytes.fromhex("01 02"))


def findings(*records: NamedTransaction | WireEvent, closed: bool = True) -> list[Finding]:
    frames, found = DamagedFrames(), list[Finding]()
    for one in records:
        found += frames.event(one) if isinstance(one, WireEvent) else frames.transaction(one)
    return [*found, *frames.close()] if closed else found


def test_the_unit_is_that_of_the_request_without_an_answer() -> None:
    (one,) = findings(damaged(10), transaction(response=None, unit=4), closed=False)
    assert (one.code, one.unit, one.link, one.ts_ns) == ("RTU-201", 4, LINK, START_NS + 10_000_000)
    assert one.message == f"unit 4's answer to read holding 0: {MESSAGE}: 01 02"


def test_a_frame_that_answers_no_request_is_of_no_unit() -> None:
    unknown = f"unit unknown: {MESSAGE}: 01 02"
    for records in (
        [damaged(10)],
        [damaged(10), transaction(at_ms=20)],
        [damaged(10), transaction(at_ms=20, response=None)],
        [transaction(response=None), damaged(10)],
    ):
        assert [(one.unit, one.message) for one in findings(*records)] == [(None, unknown)]


def test_a_frame_waits_until_no_earlier_request_can_end() -> None:
    open_still = transaction(response=None, unit=4)
    (one,) = findings(damaged(10), transaction(at_ms=5, unit=9), open_still)
    assert one.unit == 4


def test_on_tcp_a_frame_waits_for_a_request_that_ends_long_after_later_ones() -> None:
    later = [transaction(at_ms=at_ms) for at_ms in range(1_000, 60_000, 1_000)]
    (one,) = findings(damaged(10), *later, transaction(response=None, unit=4), closed=False)
    assert one.unit == 4


def test_on_tcp_frames_before_the_one_that_answers_are_of_no_unit() -> None:
    found = findings(damaged(10), damaged(30), transaction(at_ms=20, response=None, unit=4))
    assert [one.unit for one in found] == [None, 4]


def test_on_a_line_a_frame_answers_no_request_after_the_next_one_that_begins_later() -> None:
    frame = line_event(EventKind.BAD_CHECK, at_ms=10)
    found = findings(frame, transaction(at_ms=20, on_a_line=True), closed=False)
    assert [one.unit for one in found] == [None]


def test_frames_of_more_links_than_are_kept_are_told() -> None:
    many = [replace(damaged(at), link=f"link {at}") for at in range(MAX_ENTRIES + 3)]
    assert [one.link for one in findings(*many, closed=False)] == ["link 0", "link 1", "link 2"]
    assert len(findings(*many)) == len(many)


def test_each_frame_is_told_once() -> None:
    records: list[NamedTransaction | WireEvent] = []
    for at_ms in range(0, 1000, 100):
        records += [damaged(at_ms + 10), transaction(at_ms=at_ms, response=None, unit=4)]
    assert [one.unit for one in findings(*records)] == [4] * 10


def test_few_frames_wait() -> None:
    many = [damaged(at_ms) for at_ms in range(MAX_FRAMES + 5)]
    assert len(findings(*many, closed=False)) == 5
    assert len(findings(*many)) == len(many)
