"""Two masters on one line: a second one asks while the first waits for its response."""

from __future__ import annotations

import pytest

from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.decode.connections import Bus
from mbtool.decode.pairing import ENOUGH_OVERTAKEN, RECENT_REQUESTS
from mbtool.modbus import Outcome, Transaction, rtu_adu
from tests.feeding import Line

FORMAT = SerialFormat(19200, 8, "E", 1)
MS = 1_000_000
READ = bytes.fromhex("03 006B 0001")
ANSWER = bytes.fromhex("03 02 022B")
FIRST, SECOND, THIRD = 1, 2, 3


def asked(unit: int) -> bytes:
    return rtu_adu(unit, READ)


def told(unit: int) -> bytes:
    return rtu_adu(unit, ANSWER)


def exchanges(line: Line, rounds: int = 5) -> Line:
    """Let one master poll the three units in turn."""
    for _ in range(rounds):
        for unit in (FIRST, SECOND, THIRD):
            line.frame(asked(unit), 30 * MS).frame(told(unit), 10 * MS)
    return line


def overtaken(line: Line, *responses: int, after_ns: int = 3 * MS) -> Line:
    """Let a second master ask SECOND `after_ns` after FIRST was asked, then the units respond."""
    line.frame(asked(FIRST), 30 * MS).frame(asked(SECOND), after_ns)
    for unit in responses:
        line.frame(told(unit), 10 * MS)
    return line


def heard(line: Line, *, timed: bool = True) -> list[Transaction | WireEvent]:
    bus = Bus("line", FORMAT, timed=timed)
    decoded = [one for data, ts_ns in line.reads() for one in bus.feed(data, ts_ns)]
    decoded += bus.close()
    return [one for one in decoded if isinstance(one, Transaction | WireEvent)]


def outcomes(decoded: list[Transaction | WireEvent]) -> list[tuple[int | None, Outcome]]:
    return [(one.unit, one.outcome) for one in decoded if isinstance(one, Transaction)]


def warnings(decoded: list[Transaction | WireEvent]) -> list[WireEvent]:
    return [
        one for one in decoded if isinstance(one, WireEvent) and one.kind is EventKind.TWO_MASTERS
    ]


@pytest.mark.parametrize("order", [(FIRST, SECOND), (SECOND, FIRST)])
def test_both_masters_get_their_responses(order: tuple[int, int]) -> None:
    line = exchanges(overtaken(exchanges(Line(FORMAT)), *order))
    assert outcomes(heard(line))[15:17] == [(unit, Outcome.OK) for unit in order]


def test_without_times_one_overtaken_request_may_have_been_given_up() -> None:
    line = exchanges(overtaken(exchanges(Line(FORMAT)), FIRST, SECOND))
    decoded = heard(line, timed=False)
    assert outcomes(decoded)[15:18] == [
        (FIRST, Outcome.LATE), (SECOND, Outcome.OK), (FIRST, Outcome.OK),
    ]  # fmt: skip
    assert not warnings(decoded)


def test_without_times_several_overtaken_requests_show_two_masters() -> None:
    line = exchanges(Line(FORMAT))
    for _ in range(ENOUGH_OVERTAKEN - 1):
        exchanges(overtaken(line, FIRST, SECOND))
    overtaken(line, SECOND, FIRST)
    decoded = heard(exchanges(line), timed=False)
    assert outcomes(decoded)[-17:-15] == [(SECOND, Outcome.OK), (FIRST, Outcome.OK)]
    assert len(warnings(decoded)) == 1


def test_without_times_rare_late_responses_are_not_called_two_masters() -> None:
    line = exchanges(Line(FORMAT))
    for _ in range(ENOUGH_OVERTAKEN):
        exchanges(overtaken(line, FIRST, SECOND), RECENT_REQUESTS // 6 + 1)
    assert not warnings(heard(exchanges(line), timed=False))


def test_two_masters_are_told_once() -> None:
    line = exchanges(Line(FORMAT))
    for _ in range(6):
        exchanges(overtaken(line, FIRST, SECOND), 1)
    assert len(warnings(heard(line))) == 1


def test_one_overtaken_request_is_not_called_two_masters() -> None:
    assert not warnings(heard(exchanges(overtaken(exchanges(Line(FORMAT)), FIRST, SECOND))))


def test_response_after_the_master_gave_up_stays_late() -> None:
    line = exchanges(Line(FORMAT))
    overtaken(line, FIRST, SECOND, after_ns=300 * MS)
    assert outcomes(heard(exchanges(line)))[15:18] == [
        (FIRST, Outcome.LATE), (SECOND, Outcome.OK), (FIRST, Outcome.OK),
    ]  # fmt: skip


def test_overtaken_request_without_response_has_no_answer() -> None:
    line = exchanges(overtaken(exchanges(Line(FORMAT)), SECOND))
    assert outcomes(heard(line))[15:18] == [
        (SECOND, Outcome.OK), (FIRST, Outcome.NO_ANSWER), (FIRST, Outcome.OK),
    ]  # fmt: skip


def test_first_of_two_overtaken_requests_has_no_answer() -> None:
    line = overtaken(exchanges(Line(FORMAT)))
    line.frame(asked(THIRD), 3 * MS).frame(told(SECOND), 10 * MS).frame(told(THIRD), 10 * MS)
    assert outcomes(heard(exchanges(line)))[15:18] == [
        (SECOND, Outcome.OK), (THIRD, Outcome.OK), (FIRST, Outcome.NO_ANSWER),
    ]  # fmt: skip


def test_requests_without_response_end_with_the_line() -> None:
    line = overtaken(exchanges(Line(FORMAT)))
    decoded = heard(line)
    assert outcomes(decoded)[15:] == [
        (FIRST, Outcome.NO_ANSWER), (SECOND, Outcome.NO_ANSWER),
    ]  # fmt: skip
