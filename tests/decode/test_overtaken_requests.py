"""Requests of a serial line that another request overtakes, and when they are given up."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from mbtool.core import EventKind, WireEvent
from mbtool.decode.pairing import (
    BUS_TIMEOUT_NS,
    EVEN,
    Pairing,
    waits_before_any_retry,
)
from mbtool.decode.transactions import Ends
from mbtool.modbus.adu import Verdict
from mbtool.modbus.transaction import Outcome, Transaction
from mbtool.serial_line.line_statistics import LatencyStatistics
from tests.decode.test_pairing import ANSWER, MS, READ, WRITE, asked, outcomes, told

OK, NO_ANSWER, UNSOLICITED = Outcome.OK, Outcome.NO_ANSWER, Outcome.UNSOLICITED
SURE: tuple[list[Verdict], float] = ([], 1.0)
IN_DOUBT = [Verdict.AMBIGUOUS], EVEN

Said = list[Transaction | WireEvent]


def line(waits: bool | None) -> Pairing:
    """A line on which a master certainly waits, does not wait any more, or may do either."""
    return Pairing(Ends("rs485"), lambda _: waits)


def overtake(pairing: Pairing, at_ms: int) -> Said:
    """A request to unit 1, one to unit 2, and then the responses of both in that order."""
    adus = (
        asked(READ, at_ms),
        asked(WRITE, at_ms + 5, unit=2),
        told(ANSWER, at_ms + 10),
        told(WRITE, at_ms + 15, unit=2),
    )
    return [each for one in adus for each in pairing.feed(one)]


def rows(said: Said) -> list[tuple[int, Outcome, tuple[list[Verdict], float]]]:
    return [
        (one.unit, one.outcome, (one.verdicts, one.confidence))
        for one in said
        if isinstance(one, Transaction)
    ]


@pytest.mark.parametrize(
    ("waits", "expected"),
    [
        (True, [(1, OK, SURE), (2, OK, SURE)]),
        (None, [(1, NO_ANSWER, IN_DOUBT), (1, UNSOLICITED, IN_DOUBT), (2, OK, SURE)]),
        (False, [(1, NO_ANSWER, SURE), (1, UNSOLICITED, SURE), (2, OK, SURE)]),
    ],
)
def test_a_response_behind_another_request_is_as_sure_as_that_its_master_waits(
    waits: bool | None, expected: list[object]
) -> None:
    assert rows(overtake(line(waits), 0)) == expected


def test_a_request_that_is_in_doubt_already_is_so_once() -> None:
    pairing = line(None)
    doubtful = replace(asked(READ, 0), confidence=0.25, verdicts=(Verdict.AMBIGUOUS,))
    said = [*pairing.feed(doubtful), *pairing.feed(asked(WRITE, 5, unit=2))]
    said += pairing.feed(told(ANSWER, 10))
    assert [one[2] for one in rows(said)] == [([Verdict.AMBIGUOUS], 0.25), IN_DOUBT]


@pytest.mark.parametrize("waits", [True, None])
def test_two_masters_are_told_once_when_three_requests_were_overtaken(waits: bool | None) -> None:
    pairing = line(waits)
    before = [overtake(pairing, 100 * at) for at in range(2)]
    assert not any(isinstance(one, WireEvent) for said in before for one in said)
    said = overtake(pairing, 1000)
    (event,) = [one for one in said if isinstance(one, WireEvent)]
    assert (event.kind, event.link, event.ts_ns) == (EventKind.TWO_MASTERS, "rs485", 1010 * MS)
    # From now on it is sure that both masters wait.
    later = overtake(pairing, 1100)
    assert rows(said) == rows(later) == [(1, OK, SURE), (2, OK, SURE)]
    assert not any(isinstance(one, WireEvent) for one in later)


@pytest.mark.parametrize(("too_many", "events"), [(0, 1), (1, 0)])
def test_two_masters_are_told_if_three_of_the_last_hundred_requests_were_overtaken(
    too_many: int, events: int
) -> None:
    pairing = line(True)
    said = overtake(pairing, 0)
    said += overtake(pairing, 100)
    # From the first response to the last one: two requests overtaken with their overtakers.
    for at in range(100 - 1 - 4 + too_many):
        said += [
            *pairing.feed(asked(READ, 1000 + 100 * at)),
            *pairing.feed(told(ANSWER, 1005 + 100 * at)),
        ]
    said += overtake(pairing, 100_000)
    assert sum(isinstance(one, WireEvent) for one in said) == events


def test_overtaken_and_overtaking_request_are_given_up_each_in_its_time() -> None:
    pairing = line(True)
    assert not [*pairing.feed(asked(READ, 0)), *pairing.feed(asked(WRITE, 5, unit=2))]
    assert pairing.advance(MS + BUS_TIMEOUT_NS) == []
    assert rows([*pairing.advance(MS + BUS_TIMEOUT_NS + 1)]) == [(1, NO_ANSWER, SURE)]
    assert pairing.advance(6 * MS + BUS_TIMEOUT_NS) == []
    assert rows([*pairing.advance(6 * MS + BUS_TIMEOUT_NS + 1)]) == [(2, NO_ANSWER, SURE)]
    assert pairing.close() == []


def test_a_third_request_ends_the_one_that_was_overtaken_first() -> None:
    pairing = line(True)
    for unit in (1, 2):
        assert pairing.feed(asked(READ, 5 * unit, unit=unit)) == []
    assert rows(pairing.feed(asked(READ, 15, unit=3))) == [(1, NO_ANSWER, SURE)]
    assert rows(pairing.feed(told(ANSWER, 20, unit=2))) == [(2, OK, SURE)]
    assert rows(pairing.feed(told(ANSWER, 25, unit=2))) == [(2, UNSOLICITED, SURE)]
    assert rows([*pairing.close()]) == [(3, NO_ANSWER, SURE)]


@pytest.mark.parametrize("unit", [0, 2], ids=["a broadcast", "the same unit again"])
def test_a_request_that_overtakes_nothing_ends_both_that_wait(unit: int) -> None:
    pairing = line(True)
    for one in (1, 2):
        pairing.feed(asked(READ, 5 * one, unit=one))
    said = pairing.feed(asked(WRITE, 15, unit=unit))
    assert outcomes(said)[:2] == [NO_ANSWER, NO_ANSWER]


def test_a_master_waits_at_least_as_long_as_before_any_retry() -> None:
    shortest_ns = LatencyStatistics.MIN_RETRY_NS
    assert waits_before_any_retry(shortest_ns - 1) is True
    assert waits_before_any_retry(shortest_ns) is False


@pytest.mark.parametrize("lived_ms", [0, 1])
def test_a_line_asks_how_long_the_overtaken_request_has_waited(lived_ms: int) -> None:
    waited: list[int] = []

    def still_waits(waited_ns: int) -> bool:
        waited.append(waited_ns)
        return True

    pairing = Pairing(Ends("rs485"), still_waits)
    pairing.feed(asked(READ, 10))
    pairing.feed(asked(WRITE, 11 + lived_ms, unit=2))
    assert waited == [lived_ms * MS]


@pytest.mark.parametrize(
    ("latency_ms", "allowed_ns"),
    [([2000, 20], 6000 * MS), ([20], 1000 * MS), ([], 1000 * MS)],
)
def test_at_the_end_of_a_capture_a_line_has_three_times_as_long_as_its_slowest_response(
    latency_ms: list[int], allowed_ns: int
) -> None:
    for waited_ns, outcome in ((allowed_ns - 1, Outcome.NOT_CAPTURED), (allowed_ns, NO_ANSWER)):
        pairing = line(True)
        at_ms = 0
        for one_ms in latency_ms:
            pairing.feed(asked(READ, at_ms))
            pairing.feed(told(ANSWER, at_ms + 1 + one_ms))
            at_ms += 10_000
        pairing.feed(asked(READ, at_ms))
        assert outcomes(pairing.close((at_ms + 1) * MS + waited_ns)) == [outcome]


def test_at_the_end_of_a_line_without_times_nobody_knows_how_long_a_request_waited() -> None:
    pairing = Pairing(Ends("rs485", timed=False))
    pairing.feed(asked(READ, 0))
    assert outcomes(pairing.close(BUS_TIMEOUT_NS)) == [Outcome.NOT_CAPTURED]
