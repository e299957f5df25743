"""What a board keeps of records, and what that costs."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from mbtool.core import EventKind, WireEvent
from mbtool.devices import PointValue
from mbtool.modbus import Outcome, Verdict
from mbtool.modbus.response import MAX_FRAMES
from mbtool.watching import board as limits
from mbtool.watching.board import (
    Board,
    point_rows,
    poll_rows,
    record_rows,
    slave_rows,
    trouble_rows,
)
from mbtool.watching.watched_rows import kept_record
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import LINE, request, unanswered

if TYPE_CHECKING:
    import pytest

    from mbtool.watching.watched_rows import Record

CALLS_PER_TRANSACTION = 35
"""The most calls of Python functions that a board spends on one transaction of a steady poll."""


def board_of(*records: Record) -> Board:
    board = Board(lambda _: LINE)
    for order, record in enumerate(records, 1):
        board.add(kept_record(order, order, record))
    return board


def read(at_ms: float, *values: int, **fields: Any) -> Record:
    return request(at_ms, **{"response_values": list(values), "quantity": len(values), **fields})


def test_a_poll_is_one_row_with_its_last_values_and_what_changed() -> None:
    board = board_of(read(0, 1, 2), read(100, 1, 3), read(200, 1, 3))
    (row,) = poll_rows(board)
    assert (row.asked, row.values) == (3, [1, 3])
    assert row.changed_ns == (0, START_NS + 100 * MS)
    assert row.last_ns == START_NS + 200 * MS


def test_values_of_another_number_have_all_changed() -> None:
    board = board_of(read(0, 1, 2), read(100, 1, quantity=2))
    (row,) = poll_rows(board)
    assert row.changed_ns == (START_NS + 100 * MS,)


def test_an_error_keeps_the_last_values() -> None:
    board = board_of(read(0, 7), unanswered(100, quantity=1))
    (row,) = poll_rows(board)
    assert (row.values, row.errors, row.missing) == ([7], 1, 1)
    assert row.latencies == (5 * MS, None)


def test_a_request_that_is_told_late_as_unanswered_replaces_nothing_newer() -> None:
    board = board_of(read(0, 7), read(200, 8), unanswered(100, quantity=1))
    (row,) = poll_rows(board)
    assert (row.values, row.missing, row.last_ns) == ([8], 1, START_NS + 200 * MS)
    assert row.kept is board.records[1]
    (slave,) = slave_rows(board)
    assert slave.silent_since_ns is None
    assert slave.last_ns == START_NS + 205 * MS


def test_a_request_at_the_end_of_a_capture_hides_no_outcome() -> None:
    """Of a dead unit the last request of a file would hide that it gives no answer."""
    cut = unanswered(200, quantity=1, outcome=Outcome.NOT_CAPTURED, verdicts=[Verdict.CAPTURE_END])
    board = board_of(read(0, 7), unanswered(100, quantity=1), cut)
    (row,) = poll_rows(board)
    assert (row.kept.order, row.asked, row.last_ns) == (2, 3, START_NS + 200 * MS)
    (row,) = poll_rows(board_of(cut))
    assert row.kept.order == 1
    (row,) = poll_rows(board_of(cut, unanswered(100, quantity=1)))
    assert (row.kept.order, row.missing, row.last_ns) == (2, 1, START_NS + 200 * MS)


def test_the_polls_of_a_dead_unit_are_no_retries() -> None:
    """The same rule as that of `stats`: a retry repeats a request at once, not at its period."""
    dead = [unanswered(1000 * at, unit=3, retries=at) for at in range(20)]
    board = board_of(*dead)
    board.advance(None)
    assert [row.is_retry for row in record_rows(board)] == [False] * 20
    assert poll_rows(board)[0].retries == slave_rows(board)[0].retries == 0
    again = unanswered(19_100, unit=3, retries=20)
    board = board_of(*dead, again)
    board.advance(None)
    assert [row.kept.record for row in record_rows(board) if row.is_retry] == [again]
    assert poll_rows(board)[0].retries == slave_rows(board)[0].retries == 1


def test_a_filter_makes_no_retries_and_judges_no_slave() -> None:
    whole = board_of()
    failures = Board(lambda _: LINE, whole=whole)
    for at in range(12):
        one = read(1000 * at, 1) if at % 3 else unanswered(1000 * at, quantity=1, retries=1)
        kept = kept_record(at + 1, at + 1, one)
        whole.add(kept)
        if not at % 3:
            failures.add(kept)
    for board in (whole, failures):
        board.advance(None)
    assert not any(row.is_retry for row in record_rows(failures))
    (row,) = slave_rows(failures)
    assert (row.asked, row.missing, row.retries) == (4, 4, 0)
    assert poll_rows(failures)[0].retries == 0
    assert row.whole is not None
    assert (row.whole.asked, row.whole.missing, row.whole.silent_since_ns) == (12, 4, None)
    assert slave_rows(whole)[0].whole is None


def test_the_retries_that_are_kept_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "_MAX_RETRIES", 3)
    board = board_of(*(unanswered(at * at * 1000, retries=at) for at in range(9)))
    board.advance(None)
    assert slave_rows(board)[0].retries == 8
    assert [row.is_retry for row in record_rows(board)] == [False] * 6 + [True] * 3


def test_the_period_is_known_once_requests_are_in_order() -> None:
    board = board_of(*(read(at, 1) for at in range(0, 1000, 100)))
    assert poll_rows(board)[0].period_ns == 0
    board.advance(None)
    assert poll_rows(board)[0].period_ns == 100 * MS


def test_at_the_end_of_a_file_the_period_is_that_of_all_requests() -> None:
    times = [*range(0, 2000, 100), 60_000, 120_000]
    board = board_of(*(read(at, 1) for at in times))
    board.account.settle(START_NS + 50_000 * MS)
    assert poll_rows(board)[0].has_regular_period
    board.advance(None)
    assert not poll_rows(board)[0].has_regular_period


def test_registers_without_names_are_points_by_their_address() -> None:
    board = board_of(read(0, 5, 6, address=10), read(100, 5, 9, address=10))
    first, second = point_rows(board)
    assert (first.reference, first.text, first.changes) == ("holding 10", "5", 0)
    assert (second.reference, second.text, second.before) == ("holding 11", "9", "6")
    assert (second.changes, second.changed_ns) == (1, START_NS + 100 * MS)
    assert list(second.history) == [6, 9]
    assert first.last_ns == START_NS + 100 * MS


def test_a_register_knows_the_one_behind_it_for_a_float() -> None:
    first, second = point_rows(board_of(read(0, 5, 6)))
    assert (first.pair, second.pair) == ((5, 6), None)


def test_a_named_value_is_a_point_by_its_name() -> None:
    def point(text: str, value: float) -> PointValue:
        return PointValue(name="CH1 value", reference="D1", value=value, text=text, unit="V")

    board = board_of(
        read(0, 1, points=[point("1 V", 1)], device="x"),
        read(100, 2, points=[point("2 V", 2)], device="x"),
    )
    (row,) = point_rows(board)
    assert (row.name, row.text, row.before, row.value_unit) == ("CH1 value", "2 V", "1 V", "V")
    assert poll_rows(board)[0].points_changed_ns == {"CH1 value": START_NS + 100 * MS}


def test_a_write_gives_the_value_that_it_writes_only_if_it_took_effect() -> None:
    write: dict[str, Any] = {"function": 6, "quantity": None, "address": 3}
    board = board_of(
        request(0, request_values=[1], response_values=None, **write),
        request(9, request_values=[2], outcome=Outcome.EXCEPTION, exception=2, **write),
    )
    (row,) = point_rows(board)
    assert (row.text, row.is_written) == ("1", True)


def test_a_read_and_write_gives_what_it_reads_and_what_it_writes() -> None:
    board = board_of(
        read(0, 7, function=0x17, address=1, write_address=5, write_quantity=1, request_values=[9])
    )
    rows = {row.reference: (row.text, row.is_written) for row in point_rows(board)}
    assert rows == {"holding 1": ("7", False), "holding 5": ("9", True)}


def test_a_value_that_another_request_changed_is_the_last_one_though_a_poll_reads_as_before() -> (
    None
):
    written = {"function": 5, "request_values": [1], "response_values": None}
    board = board_of(
        read(0, 0, function=1), read(10, 1, **written), read(20, 0, function=1),
        read(30, 1, **written), read(40, 0, function=1),
    )  # fmt: skip
    (row,) = point_rows(board)
    assert (row.text, row.changes, row.is_written) == ("0", 4, False)
    assert row.last_ns == START_NS + 40 * MS


def test_a_slave_is_silent_since_the_first_request_without_answer() -> None:
    board = board_of(read(0, 1), unanswered(100), unanswered(200))
    (row,) = slave_rows(board)
    assert (row.asked, row.answered, row.missing) == (3, 1, 2)
    assert row.silent_since_ns == START_NS + 100 * MS
    board.add(kept_record(4, 4, read(300, 1)))
    assert slave_rows(board)[0].silent_since_ns is None


def test_findings_and_events_are_counted_by_kind_and_unit() -> None:
    event = WireEvent(ts_ns=START_NS, link="line", kind=EventKind.SKIPPED, message="noise")
    board = board_of(read(0, 1, findings=["MB-101"]), event, read(9, 1, findings=["MB-101"]))
    noise, finding = trouble_rows(board)
    assert (noise.code, noise.unit, noise.times, noise.is_finding) == ("skipped", None, 1, False)
    assert (finding.code, finding.unit, finding.times, finding.is_finding) == ("MB-101", 1, 2, True)


def event(at_ms: float, kind: EventKind) -> WireEvent:
    return WireEvent(ts_ns=START_NS + round(at_ms * MS), link="line", kind=kind, message="x")


def test_transactions_and_events_are_listed_by_time_without_connections() -> None:
    board = board_of(
        event(0, EventKind.OPENED), event(12, EventKind.BAD_CHECK), unanswered(10), read(20, 1),
        event(30, EventKind.CLOSED),
    )  # fmt: skip
    assert [row.key for row in record_rows(board)] == [3, 2, 4]
    assert {row.code for row in trouble_rows(board)} == {"opened", "bad-check", "closed"}


def test_a_damaged_answer_belongs_to_the_unit_that_was_asked() -> None:
    board = board_of(
        read(0, 1, unit=4), event(5, EventKind.BAD_CHECK), event(12, EventKind.BAD_CHECK),
        unanswered(10, unit=4), read(20, 1, unit=4),
    )  # fmt: skip
    rows = {row.key: (row.unit, row.is_damaged) for row in record_rows(board)}
    assert rows == {1: (4, False), 2: (None, False), 3: (4, False), 4: (4, True), 5: (4, False)}
    counts = {(row.unit, row.times, row.is_finding) for row in trouble_rows(board)}
    assert counts == {(None, 1, False), (4, 1, False)}


def test_the_damaged_frames_of_no_unit_are_those_that_stay() -> None:
    board = board_of(
        event(5, EventKind.BAD_CHECK), event(1000, EventKind.BAD_CHECK), unanswered(990, unit=4)
    )
    assert [
        (row.unit, row.key, row.kept.order, row.first_ns - START_NS, row.last_ns - START_NS)
        for row in trouble_rows(board)
    ] == [
        (None, ("bad-check", "line", None), 1, 5 * MS, 5 * MS),
        (4, ("bad-check", "line", 4), 2, 1000 * MS, 1000 * MS),
    ]  # fmt: skip
    board = board_of(
        event(5, EventKind.BAD_CHECK), event(1000, EventKind.BAD_CHECK), unanswered(0, unit=4)
    )
    nobodys = trouble_rows(board)[-1]
    assert (nobodys.unit, nobodys.first_ns - START_NS) == (None, 1000 * MS)


def test_of_damaged_frames_with_equal_times_only_one_belongs_to_a_request() -> None:
    frames = [event(12, EventKind.BAD_CHECK) for _ in range(2)]
    board = board_of(*frames, unanswered(10, unit=4))
    assert {row.unit: row.times for row in trouble_rows(board)} == {None: 1, 4: 1}
    board.add(kept_record(4, 4, unanswered(11, unit=5)))
    assert {row.unit: row.times for row in trouble_rows(board)} == {4: 1, 5: 1}


def test_of_many_damaged_frames_the_last_one_of_no_unit_is_known() -> None:
    frames = [event(10 + at, EventKind.BAD_CHECK) for at in range(2 * MAX_FRAMES)]
    asked = [unanswered(10 + MAX_FRAMES + at, unit=4) for at in range(MAX_FRAMES)]
    others = [
        WireEvent(ts_ns=START_NS, link="other", kind=EventKind.BAD_CHECK, message="x")
        for _ in range(2 * MAX_FRAMES)
    ]
    rows = {(row.link, row.unit): row for row in trouble_rows(board_of(*frames, *others, *asked))}
    nobodys, units = rows["line", None], rows["line", 4]
    assert (nobodys.times, units.times) == (MAX_FRAMES, MAX_FRAMES)
    assert nobodys.first_ns == START_NS + 10 * MS
    assert nobodys.last_ns == START_NS + (9 + MAX_FRAMES) * MS
    assert units.last_ns == START_NS + (9 + 2 * MAX_FRAMES) * MS


def test_the_oldest_record_gives_way() -> None:
    board = Board(kept=3)
    for order in range(1, 6):
        board.add(kept_record(order, order, read(order, 1)))
    assert [row.key for row in record_rows(board)] == [3, 4, 5]
    assert board.account.transactions == 5


def test_points_and_troubles_beyond_their_limits_are_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("MAX_POINTS", "MAX_TROUBLES"):
        monkeypatch.setattr(limits, name, 1)
    board = board_of(
        read(0, 1, findings=["MB-101"]), read(1, 1, unit=2, address=7, findings=["MB-102"])
    )
    assert (len(board.points), len(board.troubles)) == (1, 1)
    assert board.left_out == 2


def test_a_poll_that_was_not_asked_for_longest_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_POLLS", 2)
    board = board_of(*(read(at, 1, address=at) for at in (1, 2, 1, 3)))
    assert [row.poll.address for row in poll_rows(board)] == [1, 3]


def test_a_steady_poll_costs_few_calls() -> None:
    board = Board(lambda _: LINE)
    records = [kept_record(n, n, read(n, *range(10), address=n % 20 * 10)) for n in range(1, 1101)]
    for kept in records[:100]:
        board.add(kept)
    calls = 0

    def count(_frame: object, event: str, _arg: object) -> None:
        nonlocal calls
        calls += event == "call"

    sys.setprofile(count)
    try:
        for kept in records[100:]:
            board.add(kept)
    finally:
        sys.setprofile(None)
    assert 1000 < calls <= CALLS_PER_TRANSACTION * 1000, calls
