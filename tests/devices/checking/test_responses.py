from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.responses import MAX_PENDING, ResponseRules
from mbtool.devices.checking.sliding_window import MAX_ENTRIES
from mbtool.modbus.adu import Transport, Verdict
from tests.devices.checking.talk import (
    MASTER,
    SLAVE,
    assigned,
    event,
    line_event,
    opened,
    transaction,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.named_transaction import NamedTransaction

OTHER = "04 0000 0001"
OTHER_ANSWER = "04 02 0007"


def found(
    *records: NamedTransaction | WireEvent, profile: str | None = None
) -> list[tuple[str, str]]:
    rules = ResponseRules()
    return [(one.code, one.message) for one in _findings(rules, records, profile)]


def _findings(
    rules: ResponseRules, records: Iterable[NamedTransaction | WireEvent], profile: str | None
) -> Iterable[Finding]:
    for record in records:
        if isinstance(record, WireEvent):
            yield from rules.event(record)
        else:
            yield from rules.transaction(record, assigned(profile).profile_for(record))
    yield from rules.close()


def codes(*records: NamedTransaction | WireEvent, profile: str | None = None) -> list[str]:
    return [code for code, _ in found(*records, profile=profile)]


def test_a_request_without_answer_is_found_when_the_capture_goes_on() -> None:
    unanswered = transaction(response=None)
    later = transaction(OTHER, OTHER_ANSWER, at_ms=2000)
    assert found(unanswered, later) == [("MB-401", "read holding 0: no answer")]


def test_an_ambiguous_frame_needs_no_response_and_may_be_one() -> None:
    def doubtful(one: NamedTransaction) -> NamedTransaction:
        return msgspec.structs.replace(one, verdicts=[Verdict.AMBIGUOUS])

    asked = transaction(response=None, on_a_line=True)
    frame = transaction("02 0300 0000", None, at_ms=500, on_a_line=True)
    later = transaction(OTHER, OTHER_ANSWER, at_ms=9000, on_a_line=True)
    assert codes(asked, frame, later) == ["MB-401", "MB-401"]
    assert codes(asked, doubtful(frame), later) == []
    elsewhere = transaction("02 0300 0000", None, at_ms=500, on_a_line=True, unit=7)
    assert codes(asked, doubtful(elsewhere), later) == ["MB-401"]
    unasked = transaction("", OTHER_ANSWER, at_ms=9000, on_a_line=True)
    assert codes(later, unasked) == ["MB-403"]
    assert codes(later, doubtful(unasked)) == []


def test_a_slave_without_any_response_is_named_in_the_message() -> None:
    silent = transaction(response=None, unit=9)
    assert found(silent, transaction(OTHER, OTHER_ANSWER, at_ms=2000)) == [
        ("MB-401", "read holding 0: no answer; unit 9 says nothing in this capture")
    ]


def test_a_request_at_the_end_of_the_capture_is_no_finding() -> None:
    unanswered = transaction(response=None)
    assert codes(unanswered) == []
    assert codes(unanswered, transaction(OTHER, OTHER_ANSWER, at_ms=500)) == []


def test_on_a_line_the_next_request_ends_the_one_before() -> None:
    unanswered = transaction(response=None, on_a_line=True)
    following = transaction(OTHER, OTHER_ANSWER, at_ms=100, on_a_line=True)
    assert codes(unanswered, following) == ["MB-401"]
    assert codes(unanswered) == []


def test_a_retry_with_a_response_is_one_finding() -> None:
    asked = [transaction(response=None, at_ms=at, on_a_line=True) for at in (0, 300)]
    answered = transaction(at_ms=600, latency_ms=10, on_a_line=True, retries=2)
    assert found(*asked, answered) == [
        ("MB-402", "read holding 0: asked 3 times, answered after 0.6 s")
    ]


def test_each_retry_without_a_response_is_a_finding() -> None:
    asked = [transaction(response=None, at_ms=at) for at in (0, 300)]
    assert codes(*asked, transaction(OTHER, OTHER_ANSWER, at_ms=2000)) == ["MB-401", "MB-401"]


def test_the_next_poll_long_after_is_no_retry() -> None:
    unanswered = transaction(response=None)
    assert codes(unanswered, transaction(at_ms=6000, retries=1)) == ["MB-401"]


def test_a_tcp_request_can_time_out_after_the_response_to_its_retry() -> None:
    answered = transaction(at_ms=1000, number=2, retries=2)
    given_up = [transaction(response=None, at_ms=at) for at in (0, 500)]
    assert found(answered, transaction(at_ms=70_000, number=3), *given_up) == [
        ("MB-402", "read holding 0: asked 3 times, answered after 1.0 s")
    ]


def test_an_equal_request_at_the_usual_period_of_its_poll_is_the_next_poll() -> None:
    def told(usual_ms: float) -> list[str]:
        rules = ResponseRules(lambda _: usual_ms * 1e6)
        records = [transaction(response=None), transaction(at_ms=900)]
        return [one.code for one in _findings(rules, records, None)]

    assert told(usual_ms=1000) == ["MB-401"]
    assert told(usual_ms=3000) == ["MB-402"]


def test_a_response_without_a_request_is_found() -> None:
    assert found(opened(), transaction("", "03 02 1234")) == [
        ("MB-403", "answer to read holding registers, which no request in the capture asked for")
    ]
    assert codes(transaction(), transaction("", "83 02", at_ms=5)) == ["MB-403"]


def test_a_response_at_the_beginning_of_the_capture_is_no_finding() -> None:
    early = transaction("", "03 02 1234", at_ms=10)
    assert codes(opened(joined=True), early) == []
    assert codes(early) == []
    late = transaction("", "03 02 1234", at_ms=6000)
    assert codes(early, late) == ["MB-403"]


def test_a_response_after_damaged_or_lost_bytes_is_no_finding() -> None:
    asked = transaction(on_a_line=True)
    stray = transaction("", "03 02 1234", at_ms=50, on_a_line=True)
    assert codes(asked, stray) == ["MB-403"]
    assert codes(asked, line_event(EventKind.BAD_CHECK, at_ms=20), stray) == []
    lost = event(EventKind.GAP, at_ms=20)
    assert codes(opened(), transaction(), lost, transaction("", "03 02 1234", at_ms=50)) == []


def test_a_request_before_lost_bytes_is_no_finding() -> None:
    later = transaction(OTHER, OTHER_ANSWER, at_ms=4000)
    unanswered = transaction(response=None)
    for kind in (EventKind.GAP, EventKind.CUT, EventKind.DISCARDED):
        for ends in ((MASTER, SLAVE), (SLAVE, MASTER)):
            lost = event(kind, at_ms=10, source=ends[0], destination=ends[1])
            assert codes(transaction(at_ms=-10), unanswered, lost, later) == []
            # A transaction without answer may be known only after the loss.
            assert codes(transaction(at_ms=-10), lost, unanswered, later) == []


def test_a_gap_in_a_log_drops_all_pending_requests() -> None:
    hole = WireEvent(ts_ns=0, link="", kind=EventKind.GAP, message="a hole")
    later = transaction(OTHER, OTHER_ANSWER, at_ms=4000)
    assert codes(transaction(response=None), hole, later) == []


def test_functions_carried_out_in_silence_need_no_response() -> None:
    later = transaction(OTHER, OTHER_ANSWER, at_ms=4000)
    assert codes(transaction("08 0004 0000", None), later) == []
    reset = transaction("41 00", None, profile="fa3-at1m8x")
    assert codes(reset, later, profile="fa3-at1m8x") == []
    assert codes(transaction("08 0000 0000", None), later) == ["MB-401"]


def test_a_broadcast_over_tcp_needs_no_answer() -> None:
    sent = transaction("06 0000 0001", None, unit=0)
    later = transaction(at_ms=4000)
    assert codes(sent, later) == ["MB-401"]  # Unit 0 is one of Modbus/TCP.
    over_tcp = msgspec.structs.replace(sent, transport=Transport.RTU_TCP)
    assert codes(over_tcp, later) == []


def test_a_broadcast_needs_no_answer() -> None:
    sent = transaction("06 0000 0001", None, unit=0, on_a_line=True)
    assert codes(sent, transaction(at_ms=4000, on_a_line=True)) == []


def test_an_answer_with_another_transaction_id_is_an_answer() -> None:
    odd = transaction(answer_number=5, verdicts=(Verdict.OTHER_TRANSACTION_ID,))
    assert codes(odd, transaction(at_ms=4000)) == []


def test_memory_is_bounded() -> None:
    rules = ResponseRules()
    found = 0
    for number in range(MAX_PENDING + 500):
        source = f"10.0.0.1:{number}"
        for told in (opened(source=source), event(EventKind.CLOSED, source=source)):
            assert not [*rules.event(told)]
        one = transaction(response=None, source=source, at_ms=1)
        found += len([*rules.transaction(one, None)])
    assert found == 500
    assert rules._pending_count == MAX_PENDING
    assert len(rules._states) <= MAX_ENTRIES
