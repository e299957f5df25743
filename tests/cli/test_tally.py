"""The sentence at the end of a run."""

from __future__ import annotations

import pytest

from mbtool.cli.tally import Tally
from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Outcome, Verdict
from tests.logs.samples import transaction


def _event(kind: EventKind) -> WireEvent:
    return WireEvent(ts_ns=0, link="rs485", kind=kind, message="")


@pytest.mark.parametrize(
    ("outcomes", "events", "sentence"),
    [
        ([], [], "0 transactions"),
        ([Outcome.OK], [], "1 transaction: 1 ok"),
        (
            [Outcome.EXCEPTION, Outcome.OK, Outcome.OK],
            [EventKind.GAP],
            "3 transactions: 2 ok, 1 exception; 1 event: 1 gap",
        ),
        (
            list(Outcome),
            [EventKind.SKIPPED, EventKind.BAD_CHECK, EventKind.SKIPPED],
            "8 transactions: 1 ok, 1 exception, 1 late, 1 without answer, 1 not captured, "
            "1 unsolicited, 1 broadcast, 1 malformed; 3 events: 1 bad-check, 2 skipped",
        ),
        ([], [EventKind.OPENED, EventKind.CLOSED], "0 transactions"),
        ([], [EventKind.OPENED, EventKind.CUT], "0 transactions; 1 event: 1 cut"),
    ],
)
def test_says_what_went_through(
    outcomes: list[Outcome], events: list[EventKind], sentence: str
) -> None:
    tally = Tally()
    for outcome in outcomes:
        tally.add(transaction(outcome=outcome))
    for kind in events:
        tally.add(_event(kind))
    assert tally.sentence() == sentence
    assert tally.transactions == len(outcomes)


def test_says_how_many_are_ambiguous() -> None:
    tally = Tally()
    for verdicts in ([], [Verdict.AMBIGUOUS], [Verdict.GLUED, Verdict.AMBIGUOUS]):
        tally.add(transaction(verdicts=verdicts))
    assert tally.sentence() == "3 transactions: 3 ok (2 ambiguous)"
