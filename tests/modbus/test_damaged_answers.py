from __future__ import annotations

from mbtool.core import EventKind, WireEvent
from mbtool.modbus.response import DamagedAnswers
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import request, unanswered


def damaged(at_ms: float, link: str = "line") -> WireEvent:
    at_ns = START_NS + round(at_ms * MS)
    return WireEvent(ts_ns=at_ns, link=link, kind=EventKind.BAD_CHECK, message="", raw=b"\x01\x03")


def told(*events: WireEvent) -> DamagedAnswers:
    answers = DamagedAnswers()
    for event in events:
        answers.note(event)
    return answers


def test_a_damaged_frame_answers_the_request_before_it_and_no_other() -> None:
    answers = told(damaged(10))
    assert not answers.has(request(5))
    assert not answers.has(unanswered(20))
    answers = told(damaged(10))
    assert answers.has(unanswered(5))
    assert not answers.has(unanswered(6))


def test_two_damaged_frames_answer_two_requests() -> None:
    answers = told(damaged(10), damaged(30))
    assert answers.has(unanswered(5))
    assert answers.has(unanswered(25))


def test_a_damaged_frame_of_another_line_answers_nothing() -> None:
    assert not told(damaged(10, "other")).has(unanswered(5))
