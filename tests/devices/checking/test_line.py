from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.line import MIN_TRANSACTIONS, LineRules
from mbtool.devices.checking.sliding_window import MAX_ENTRIES
from mbtool.modbus.adu import Verdict
from tests.devices.checking.talk import assigned, line_event, transaction

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

FORMAT = SerialFormat(19200)
PATIENT = str(
    Path(__file__).resolve().parents[3] / "captures" / "findings" / "slave-of-smartaxis.toml"
)
EIGHT_BYTES_MS = 8 * FORMAT.character_ns / 1e6


def on_line(*of: Any, **fields: Any) -> NamedTransaction:
    return transaction(*of, on_a_line=True, **fields)


def findings(
    *records: NamedTransaction | WireEvent,
    format_: SerialFormat | None = FORMAT,
    profile: str | None = None,
    exact: bool = False,
) -> list[Finding]:
    rules, found = LineRules(lambda _: exact), list[Finding]()
    for record in records:
        if isinstance(record, WireEvent):
            found += rules.event(record)
        else:
            device = assigned(profile).profile_for(record)
            found += rules.transaction(record, device, format_)
    return [*found, *rules.close()]


def codes(*records: NamedTransaction | WireEvent, **options: Any) -> list[str]:
    return [one.code for one in findings(*records, **options)]


@pytest.mark.parametrize(
    ("verdict", "code"),
    [
        (Verdict.T1_5_BROKEN, "RTU-101"),
        (Verdict.SPLIT, "RTU-102"),
        (Verdict.GLUED, "RTU-103"),
    ],
)
def test_broken_silences_are_one_finding_for_a_unit(verdict: Verdict, code: str) -> None:
    good = [on_line(at_ms=at) for at in range(0, 20_000, 1000)]
    bad = [on_line(at_ms=at, unit=2, verdicts=(verdict,)) for at in range(500, 3500, 1000)]
    fine = [on_line(at_ms=at, unit=2) for at in range(5500, 17500, 1000)]
    (one,) = findings(*good, *bad, *fine)
    assert (one.code, one.unit, one.count) == (code, 2, 3)
    assert one.ts_ns == bad[0].start_ns
    assert one.message.endswith("in 3 of the unit's 15 transactions")
    assert codes(*good, *bad, *fine, on_line(at_ms=18_500, unit=2)) == []


@pytest.mark.parametrize("verdict", [Verdict.T1_5_BROKEN, Verdict.SPLIT, Verdict.GLUED])
def test_a_late_read_now_and_then_is_a_remark(verdict: Verdict) -> None:
    late = [on_line(at_ms=1000 * at, unit=at, verdicts=(verdict,)) for at in range(1, 6)]
    good = [on_line(at_ms=1000 * at + 500, unit=at % 5 + 1) for at in range(40)]
    rules = LineRules()
    assert not [one for each in (*late, *good) for one in rules.transaction(each, None, FORMAT)]
    assert not [*rules.close()]
    (remark,) = rules.remarks
    assert remark.startswith("rs485: ")
    assert " in 5 of 45 transactions; so few are probably late reads" in remark


def test_many_broken_silences_are_the_adapters() -> None:
    glued = [on_line(at_ms=1000 * at, verdicts=(Verdict.GLUED,)) for at in range(MIN_TRANSACTIONS)]
    assert codes(*glued) == ["RTU-104"]
    assert codes(*glued[:-1]) == ["RTU-103"]
    good = [on_line(at_ms=1000 * at) for at in range(MIN_TRANSACTIONS, 4 * MIN_TRANSACTIONS)]
    assert codes(*glued, *good) == ["RTU-104"]
    assert codes(*glued, *good, on_line(at_ms=100_000)) == ["RTU-103"]


def test_silences_longer_than_t1_5_are_not_the_adapters() -> None:
    paused = [on_line(at_ms=1000 * at, verdicts=(Verdict.T1_5_BROKEN,)) for at in range(20)]
    assert codes(*paused) == ["RTU-101"]


def test_damage_is_found() -> None:
    error = line_event(EventKind.LINE_ERROR, message="a parity error")
    assert [(one.code, one.message) for one in findings(error)] == [("RTU-203", "a parity error")]


def test_stray_bytes_are_found_between_frames_and_not_around_them() -> None:
    stray = line_event(EventKind.SKIPPED)
    assert codes(on_line(), stray, on_line(at_ms=100)) == ["RTU-202"]
    assert codes(on_line(), stray, stray, on_line(at_ms=100)) == ["RTU-202", "RTU-202"]
    assert codes(stray, on_line(at_ms=100)) == []
    assert codes(on_line(), stray) == []


@pytest.mark.parametrize("pdu", ["10 0000 0001 02 1234", "0F 0000 0001 01 01", "06 0000 0001"])
def test_an_answer_to_a_broadcast_is_found(pdu: str) -> None:
    sent = on_line(pdu, None, unit=0)
    echo = pdu if pdu.startswith("06") else pdu[:12]
    answer = on_line(echo, None, at_ms=10) if echo == pdu else on_line("", echo, at_ms=10)
    (one,) = findings(sent, answer)
    assert one.code == "MB-301"
    assert one.message.startswith("unit 1 answers the broadcast write ")


def test_late_or_different_frames_are_no_response_to_a_broadcast() -> None:
    sent = on_line("06 0000 0001", None, unit=0)
    assert codes(sent, on_line("06 0000 0001", "06 0000 0001", at_ms=150)) == []
    assert codes(sent, on_line("06 0000 0002", None, at_ms=150)) == []
    assert codes(sent, on_line("", "06 0000 0001", at_ms=1500)) == []
    assert codes(sent, on_line(at_ms=150), on_line("", "06 0000 0001", at_ms=200)) == []


def test_a_broadcast_that_reads_is_found() -> None:
    assert codes(on_line("03 0000 0001", None, unit=0)) == ["MB-302"]
    assert codes(on_line("06 0000 0001", None, unit=0)) == []
    assert codes(on_line("08 0004 0000", None, unit=0)) == []
    assert codes(on_line("41 00", None, unit=0)) == []


def test_a_master_that_does_not_wait_after_a_broadcast_is_found() -> None:
    sent = on_line("06 0000 0001", None, unit=0)
    soon = on_line(at_ms=40 + EIGHT_BYTES_MS)
    (one,) = findings(sent, soon)
    assert (one.code, one.unit) == ("RTU-302", None)
    assert (
        one.message == "1 request sooner than 100 ms after a broadcast; the soonest after 40.0 ms"
    )
    assert codes(sent, on_line(at_ms=101 + EIGHT_BYTES_MS)) == []
    assert codes(sent, soon, format_=None) == []


def test_a_master_faster_than_the_manual_allows_is_found() -> None:
    first = on_line(unit=8, latency_ms=10)
    soon = [on_line(unit=8, at_ms=10 + gap + EIGHT_BYTES_MS) for gap in (3, 1)]
    (one,) = findings(first, soon[0], first, soon[1], profile=PATIENT)
    assert (one.code, one.unit, one.count) == ("RTU-301", 8, 2)
    assert (
        one.message == "2 requests sooner than 5ms after the frame before; the soonest after 1.0 ms"
    )
    in_time = on_line(unit=8, at_ms=15 + EIGHT_BYTES_MS)
    assert codes(first, in_time, profile=PATIENT) == []
    assert codes(first, soon[0]) == []
    assert codes(first, soon[0], profile="idec-ft1a-smartaxis") == []  # No rule of the slave's.
    assert codes(first, soon[0], profile=PATIENT, format_=None) == []


@pytest.mark.parametrize(
    ("torn", "whole", "glued", "codes_of_line"),
    [(8, 0, 0, ["RTU-102"]), (8, 4, 0, ["RTU-104"]), (8, 0, 1, ["RTU-104"]), (7, 0, 0, [])],
)
def test_a_master_that_tears_its_requests_is_told_from_an_adapter(
    torn: int, whole: int, glued: int, codes_of_line: list[str]
) -> None:
    only = (Verdict.SPLIT, Verdict.ONLY_REQUEST_SPLIT)
    cases = [only] * torn + [(Verdict.SPLIT,)] * whole + [(Verdict.GLUED,)] * glued
    records = [on_line(at_ms=1000 * at, verdicts=one) for at, one in enumerate(cases)]
    found = findings(*records)
    if torn < 8:  # Too few transactions for a word about adapters: RTU-102 as for any frame.
        assert [one.message for one in found] == [
            "a silence of t3.5 or longer inside a frame in 7 of the unit's 7 transactions"
        ]
        return
    assert [one.code for one in found] == codes_of_line
    if codes_of_line == ["RTU-102"]:
        assert found[0].message == (
            "a silence of t3.5 or longer in 8 of 8 requests, and in no more than 5% of the "
            "responses: the master tears them"
        )


def test_one_character_is_forgiven_only_where_bytes_have_no_exact_times() -> None:
    first = on_line(unit=8, latency_ms=10)
    nearly = on_line(unit=8, at_ms=10 + 4.8 + EIGHT_BYTES_MS)  # A character takes 0.57 ms.
    assert codes(first, nearly, profile=PATIENT) == []
    assert codes(first, nearly, profile=PATIENT, exact=True) == ["RTU-301"]


def test_a_clock_that_was_set_back_gives_no_finding() -> None:
    assert codes(on_line(at_ms=1000), on_line(), profile=PATIENT) == []


def test_memory_is_bounded() -> None:
    rules = LineRules()
    for number in range(MAX_ENTRIES + 10):
        event = WireEvent(ts_ns=0, link=f"line {number}", kind=EventKind.SKIPPED, message="")
        assert not [*rules.event(event)]
    assert len(rules._lines) == MAX_ENTRIES
