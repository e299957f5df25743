"""What is news of masters that are turned away."""

from __future__ import annotations

import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Outcome
from mbtool.workflows.sniff import MAX_REASONS, Refusals
from tests.devices.transactions import transaction

LINK = "10.0.0.9"
FIRST, SECOND = "10.0.0.1:40001", "10.0.0.1:40002"


def event(kind: EventKind, source: str, message: str = "", link: str = LINK) -> WireEvent:
    return WireEvent(ts_ns=0, link=link, kind=kind, message=message, source=source)


def opened(source: str, link: str = LINK) -> WireEvent:
    return event(EventKind.OPENED, source, link=link)


def closed(source: str) -> WireEvent:
    return event(EventKind.CLOSED, source)


def refused(message: str = "refused", source: str = FIRST, link: str = LINK) -> WireEvent:
    return event(EventKind.REFUSED, source, message, link)


def answered(source: str, outcome: Outcome = Outcome.OK) -> NamedTransaction:
    return Namer().name(transaction(3, 0, link=LINK, source=source, outcome=outcome))


def news(*records: NamedTransaction | WireEvent) -> list[bool]:
    """Of each refusal, whether it is news."""
    refusals = Refusals()
    told = [(record, refusals.note_refusal(record)) for record in records]
    assert not any(
        is_news
        for record, is_news in told
        if not isinstance(record, WireEvent) or record.kind is not EventKind.REFUSED
    )
    return [
        is_news
        for record, is_news in told
        if isinstance(record, WireEvent) and record.kind is EventKind.REFUSED
    ]


def test_a_reason_is_news_once_also_where_others_come_between() -> None:
    assert news(*(refused(why) for why in "ababca")) == [True, True, False, False, True, False]


def test_each_link_has_its_own_news() -> None:
    assert news(refused(link="a"), refused(link="b"), refused(link="a")) == [True, True, False]


def test_a_connection_that_opens_only_to_be_refused_is_no_end_of_it() -> None:
    """So a slave with TLS 1.3 does it that does not like the tap's certificate."""
    again = (opened(SECOND), refused(source=SECOND), closed(SECOND))
    assert news(refused(), *again, *again) == [True, False, False]


@pytest.mark.parametrize("outcome", [Outcome.OK, Outcome.EXCEPTION])
def test_a_slave_that_answered_in_between_is_news_again(outcome: Outcome) -> None:
    assert news(refused(), opened(SECOND), answered(SECOND, outcome), refused()) == [True, True]


@pytest.mark.parametrize("outcome", [Outcome.NO_ANSWER, Outcome.UNSOLICITED, Outcome.MALFORMED])
def test_a_request_without_a_right_answer_is_no_end_of_it(outcome: Outcome) -> None:
    assert news(refused(), opened(SECOND), answered(SECOND, outcome), refused()) == [True, False]


def test_a_connection_that_was_open_before_is_no_end_of_it() -> None:
    """A slave that serves one master at a time answers that one while it refuses others."""
    assert news(opened(FIRST), refused(source=SECOND), answered(FIRST), refused()) == [True, False]


def test_what_is_held_is_bounded() -> None:
    refusals = Refusals()
    told = [refusals.note_refusal(refused(str(number))) for number in range(2 * MAX_REASONS)]
    assert told.count(True) == MAX_REASONS
    for number in range(1000):
        refusals.note_refusal(opened(f"10.0.0.1:{number}"))
        refusals.note_refusal(closed(f"10.0.0.1:{number}"))
    assert refusals._open == {LINK: set()}
