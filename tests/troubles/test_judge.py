"""What is said of units that made captures show, and in which order."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest

from mbtool.core import EventKind
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.rules import Severity
from mbtool.ledger import account
from mbtool.modbus import Outcome
from mbtool.troubles.judge import MIN_ANSWERED, Judge
from tests.ledger.test_account_over_time import asked, event
from tests.troubles.judging import counted_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core import WireEvent
    from mbtool.devices import NamedTransaction
    from mbtool.troubles.judge import Judgement
    from mbtool.troubles.trouble import Trouble


def judged(records: Sequence[NamedTransaction | WireEvent], *findings: Finding) -> Judgement:
    judge = Judge(counted_of(records))
    for record in records:
        judge.hear(record)
    for finding in findings:
        judge.note(finding)
    return judge.judgement()


def causes(records: Sequence[NamedTransaction | WireEvent], *findings: Finding) -> list[str]:
    return [one.cause for one in judged(records, *findings).troubles]


def only(records: Sequence[NamedTransaction | WireEvent]) -> Trouble:
    (trouble,) = judged(records).troubles
    return trouble


def polled(seconds: int, failing: range = range(0), unit: int = 1) -> list[NamedTransaction]:
    return [
        asked(at, unit, Outcome.NO_ANSWER, None) if at in failing else asked(at, unit)
        for at in range(seconds)
    ]


@pytest.mark.parametrize(
    ("failing", "said"),
    [
        (range(60, 100), "all its 40 requests since 22:14:20 without an answer"),
        (range(30), "all its 30 requests until 22:13:49 without an answer"),
        (
            range(30, 60),
            "all its 30 requests from 22:13:50 to 22:14:19 without an answer",
        ),
        (range(0, 40, 2), "20 of its 39 requests until 22:13:58 (51 %) without an answer"),
        (range(0, 100, 4), "25 of its 100 requests (25 %) without an answer"),
    ],
)
def test_the_share_is_of_the_time_in_which_it_shows(failing: range, said: str) -> None:
    trouble = only(polled(100, failing))
    assert (trouble.code, trouble.cause) == ("UNIT-MISSING", f"unit 1 leaves {said}")
    assert [one.ts_ns for one in trouble.evidence] == [
        one.start_ns for one in polled(100, failing) if one.outcome is Outcome.NO_ANSWER
    ]


def test_a_unit_that_left_its_only_request_unanswered_is_a_note() -> None:
    trouble = only([asked(1, 5, Outcome.NO_ANSWER, None), *polled(20)])
    assert (trouble.code, trouble.severity) == ("UNIT-SILENT", Severity.NOTE)
    trouble = only([asked(at, 5, Outcome.NO_ANSWER, None) for at in (1, 2)] + polled(20))
    assert (trouble.code, trouble.severity) == ("UNIT-SILENT", Severity.ERROR)


def test_rare_failures_are_notes() -> None:
    told = judged(polled(1000, range(500, 502)))
    assert told.level == "doubt"
    (trouble,) = told.troubles
    assert trouble.severity is Severity.NOTE
    assert trouble.cause == "unit 1 leaves 2 of its 1,000 requests without an answer"


def test_a_unit_that_became_slower_is_told_since_when() -> None:
    assert causes([asked(at, latency_ms=5 if at < 60 else 45) for at in range(100)]) == [
        "unit 1 answers slower since 22:14:19: in 45.0 ms on average, before in 5.0 ms"
    ]


def test_a_unit_that_is_slow_and_fast_in_turn_is_not_told_to_be_slower() -> None:
    times = {at: 45 if at >= 60 and at % 20 < 10 else 5 for at in range(100)}
    assert causes([asked(at, latency_ms=latency_ms) for at, latency_ms in times.items()]) == []


def test_a_trouble_of_many_units_is_told_once_with_the_others_behind_it() -> None:
    trouble = only(
        [
            asked(at, unit, latency_ms=5 if at < 60 else 45 + unit)
            for at in range(100)
            for unit in range(4)
        ]
    )
    assert trouble.cause == (
        "unit 3 answers slower since 22:14:19: in 48.0 ms on average, before in 5.0 ms; "
        "3 more units likewise"
    )
    assert [one.unit for one in trouble.all] == [3, 2, 1, 0]


def test_a_dead_unit_is_told_with_what_the_capture_cuts() -> None:
    trouble = only([*polled(20, range(20)), asked(20, 1, Outcome.NOT_CAPTURED, None)])
    assert trouble.cause == "unit 1 never answers (20 requests, and 1 not captured whole)"
    assert trouble.severity is Severity.ERROR


def test_many_slow_units_are_a_note_as_they_may_be_of_a_slow_kind() -> None:
    records = [
        asked(at, unit, latency_ms=120 if unit < 4 else 5) for at in range(20) for unit in range(16)
    ]
    trouble = only(records)
    assert trouble.severity is Severity.WARNING
    assert trouble.cause == (
        "unit 0 is slow: half of its answers take 120 ms or more, those of most others 5.0 ms or "
        "less; 3 more units likewise"
    )
    assert only([one for one in records if one.unit < 8]).severity is Severity.NOTE
    quick = [
        asked(at, unit, latency_ms=90 if unit == 4 else 5) for at in range(20) for unit in range(16)
    ]
    assert only(quick).severity is Severity.NOTE


def test_the_worst_come_first() -> None:
    records = [*polled(50, range(0, 50, 2), 1), *polled(50, range(50), 2), *refused(1, 3, *[2] * 9)]
    codes = [one.code for one in judged([*records, *polled(50, unit=9)]).troubles]
    assert codes == ["UNIT-SILENT", "UNIT-MISSING", "UNIT-REFUSES"]


def test_an_attack_is_told_by_who_makes_it() -> None:
    finding = Finding(
        code="SEC-201", message="", ts_ns=0, link="rs485", source="10.0.0.66:50000", unit=1
    )
    (trouble,) = judged(polled(20), finding).troubles
    assert trouble.who == "10.0.0.66"
    assert trouble.cause == (
        "a host asks many addresses, and polls none of them (SEC-201, 1 time at 10.0.0.66)"
    )


def test_a_unit_whose_answers_are_all_damaged_is_not_called_dead() -> None:
    records = [
        one
        for at in range(20)
        for one in (event(at + 0.02, EventKind.BAD_CHECK), asked(at, 1, Outcome.NO_ANSWER, None))
    ]
    assert causes([*records, *polled(20, unit=2)]) == [
        "unit 1 answers all its requests with a wrong CRC"
    ]


def refused(at: float, unit: int, *codes: int) -> list[NamedTransaction]:
    one = asked(at, unit, Outcome.EXCEPTION)
    return [
        msgspec.structs.replace(one, exception=code, exception_name=f"name {code}")
        for code in codes
    ]


def test_the_codes_of_refusals_are_told_as_often_as_they_came() -> None:
    def told(*codes: int) -> str:
        return only(refused(1, 1, *codes)).cause.removeprefix(
            f"unit 1 refuses all its {len(codes)} requests, with "
        )

    one, other = "illegal function", "illegal data address"
    assert told(2, 2, 2) == "02 illegal data address"
    assert told(1, 2, 2) == f"02 {other} or 01 {one}"
    assert told(1, 2, 3) == f"01 {one}, 02 {other} or others"


def test_the_remedy_of_a_refusal_depends_on_its_code() -> None:
    assert only(refused(1, 1, 2, 2, 2)).remedy.startswith("correct the address or quantity")
    assert only(refused(1, 1, 11, 11, 11)).remedy.startswith("check the unit behind the gateway")


def read(
    at: float, unit: int, address: int, outcome: Outcome = Outcome.EXCEPTION
) -> NamedTransaction:
    code = 2 if outcome is Outcome.EXCEPTION else None
    return msgspec.structs.replace(
        asked(at, unit, outcome=outcome), address=address, quantity=2,
        reference=f"holding {address}", exception=code,
        exception_name=None if code is None else "illegal data address",
    )  # fmt: skip


def test_requests_that_are_refused_each_time_are_named() -> None:
    fine = [read(at, 1, 5, Outcome.OK) for at in range(30)]
    assert causes([*fine, read(40, 1, 9), read(41, 1, 9), read(42, 1, 9)]) == [
        "unit 1 refuses 03 holding 9 each time (3 times), with 02 illegal data address"
    ]
    many = [read(40 + at, 1, address) for at in range(2) for address in range(10, 14)]
    assert causes([*fine, *many]) == [
        "unit 1 refuses 4 of its 5 different requests, such as 03 holding 10, "
        "with 02 illegal data address"
    ]


def test_requests_that_are_no_longer_known_are_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(account, "MAX_POLLS", 2)
    fine = [read(at, 1, at % 3, Outcome.OK) for at in range(30)]
    assert causes([*fine, *(read(40 + at, 1, 9) for at in range(3))]) == [
        "unit 1 refuses all its 3 requests since 22:14:00, with 02 illegal data address"
    ]


def test_many_different_requests_that_many_units_refuse_are_a_scan() -> None:
    scan = [read(9 * unit + at / 20, unit, at) for unit in range(1, 7) for at in range(60)]
    assert causes(scan) == [
        "all 6 units refuse all their 360 requests, with 02 illegal data address: "
        "360 different ones, as in a scan"
    ]


def test_broken_rules_are_troubles_and_notes_are_none() -> None:
    for code, level in (("FA3-X6", "doubt"), ("MB-104", "bad"), ("MB-404", "well")):
        finding = Finding(code=code, message="", ts_ns=0, link="rs485", unit=1)
        assert judged(polled(20), finding).level == level


def test_a_broken_rule_that_a_trouble_explains_is_told_no_second_time() -> None:
    finding = Finding(code="MB-401", message="", ts_ns=0, link=asked(0).link, unit=1)
    other = Finding(code="MB-401", message="", ts_ns=0, link=asked(0).link, unit=2)
    records = [*polled(20, range(20)), *polled(20, unit=2)]
    assert [one.code for one in judged(records, finding).troubles] == ["UNIT-SILENT"]
    assert [one.code for one in judged(records, other).troubles] == ["UNIT-SILENT", "MB-401"]


def test_green_is_said_only_if_enough_was_heard() -> None:
    told = judged(polled(MIN_ANSWERED))
    assert told.level == "well"
    assert told.summary == (
        "Everything is well: the unit answers 20 requests, half of them within 5.0 ms."
    )
    told = judged(polled(MIN_ANSWERED - 1))
    assert told.level == "doubt"
    assert told.summary == (
        "Too short to judge in 18.0 s: the unit answers 19 requests, half of them within 5.0 ms; "
        "no trouble shows."
    )


def test_an_empty_capture_is_said() -> None:
    assert judged([]).summary == "There is no transaction in the recording."
    assert judged([]).level == "doubt"
    broadcast = asked(0, 0, Outcome.BROADCAST, None)
    assert judged([broadcast]).summary.startswith("There are only broadcasts")
    unasked = msgspec.structs.replace(asked(0), outcome=Outcome.UNSOLICITED, request_ns=None)
    verdict = judged([unasked])
    assert verdict.summary == "No trouble shows, but no request is answered."
    assert verdict.level == "doubt"
