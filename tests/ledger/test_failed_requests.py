"""Requests without a good answer."""

from __future__ import annotations

from mbtool.core import EventKind, WireEvent
from mbtool.ledger.failed_requests import FailedRequests
from mbtool.modbus import Outcome
from mbtool.views.findings_table import failed_text
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import request, unanswered


def test_a_damaged_answer_is_told_apart_from_none() -> None:
    failed = FailedRequests()
    assert failed_text(failed) == ""
    bad = WireEvent(ts_ns=START_NS + 10 * MS, link="line", kind=EventKind.BAD_CHECK, message="")
    for record in (
        bad,
        unanswered(0),
        unanswered(20),
        request(30),
        request(40, outcome=Outcome.MALFORMED),
    ):
        failed.note(record)
    assert failed_text(failed) == (
        "1 request got no answer, 1 a damaged answer, 1 a malformed answer"
    )
    assert failed.counts() == {"no_answer": 2, "wrong_crc": 1, "exception": 0, "malformed": 1}


def test_what_no_slave_had_to_answer_is_no_failure() -> None:
    failed = FailedRequests()
    for outcome in (Outcome.OK, Outcome.BROADCAST, Outcome.NOT_CAPTURED, Outcome.UNSOLICITED):
        failed.note(request(0, outcome=outcome))
    assert failed_text(failed) == ""
