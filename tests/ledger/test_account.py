from __future__ import annotations

from collections import Counter
from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import CONNECTION_OPENED, EventKind, SerialFormat, WireEvent
from mbtool.ledger import account as module
from mbtool.ledger import poll_statistics, request_order
from mbtool.ledger.account import Account
from mbtool.ledger.statistics_report import LinkReport, is_counted_together, report
from mbtool.modbus import Outcome, Transport
from tests.ledger.masters import MS, START_NS, Master, Task
from tests.ledger.requests import LINE, request, requests_of, unanswered

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

CHARACTER_S = 11 / 9600


def counted(*records: NamedTransaction | WireEvent, with_line: bool = True) -> Account:
    account = Account(lambda _: LINE if with_line else None)
    for one in records:
        account.add(one)
    account.settle()
    return account


def only_link(account: Account) -> LinkReport:
    (link,) = report(account)
    return link


def test_polls_are_equal_in_unit_function_address_and_quantity() -> None:
    link = only_link(
        counted(
            request(0, 1), request(10, 1), request(20, 2), request(30, 1, unit=2),
            request(40, 1, function=4), request(50, 1, quantity=11), request(60, 1),
        )
    )  # fmt: skip
    assert [one.poll.tally.transactions for one in link.polls] == [3, 1, 1, 1, 1]
    assert [(one.unit, one.function, one.tally.transactions) for one in link.functions] == [
        (1, 3, 5), (1, 4, 1), (2, 3, 1),
    ]  # fmt: skip


def test_two_masters_have_polls_of_their_own_whatever_their_ports() -> None:
    def ask(at_ms: float, source: str) -> NamedTransaction:
        return request(at_ms, transport=Transport.TCP, source=source, destination="10.0.0.9:502")

    link = only_link(
        counted(
            ask(0, "10.0.0.1:5001"), ask(10, "10.0.0.1:5002"), ask(20, "[fe80::1]:5001"),
            with_line=False,
        )
    )  # fmt: skip
    assert [(one.poll.key.master, one.poll.tally.transactions) for one in link.polls] == [
        ("10.0.0.1", 2),
        ("fe80::1", 1),
    ]


def test_the_period_goes_from_one_request_to_the_next() -> None:
    link = only_link(counted(*(request(at * 100) for at in range(5))))
    (poll,) = link.polls
    assert (poll.poll.period.count, poll.poll.period.percentile(50)) == (4, 100 * MS)
    assert poll.poll.jitter_ns == 0


def test_a_repeated_request_begins_no_period() -> None:
    link = only_link(
        counted(
            request(0, 1), request(50, 2), unanswered(100, 1), request(130, 1, retries=1),
            request(150, 2), request(200, 1),
        )
    )  # fmt: skip
    one, _ = link.polls
    assert one.poll.period.count == 2
    assert (one.poll.period.least, one.poll.period.greatest) == (100 * MS, 100 * MS)
    assert (one.poll.tally.retries, one.poll.tally.unanswered) == (1, 1)
    assert one.poll.repetitions == 1


def test_a_missing_answer_that_is_told_late_does_not_spoil_periods() -> None:
    late = unanswered(100)
    others = [request(at * 100) for at in range(20) if at != 1]
    (poll,) = only_link(counted(*others, late)).polls
    assert {poll.poll.period.least, poll.poll.period.greatest} == {100 * MS, 200 * MS}


def test_what_comes_later_than_the_window_is_counted_but_has_no_period() -> None:
    many = [request(at * 10, at % 7) for at in range(2 * request_order.WINDOW + 50)]
    account = counted(*many, request(1, 99), request(2, 99))
    assert account.late == 2
    assert account.transactions == 2 * request_order.WINDOW + 52
    poll = next(one for one in report(account)[0].polls if one.poll.key.address == 99)
    assert (poll.poll.tally.transactions, poll.poll.period.count) == (2, 0)


def test_no_period_reaches_from_one_capture_into_the_next() -> None:
    account = Account(lambda _: LINE)
    for begin_ms in (0, 86_400_000):
        account.begin_capture()
        for at in range(3):
            account.add(request(begin_ms + at * 100))
    account.settle()
    link = only_link(account)
    (poll,) = link.polls
    assert (poll.poll.period.count, poll.poll.period.greatest) == (4, 100 * MS)
    assert link.watched_ns == 2 * 205 * MS
    assert (link.end_ns - link.begin_ns) // MS == 86_400_205


def test_a_capture_of_an_earlier_day_may_come_second() -> None:
    account = Account(lambda _: LINE)
    for begin_ms in (86_400_000, 0):
        account.begin_capture()
        for at in range(3):
            account.add(request(begin_ms + at * 100))
    account.settle()
    assert account.late == 0
    assert only_link(account).polls[0].poll.period.count == 4


def test_a_response_without_request_belongs_to_no_poll() -> None:
    lone = request(address=None, request_ns=None, request_raw=None, outcome=Outcome.UNSOLICITED)
    link = only_link(counted(lone))
    assert (link.polls, link.tally.transactions) == ([], 1)
    assert link.tally.count(Outcome.UNSOLICITED) == 1


def test_the_load_of_a_line_follows_from_bytes_and_baud_rate() -> None:
    # A cycle of 4 polls a second: 8 bytes asked and 25 answered, each of 11 bits.
    asked = Master(tasks=[Task(polls="abcd", period_ms=1000)], latency_ms=(40, 60)).run(60)
    link = only_link(counted(*requests_of(asked)))
    assert link.load is not None
    wire_s = 4 * (8 + 25) * CHARACTER_S
    assert link.load.busy_share == pytest.approx(wire_s, rel=0.03)
    assert link.load.share_of_time(link.load.spent.slaves_ns) == pytest.approx(4 * 0.005, rel=0.03)
    assert link.load.spent.missing_ns == 0
    shares = [
        link.load.share_of_time(one.line_time.total_ns)
        for one in link.polls
        if one.line_time is not None
    ]
    assert sum(shares) == pytest.approx(wire_s + 4 * 0.005, rel=0.03)
    assert link.load.busy_share + link.load.share_of_time(link.load.pauses_ns) < 1


def test_a_dead_unit_eats_the_time_that_its_master_waits() -> None:
    master = Master(
        tasks=[Task(polls="abc", pause_ms=100, gap_ms=(0, 0))],
        dead=frozenset("b"),
        timeout_ms=500,
        retries=1,
        latency_ms=(50, 50),
    )
    link = only_link(counted(*requests_of(master.run(120))))
    assert link.load is not None
    cycle_ms = 50 + 2 * 500 + 50 + 100
    # The wait begins at the end of the request, 8 characters later than in the plan.
    waited_ms = 2 * (500 - 8 * 1000 * CHARACTER_S)
    waits = link.load.share_of_time(link.load.spent.missing_ns)
    assert waits == pytest.approx(waited_ms / cycle_ms, rel=0.03)
    (master_report,) = link.masters
    (found,) = master_report.lists.lists
    assert [chr(one.key.address or 0) for one in found.polls] == ["a", "b", "c"]
    assert found.period_ns / MS == pytest.approx(cycle_ms, rel=0.02)


def test_bytes_that_belong_to_no_frame_keep_the_line_busy_too() -> None:
    noise = WireEvent(
        ts_ns=START_NS, link="line", kind=EventKind.SKIPPED, message="", raw=bytes(100)
    )
    quiet = only_link(counted(request(0), request(1000))).load
    noisy = only_link(counted(request(0), noise, request(1000))).load
    assert quiet is not None
    assert noisy is not None
    assert noisy.busy_share - quiet.busy_share == pytest.approx(100 * CHARACTER_S / 1.005)


def test_a_network_has_no_load() -> None:
    link = only_link(counted(request(0, transport=Transport.TCP), request(9)))
    assert link.load is None
    assert link.settings is None


def test_missing_answers_are_counted_by_hour() -> None:
    hour_ms = 3_600_000
    link = only_link(counted(request(0), unanswered(hour_ms + 1), request(hour_ms + 2)))
    assert [(one.requests, one.missing) for one in link.hours] == [(1, 0), (2, 1)]


def test_what_is_not_captured_is_no_missing_answer() -> None:
    lost = unanswered(0, outcome=Outcome.NOT_CAPTURED)
    link = only_link(counted(lost, request(100), lost))
    assert (link.tally.unanswered, link.tally.count(Outcome.NOT_CAPTURED)) == (0, 2)
    assert sum(one.missing for one in link.hours) == 0
    assert link.masters[0].lists.timeout_ns is None


def test_memory_is_bounded_however_many_polls_links_and_masters_there_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, limit in {
        "MAX_POLLS": 20, "MAX_UNITS": 15, "MAX_USES": 30, "MAX_LINKS": 10, "MAX_PAIRS": 7,
    }.items():  # fmt: skip
        monkeypatch.setattr(module, name, limit)
    for name, limit in {"MAX_TAPES": 5, "WINDOW": 16}.items():
        monkeypatch.setattr(request_order, name, limit)
    account = Account()
    random = Random(1)
    for at in range(2000):
        name = f"10.0.0.{random.randrange(50)}"
        one = request(
            at, random.randrange(1000), link=name, unit=random.randrange(250),
            transport=Transport.TCP, source=f"10.0.1.{random.randrange(40)}:{at}",
            destination=f"{name}:502",
        )  # fmt: skip
        account.add(one)
        account.add(
            WireEvent(
                ts_ns=one.start_ns, link=name, kind=EventKind.OPENED, message=CONNECTION_OPENED,
                source=one.source or "", destination=one.destination or "",
            )
        )  # fmt: skip
    assert len(account.polls) == 20
    assert len(account.units) <= 15
    assert len(account.uses) <= 30 + len(account.links)
    assert len(account.links) <= 11
    assert len(account.tapes) == 5
    assert len(account.connections) == 7
    assert len(account._order._waiting) <= 32
    taped = {poll for tape in account.tapes.values() for poll in tape._polls}
    given_up = taped - set(account.polls.values())
    assert given_up
    assert {id(poll.tally) for poll in given_up} == {id(poll_statistics.GIVEN_UP)}
    assert not poll_statistics.GIVEN_UP.transactions
    total = sum(link.tally.transactions for link in report(account))
    assert total == account.transactions == 2000


def test_what_cannot_be_told_apart_by_unit_still_counts_for_its_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "MAX_POLLS", 2)
    monkeypatch.setattr(module, "MAX_USES", 4)
    asked = [request(at, unit=at // 2 % 20, link=f"line {at % 2}") for at in range(400)]
    links = report(counted(*asked))
    assert {link.name: link.tally.requests for link in links} == {"line 0": 200, "line 1": 200}
    assert [link.functions[0].unit for link in links] == [module.OTHER_UNITS] * 2
    assert is_counted_together(links)
    assert not is_counted_together(report(counted(*asked[:4])))


def test_the_time_watched_is_from_the_first_to_the_last_link_of_each_capture() -> None:
    account = Account(lambda _: LINE)
    for at_ms, link in ((0, "a"), (1000, "a"), (5000, "b"), (9000, "b")):
        account.add(request(at_ms, link=link))
    latency_ns = account.watched_ns - 9000 * MS
    assert 0 < latency_ns < 1000 * MS
    account.begin_capture()
    for at_ms, link in ((86_400_000, "a"), (86_401_000, "b")):
        account.add(request(at_ms, link=link))
    assert account.watched_ns == 10_000 * MS + 2 * latency_ns
    assert {link.all_watched_ns for link in report(account)} == {account.watched_ns}


def test_captures_of_the_same_time_are_watched_once() -> None:
    account = Account(lambda _: LINE)
    for link in ("a", "b", "c"):
        account.add(request(0, link=link))
        account.add(request(9000 if link == "b" else 5000, link=link))
        account.begin_capture()
    assert 9000 * MS < account.watched_ns < 9100 * MS


def test_a_poll_that_is_given_up_still_counts_for_its_function(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "MAX_POLLS", 3)
    link = only_link(counted(*(request(at, at % 10) for at in range(100))))
    assert len(link.polls) == 3
    assert [one.tally.transactions for one in link.functions] == [100]


def test_the_figures_can_be_read_while_more_comes() -> None:
    account = Account(lambda _: LINE)
    for at in range(100):
        account.add(request(at * 100))
        if at % 10 == 0:
            account.settle(START_NS + (at - 5) * 100 * MS)
            report(account)
    account.settle()
    assert account.late == 0
    assert only_link(account).polls[0].poll.period.count == 99


def test_bytes_without_times_have_counts_but_no_rate_period_or_cycle() -> None:
    link = only_link(counted(*(request(at * 100) for at in range(20)), with_line=False))
    assert not link.has_times
    assert (link.tally.transactions, link.rate(20), link.load) == (20, None, None)
    assert link.polls[0].poll.period.count == 0
    assert (link.masters, link.hours) == ([], [])


def test_a_line_whose_settings_change_from_capture_to_capture_has_no_load() -> None:
    formats = iter((LINE, SerialFormat(19200)))
    account = Account(lambda _: next(formats))
    for begin_ms in (0, 1000):
        account.begin_capture()
        account.add(request(begin_ms))
    link = only_link(account)
    assert (link.load, link.settings) == (None, None)


def test_nothing_heard_has_no_links() -> None:
    assert report(counted()) == []


def test_times_that_jump_do_no_harm() -> None:
    jumps = [request(at) for at in (0, -(10**9), 10**12, 5)]
    link = only_link(counted(*jumps))
    assert link.tally.transactions == 4
    assert link.watched_ns > 0


def test_of_a_dead_unit_only_what_is_repeated_at_once_is_a_repetition() -> None:
    master = Master(tasks=[Task(polls="ab", pause_ms=100)], dead=frozenset("b"), retries=2)
    link = only_link(counted(*requests_of(master.run(60))))
    _, dead = link.polls
    assert dead.poll.repetitions * 3 == dead.poll.tally.unanswered * 2


def told_retries(*records: NamedTransaction) -> tuple[int, list[int]]:
    """Return how many retries are counted, and the times (ms) of those that were told."""
    told: Counter[int] = Counter()
    account = Account(
        lambda _: LINE, lambda _, at_ns, number: told.update({(at_ns - START_NS) // MS: number})
    )
    for one in records:
        account.add(one)
    account.settle()
    (poll,) = account.polls.values()
    return poll.repetitions, sorted(told.elements())


def test_the_polls_of_a_unit_that_fell_silent_are_no_retries() -> None:
    answered = [request(1000 * at) for at in range(8)]
    silent = [unanswered(1000 * at) for at in range(8, 30)]
    assert told_retries(*answered, *silent) == (0, [])
    assert told_retries(*answered, *silent, unanswered(29_300)) == (1, [29_300])


def test_the_polls_of_a_unit_that_never_answers_are_no_retries_if_they_are_steady() -> None:
    steady = [unanswered(1000 * at) for at in range(20)]
    assert told_retries(*steady[:5]) == (4, [1000, 2000, 3000, 4000])
    assert told_retries(*steady) == (0, [])


def test_a_poll_that_comes_late_once_makes_no_retries_of_the_polls_after_it() -> None:
    answered = [request(1000 * at) for at in range(8)]
    late = [unanswered(1000 * at + (400 if at >= 20 else 0)) for at in range(8, 60)]
    assert told_retries(*answered, *late) == (1, [20_400])
    skipped = [unanswered(1000 * at) for at in range(8, 60) if at != 20]
    assert told_retries(*answered, *skipped) == (1, [21_000])


def test_a_retry_that_puts_off_the_next_poll_is_the_only_retry() -> None:
    answered = [request(1000 * at) for at in range(8)]
    pairs = [unanswered(8000 + 1300 * (at // 2) + 300 * (at % 2)) for at in range(20)]
    assert told_retries(*answered, *pairs) == (10, [8300 + 1300 * at for at in range(10)])


def test_the_steady_polls_of_a_unit_that_never_answers_may_begin_after_a_pause() -> None:
    steady = [unanswered(1000 * at + (400 if at >= 4 else 0)) for at in range(30)]
    count, times = told_retries(*steady)
    assert (count, times) == (3, [1000, 2000, 3000])
    for again in range(2):  # Steady for a short time only: always retries.
        bursts = [unanswered(5000 * (at // 4) + 300 * (at % 4)) for at in range(16 + again)]
        assert told_retries(*bursts)[0] == 15 + again
