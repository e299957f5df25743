from __future__ import annotations

import random
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices import Assignments, DifferenceKind, Namer, Span, load_profile, parse_assignment
from mbtool.modbus import Outcome, Table, Transaction
from mbtool.replay.comparing import MIN_VALUES
from mbtool.replay.judging import MAX_OUTCOMES, ResponseJudge, Tolerance
from mbtool.replay.script import Script, Step
from tests.replay.recorded import MS, answered, to_all, unanswered

if TYPE_CHECKING:
    from collections.abc import Sequence

READ = "03 000A 0002"
VALUES = "03 04 0007 0008"
AT1M8X = load_profile("fa3-at1m8x")


def _step(transaction: Transaction, device: str | None = None) -> Step:
    namer = Namer(Assignments([parse_assignment(f"all={device}")] if device else []))
    (step,) = Script.of([namer.name(transaction)]).steps
    return step


def _told(judge: ResponseJudge) -> list[tuple[str, str | None, str, str, int | None]]:
    return [
        (one.kind.value, one.reference, one.a.text, one.b.text, one.b.count)
        for one in judge.differences()
    ]


def _judged(transaction: Transaction, answer: str | None, times: int = 1) -> ResponseJudge:
    judge = ResponseJudge()
    for _ in range(times):
        judge.judge(_step(transaction), None if answer is None else bytes.fromhex(answer), 5 * MS)
    return judge


def test_the_recorded_answer_is_right() -> None:
    judge = _judged(answered(0, READ, VALUES), VALUES, times=3)
    assert (judge.count, judge.wrong, judge.differences()) == (3, 0, [])


@given(st.lists(st.integers(0, 0xFFFF), min_size=2, max_size=2))
def test_exactly_the_registers_that_differ_are_reported(values: list[int]) -> None:
    answer = "03 04" + "".join(f"{value:04X}" for value in values)
    told = _told(_judged(answered(0, READ, VALUES), answer, times=2))
    assert told == [
        ("value", f"holding {10 + place}", str(7 + place), str(value), 2)
        for place, value in enumerate(values)
        if value != 7 + place
    ]


def test_nothing_is_wrong_where_the_recorded_answer_was_not_captured() -> None:
    lost = msgspec.structs.replace(unanswered(0, READ), outcome=Outcome.NOT_CAPTURED)
    assert _told(_judged(lost, VALUES)) == _told(_judged(lost, None)) == []
    assert _told(_judged(unanswered(0, READ), VALUES)) != []


def test_padding_bits_do_not_count() -> None:
    assert _judged(answered(0, "01 0000 0003", "01 01 05"), "01 01 FD").wrong == 0


def test_outcomes_are_compared() -> None:
    ok = answered(0, READ, VALUES)
    refused = answered(0, READ, "83 02")
    silent = unanswered(0, READ)
    address, busy = "exception 02 illegal data address", "exception 06 server device busy"
    for transaction, answer, a, b in (
        (ok, "83 06", "ok", busy),
        (ok, None, "ok", "no answer"),
        (refused, VALUES, address, "ok"),
        (refused, "83 06", address, busy),
        (silent, VALUES, "no answer", "ok"),
    ):
        told = _told(_judged(transaction, answer, times=2))
        assert told == [("outcome", "holding 10..11", a, b, 2)]
    assert _judged(silent, None).wrong == 0


def test_an_answer_of_another_length_is_wrong() -> None:
    told = _told(_judged(answered(0, READ, VALUES), "03 02 0007"))
    assert told == [("outcome", "holding 10..11", "4 bytes of values", "2 bytes of values", 1)]


def test_a_malformed_response_is_wrong() -> None:
    judge = _judged(answered(0, READ, VALUES), "03 05 0007")
    ((kind, _, a, b, _),) = _told(judge)
    assert (kind, a) == ("outcome", "ok")
    assert b.startswith("malformed: ")


def test_a_response_to_another_function_is_wrong() -> None:
    as_function_04, refused_as_04 = "04 04 0007 0008", "84 02"
    ok, refused = answered(0, READ, VALUES), answered(0, READ, "83 02")
    for transaction, answer, recorded in (
        (ok, as_function_04, "ok"),
        (refused, refused_as_04, "exception 02 illegal data address"),
    ):
        told = _told(_judged(transaction, answer))
        assert told == [("outcome", "holding 10..11", recorded, "answer to function 04", 1)]


def test_two_equally_malformed_responses_are_compared_as_bytes() -> None:
    told = _told(_judged(answered(0, READ, "03 04 0007"), "03 04 0009"))
    assert told == [("outcome", "holding 10..11", "03 04 00 07", "03 04 00 09", 1)]


def test_bytes_that_differ_late_are_shown_too() -> None:
    text = "2B 0E 01 01 00 00 01 00 14" + 19 * " 41"
    told = _told(_judged(answered(0, "2B 0E 01 00", text + " 31"), text + " 32"))
    assert [(a, b) for _, _, a, b, _ in told] == [("byte 28: 31", "byte 28: 32")]


def test_the_number_of_different_outcomes_is_bounded() -> None:
    step, judge = _step(answered(0, "0B", "0B 0000 0000")), ResponseJudge()
    for count in range(1, 1001):
        judge.judge(step, bytes.fromhex(f"0B 0000 {count:04X}"), None)
    told = judge.differences()
    assert (judge.wrong, len(told)) == (1000, MAX_OUTCOMES + 1)
    assert (told[-1].a.text, told[-1].b.text) == ("others", "others (984 of 1,000)")
    assert sum(one.b.count or 0 for one in told) == 1000


def test_a_difference_that_is_not_constant_has_a_count() -> None:
    judge = ResponseJudge()
    step, part = _step(answered(0, READ, VALUES)), _step(answered(0, "03 000B 0001", "03 02 0008"))
    for answer in (VALUES, None, "03 04 0007 0009", VALUES):
        judge.judge(step, None if answer is None else bytes.fromhex(answer), None)
    judge.judge(part, bytes.fromhex("03 02 0008"), None)
    assert _told(judge) == [
        ("outcome", "holding 10..11", "ok", "no answer (1 of 4)", 1),
        ("value", "holding 11", "8", "9 (1 of 5)", 1),
    ]


def test_an_acknowledgement_of_another_write_is_wrong() -> None:
    told = _told(_judged(answered(0, "06 0001 0007", "06 0001 0007"), "06 0001 0008"))
    assert told == [("outcome", "holding 1", "06 00 01 00 07", "06 00 01 00 08", 1)]


def test_functions_without_registers_are_compared_as_bytes() -> None:
    told = _told(_judged(answered(0, "42 00", "42 0016"), "42 0017"))
    assert told == [("outcome", None, "42 00 16", "42 00 17", 1)]


def test_a_broadcast_has_no_answer_to_compare() -> None:
    assert _judged(to_all(0, "06 0001 0007"), None).wrong == 0


def test_registers_that_may_differ_do_not_count() -> None:
    judge = ResponseJudge(spans=[Span(Table.HOLDING_REGISTERS, 10, 10)])
    step = _step(answered(0, READ, VALUES))
    assert judge.judge(step, bytes.fromhex("03 04 0001 0008"), None)
    assert not judge.judge(step, bytes.fromhex("03 04 0001 0009"), None)
    assert [told[1] for told in _told(judge)] == ["holding 11"]


def test_registers_that_differ_can_be_learned() -> None:
    judge = ResponseJudge(learns=True)
    assert judge.judge(_step(answered(0, READ, VALUES)), bytes.fromhex("03 04 0001 0002"), None)
    assert judge.judge(
        _step(answered(0, "03 0020 0001", "03 02 0007", unit=2)), bytes.fromhex("03 02 0008"), None
    )
    assert not judge.judge(_step(answered(0, READ, VALUES)), bytes.fromhex("83 02"), None)
    assert judge.learned() == [
        (1, Span(Table.HOLDING_REGISTERS, 10, 11)),
        (2, Span(Table.HOLDING_REGISTERS, 0x20, 0x20)),
    ]
    assert [told[0] for told in _told(judge)] == ["outcome"]


def _late(
    recorded_ms: Sequence[float], answered_ms: Sequence[float], tolerance: Tolerance | None
) -> ResponseJudge:
    """ResponseJudge right answers to one request with these latencies."""
    judge = ResponseJudge(tolerance=tolerance)
    for before, after in zip(recorded_ms, answered_ms, strict=True):
        step = _step(answered(0, READ, VALUES, latency_ns=round(before * MS)))
        judge.judge(step, bytes.fromhex(VALUES), round(after * MS))
    return judge


def test_latencies_count_if_the_user_gives_a_tolerance() -> None:
    def judged(tolerance: Tolerance | None, ms: int) -> list[DifferenceKind]:
        judge = _late([5] * 20, [ms] * 20, tolerance)
        return [one.kind for one in judge.differences()]

    assert judged(None, 500) == []
    assert judged(Tolerance(share=0.5), 7) == []
    assert judged(Tolerance(share=0.5), 8) == [DifferenceKind.LATENCY]
    assert judged(Tolerance(share=0.0), 6) == []
    assert judged(Tolerance(share=0.5), 1) == []  # Sooner is no fault.


def test_too_few_latencies_are_not_compared_and_counted() -> None:
    for count, kinds in ((MIN_VALUES - 1, []), (MIN_VALUES, [DifferenceKind.LATENCY])):
        judge = _late([5] * count, [500] * count, Tolerance())
        assert [one.kind for one in judge.differences()] == kinds
        assert judge.uncompared_latencies() == (0 if kinds else 1)
    assert _late([5], [500], None).uncompared_latencies() == 0
    assert _judged(unanswered(0, READ), None).uncompared_latencies() == 0


def test_a_few_very_late_answers_are_no_difference() -> None:
    late = [1000 if number % 5 == 0 else 5 for number in range(40)]
    assert _late([5] * 40, late, Tolerance()).differences() == []


def test_waiting_for_a_processor_is_no_slower_slave_and_a_slower_slave_is_found_beside_it() -> None:
    chance = random.Random(3)
    recorded = [20 + chance.uniform(-2, 2) for _ in range(40)]
    waits = [chance.choice((0.5, 1, 10, 20, 30)) for _ in recorded]
    for factor, kinds in ((1.0, []), (1.5, [DifferenceKind.LATENCY])):
        answered_ms = [ms * factor + wait for ms, wait in zip(recorded, waits, strict=True)]
        judge = _late(recorded, answered_ms, Tolerance(share=0.2))
        assert [one.kind for one in judge.differences()] == kinds


def test_many_requests_that_are_no_slower_are_not_told_as_slower() -> None:
    """The level holds for all requests together: of 200 judges, each of 20 requests, few err."""
    chance = random.Random(7)
    wrong = 0
    for _ in range(200):
        judge = ResponseJudge(tolerance=Tolerance(least_ns=0))
        for address in range(20):
            step = _step(answered(0, f"03 {address:04X} 0001", "03 02 0001"))
            for _ in range(10):
                step = replace(step, latency_ns=round(chance.uniform(4, 6) * MS))
                judge.judge(step, bytes.fromhex("03 02 0001"), round(chance.uniform(4, 6) * MS))
        wrong += bool(judge.differences())
    assert wrong <= 8  # 1 % are 2 of 200; more than 8 happen once in 5,000 times.


def test_writes_of_other_values_are_one_request() -> None:
    judge = ResponseJudge(tolerance=Tolerance())
    for value in range(10):
        pdu = f"06 0001 {value:04X}"
        step = _step(answered(0, pdu, pdu))
        judge.judge(step, bytes.fromhex(pdu if value else "86 04"), 50 * MS)
    assert [(told[0], told[1], told[3]) for told in _told(judge)] == [
        ("outcome", "holding 1", "exception 04 server device failure (1 of 10)"),
        ("latency", "holding 1", "50 ms, p95 50 ms"),
    ]
    (report,) = judge.requests()
    assert (report.count, report.different, report.time_ns) == (10, 1, 500 * MS)
    assert report.problems == [
        "recorded ok, answered exception 04 server device failure (1 of 10)",
        "recorded 5 ms, p95 5 ms, answered 50 ms, p95 50 ms",
    ]


def test_a_request_is_reported_with_the_registers_that_differ() -> None:
    judge = _judged(answered(0, READ, VALUES), "03 04 0007 0009")
    (report,) = judge.requests()
    assert (report.reference, report.registers) == ("holding 10..11", ["holding 11"])
    (other,) = _judged(answered(0, "42 00", "42 0016"), "42 0017").requests()
    assert (other.reference, other.problems) == (
        "42 00",
        ["recorded 42 00 16, answered 42 00 17"],
    )


def test_values_are_formatted_by_the_device() -> None:
    judge = ResponseJudge(profiles={AT1M8X.name: AT1M8X})
    step = _step(answered(0, "03 0102 0001", "03 02 005C"), "fa3-at1m8x")
    judge.judge(step, bytes.fromhex("03 02 00FF"), None)
    (found,) = judge.differences()
    assert (found.reference, found.name) == ("0102H", "A/D conversion enable/disable setting")
    assert (found.a.text, found.b.text) == ("CH1 CH2 CH6 CH8 enabled", "none enabled")


@given(st.binary(min_size=1, max_size=253), st.none() | st.binary(min_size=1, max_size=253))
def test_no_response_raises_an_error(expected: bytes, answer: bytes | None) -> None:
    judge = ResponseJudge()
    judge.judge(_step(answered(0, READ, expected.hex())), answer, None)
    assert judge.wrong == len(judge.differences()) or judge.wrong == 1
