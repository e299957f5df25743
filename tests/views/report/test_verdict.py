"""What the first sentence says of units that made captures show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest

from mbtool.core import EventKind, SerialFormat
from mbtool.devices.checking.finding import Finding
from mbtool.ledger.statistics import Statistics
from mbtool.ledger.statistics_report import report
from mbtool.modbus import Outcome
from mbtool.troubles.broken_rules import Summaries
from mbtool.views.report.troubles import Rank
from mbtool.views.report.verdict import ReportVerdict, report_verdict
from tests.ledger.test_history import asked, event

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core import WireEvent
    from mbtool.devices import NamedTransaction


def judged(records: Sequence[NamedTransaction | WireEvent], *findings: Finding) -> ReportVerdict:
    statistics, summaries = Statistics(lambda _: SerialFormat()), Summaries()
    for record in records:
        statistics.add(record)
    for finding in findings:
        summaries.add(finding)
    statistics.settle()
    return report_verdict(report(statistics), summaries)


def polled(seconds: int, failing: range = range(0), unit: int = 1) -> list[NamedTransaction]:
    return [
        asked(at, unit, Outcome.NO_ANSWER, None) if at in failing else asked(at, unit)
        for at in range(seconds)
    ]


@pytest.mark.parametrize(
    ("failing", "said"),
    [
        (range(60, 100), "Unit 1 leaves all its requests without an answer since 22:14:20."),
        (range(30), "Unit 1 leaves all its requests without an answer until 22:13:49."),
        (
            range(30, 60),
            "Unit 1 leaves all its requests without an answer from 22:13:50 to 22:14:19.",
        ),
        (range(0, 100, 4), "Unit 1 leaves 25 % of its requests without an answer."),
    ],
)
def test_the_share_is_of_the_time_in_which_it_shows(failing: range, said: str) -> None:
    assert judged(polled(100, failing)).sentence == said


def test_rare_failures_are_small_things() -> None:
    told = judged(polled(1000, range(500, 502)))
    assert told.level == "doubt"
    assert told.sentence == (
        "Everything is well, but for small things: "
        "unit 1 leaves 2 of its requests without an answer."
    )


def test_a_unit_that_became_slower_is_told_since_when() -> None:
    told = judged([asked(at, latency_ms=5 if at < 60 else 45) for at in range(100)])
    assert told.sentence == (
        "Unit 1 answers slower since 22:14:19: in 45.0 ms on average, before in 5.0 ms."
    )


def test_a_unit_that_is_slow_and_fast_in_turn_is_not_told_to_be_slower() -> None:
    times = {at: 45 if at >= 60 and at % 20 < 10 else 5 for at in range(100)}
    told = judged([asked(at, latency_ms=latency_ms) for at, latency_ms in times.items()])
    assert told.troubles == []


def test_many_units_that_became_slower_are_told_as_one_and_are_no_small_thing() -> None:
    told = judged(
        [
            asked(at, unit, latency_ms=5 if at < 60 else 45 + unit)
            for at in range(100)
            for unit in range(4)
        ]
    )
    assert told.sentence == (
        "4 of 4 units became slower; unit 3 answers slower since 22:14:19: in 48.0 ms on average, "
        "before in 5.0 ms."
    )


def test_a_dead_unit_is_told_with_what_the_capture_cuts() -> None:
    told = judged([*polled(20, range(20)), asked(20, 1, Outcome.NOT_CAPTURED, None)])
    assert told.sentence == "Unit 1 never answers (20 requests, and 1 not captured whole)."


def test_many_slow_units_are_told_as_one() -> None:
    records = [
        asked(at, unit, latency_ms=90 if unit < 4 else 5) for at in range(20) for unit in range(16)
    ]
    told = judged(records)
    assert [one.text for one in told.troubles] == [
        "4 of 16 units are slow; unit 0 is slow: half of its answers take 90.0 ms or more, those "
        "of the others 5.0 ms"
    ]
    assert told.level == "bad"
    assert judged([one for one in records if one.unit < 8]).level == "doubt"


def test_the_worst_come_first_and_the_sentence_has_three() -> None:
    records = [one for unit in range(1, 6) for one in polled(50, range(50), unit)]
    told = judged([*records, *polled(50, unit=9)])
    assert told.told == 3
    assert told.sentence.endswith("; 2 more troubles below.")
    assert len(told.troubles) == 5


def test_an_attack_is_told_by_who_makes_it() -> None:
    finding = Finding(
        code="SEC-201", message="", ts_ns=0, link="rs485", source="10.0.0.66:50000", unit=1
    )
    told = judged(polled(20), finding)
    assert [one.rank for one in told.troubles] == [Rank.ATTACK]
    assert told.sentence.startswith("10.0.0.66: a host asks many addresses")


def test_a_unit_whose_answers_are_all_damaged_is_not_called_dead() -> None:
    records = [
        one
        for at in range(20)
        for one in (event(at + 0.02, EventKind.BAD_CHECK), asked(at, 1, Outcome.NO_ANSWER, None))
    ]
    told = judged([*records, *polled(20, unit=2)])
    assert told.sentence == (
        "Unit 1 gives no answer with a right CRC (20 requests); everything else is well."
    )


def refused(at: float, unit: int, *codes: int) -> list[NamedTransaction]:
    one = asked(at, unit, Outcome.EXCEPTION)
    return [
        msgspec.structs.replace(one, exception=code, exception_name=f"name {code}")
        for code in codes
    ]


def test_the_codes_of_refusals_are_told_as_often_as_they_came() -> None:
    def told(*codes: int) -> str:
        return judged(refused(1, 1, *codes)).sentence.removeprefix("Unit 1 refuses ")

    one, other = "illegal function", "illegal data address"
    assert told(2, 2, 2) == "all its requests, with 02 illegal data address."
    assert told(1, 2, 2) == "all its requests, mostly with 02 illegal data address."
    assert told(1, 1, 2, 2) == f"all its requests, with 01 {one} or 02 {other}."
    assert told(1, 2, 3) == f"all its requests, with 01 {one}, 02 {other} or others."


def test_many_units_that_refuse_are_told_as_one() -> None:
    records = [one for unit in range(1, 6) for one in refused(1, unit, 2, 2, 2)]
    told = judged(records)
    assert told.sentence == (
        "All 5 units refuse all their requests (15), with 02 illegal data address."
    )
    assert judged([*records, *polled(3, unit=9)]).sentence.endswith("; everything else is well.")


def test_a_warning_of_a_manual_is_a_small_thing() -> None:
    finding = Finding(code="FA3-X6", message="", ts_ns=0, link="rs485", unit=1)
    assert judged(polled(20), finding).level == "doubt"
    finding = Finding(code="TCP-101", message="", ts_ns=0, link="rs485", unit=1)
    assert judged(polled(20), finding).level == "well"


def test_an_error_of_a_rule_is_no_alarm() -> None:
    finding = Finding(code="MB-104", message="", ts_ns=0, link="rs485", unit=1)
    told = judged(polled(20), finding)
    assert told.level == "doubt"
    assert told.sentence.startswith("Nothing grave, but worth a look: MB-104, 1 time: ")


def test_an_empty_capture_is_said() -> None:
    assert judged([]).sentence == "There is no transaction in the capture."
    assert judged([]).level == "doubt"
    broadcast = asked(0, 0, Outcome.BROADCAST, None)
    assert judged([broadcast]).sentence.startswith("There are only broadcasts")
    unasked = msgspec.structs.replace(asked(0), outcome=Outcome.UNSOLICITED, request_ns=None)
    verdict = judged([unasked])
    assert verdict.sentence == "No trouble shows, but no request is answered."
    assert verdict.level == "doubt"
