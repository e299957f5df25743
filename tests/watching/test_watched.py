"""The whole and the filtered board."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.watching import watched as limits
from mbtool.watching.board import poll_rows, record_rows, slave_rows
from mbtool.watching.watched import Watched
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import LINE, request, unanswered

if TYPE_CHECKING:
    from mbtool.watching.watched_rows import Record

EVENT = WireEvent(ts_ns=START_NS, link="line", kind=EventKind.SKIPPED, message="noise")


def test_a_filter_takes_the_kept_records_and_those_that_come() -> None:
    watched = Watched()
    watched.add(request(0, unit=1))
    watched.add(request(1, unit=2))
    watched.set_filter(lambda one: one.unit == 2)
    watched.add(request(2, unit=2))
    watched.add(request(3, unit=1))
    assert watched.filtered is not None
    assert [kept.number for kept in watched.filtered.records] == [2, 3]
    assert (watched.filtered.account.left_out, watched.whole.account.left_out) == (2, 0)
    assert watched.whole.account.transactions == 4
    watched.set_filter(None)
    assert watched.filtered is None


def test_an_event_is_counted_under_a_filter_but_not_listed() -> None:
    watched = Watched()
    watched.add(EVENT)
    watched.set_filter(lambda one: one.unit == 1)
    assert watched.filtered is not None
    assert (len(watched.filtered.records), watched.filtered.account.events.total()) == (0, 1)
    assert list(watched.filtered.troubles) == [("skipped", "line", None)]


def test_a_filter_counts_from_the_oldest_record_that_is_kept() -> None:
    watched = Watched(kept=2)
    for at in range(5):
        watched.add(request(at))
    watched.set_filter(lambda _: True)
    assert watched.filtered is not None
    assert (watched.filtered.account.transactions, watched.unfiltered) == (2, 3)
    watched.add(request(5))
    assert (watched.filtered.account.transactions, watched.unfiltered) == (3, 3)


def test_a_filter_sees_all_records_where_they_are_given_again() -> None:
    watched = Watched(kept=2)
    past: list[Record] = [request(0), EVENT, *(request(at, unit=at) for at in range(1, 9))]
    for record in past[:7]:
        watched.add(record)
    watched.set_filter(lambda one: one.unit == 1, past)
    assert watched.filtered is not None
    assert (
        watched.filtered.account.transactions,
        watched.filtered.account.events.total(),
        watched.unfiltered,
    ) == (2, 1, 0)
    assert [(kept.order, kept.number) for kept in watched.filtered.records] == [(1, 1), (3, 2)]


def test_a_filter_that_finds_only_events_kept_has_seen_no_transaction() -> None:
    watched = Watched(kept=1)
    watched.set_filter(lambda _: True)
    assert watched.unfiltered == 0
    for record in (request(0), EVENT):
        watched.add(record)
    watched.set_filter(lambda _: True)
    assert watched.unfiltered == 1


@pytest.mark.parametrize("is_late", [False, True])
def test_the_retries_under_a_filter_are_those_that_pass_it(is_late: bool) -> None:
    retries = [unanswered(20_000 + 1000 * at + again, retries=again // 100, quantity=1)
               for at in range(6) for again in (0, 100)]  # fmt: skip
    polls: list[Record] = [request(1000 * at, quantity=1) for at in range(20)]
    watched = Watched(lambda _: LINE)
    if not is_late:
        watched.set_filter(lambda one: one.retries > 0)
        watched.restart()
    for record in [*polls, *retries]:
        watched.add(record)
    watched.advance(None)
    if is_late:
        watched.set_filter(lambda one: one.retries > 0)
    assert watched.filtered is not None
    for board, asked in ((watched.whole, 32), (watched.filtered, 6)):
        (slave,), (poll,) = slave_rows(board), poll_rows(board)
        assert (slave.asked, slave.retries, poll.retries) == (asked, 6, 6)


def test_a_filter_that_comes_late_knows_the_periods() -> None:
    watched = Watched(lambda _: LINE)
    for at in range(0, 500, 100):
        watched.add(request(at))
    watched.advance(None)
    watched.set_filter(lambda _: True)
    assert watched.filtered is not None
    (poll,) = watched.filtered.account.polls.values()
    assert poll.period.percentile(50) == 100 * MS


def test_numbers_are_those_of_transactions_and_orders_those_of_all_records() -> None:
    watched = Watched()
    for record in (request(0), EVENT, request(1)):
        watched.add(record)
    assert [(kept.order, kept.number) for kept in watched.whole.records] == [
        (1, 1),
        (2, None),
        (3, 2),
    ]


def test_a_mark_is_taken_away_by_the_second_and_marks_are_limited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(limits, "MAX_MARKED", 1)
    watched = Watched()
    watched.add(request(0))
    watched.add(request(1))
    first, second = watched.whole.records
    assert watched.toggle_mark(first)
    assert not watched.toggle_mark(second)
    assert watched.toggle_mark(first)
    assert watched.marked == {}


def test_a_restart_keeps_the_filter_and_the_marks() -> None:
    watched = Watched()
    watched.add(request(0))
    watched.toggle_mark(watched.whole.records[0])
    watched.set_filter(lambda one: one.unit == 1)
    watched.restart()
    assert watched.whole.account.transactions == 0
    watched.add(request(0))
    assert watched.filtered is not None
    assert (watched.filtered.account.transactions, list(watched.marked)) == (1, [1])


def test_connections_that_open_and_close_push_out_no_transaction() -> None:
    watched = Watched(kept=3)
    for at in range(3):
        watched.add(replace(EVENT, kind=EventKind.OPENED))
        watched.add(request(at))
        watched.add(replace(EVENT, kind=EventKind.CLOSED))
    assert [kept.number for kept in watched.whole.records] == [1, 2, 3]
    assert record_rows(watched.whole).heard == 3
    watched.add(replace(EVENT, ts_ns=START_NS + 9 * MS))
    assert [row.kept.number for row in record_rows(watched.whole)] == [2, 3, None]
    assert record_rows(watched.whole).heard == 4
    watched.set_filter(lambda one: True)
    assert watched.filtered is not None
    assert (watched.filtered.account.transactions, watched.filtered.account.events.total()) == (
        2,
        4,
    )
    assert {code for code, _, _ in watched.filtered.troubles} == {"opened", "closed", "skipped"}
