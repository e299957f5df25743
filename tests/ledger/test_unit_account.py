"""From when to when requests to a unit fail."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.ledger.account import Account
from mbtool.ledger.request_tally import RequestTally
from mbtool.ledger.unit_account import UnitKey
from mbtool.modbus import Outcome
from mbtool.troubles.failed_shares import FailedShare, missing_share, refused_share
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import LINE, request, unanswered

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.devices.named_transaction import NamedTransaction

S = 1000


def shares(records: Iterable[NamedTransaction]) -> tuple[FailedShare | None, FailedShare | None]:
    account, tally = Account(lambda _: LINE), RequestTally()
    for one in records:
        account.add(one)
        tally.add(one)
    times = account.units[UnitKey("line", 1)]
    return missing_share(tally, times), refused_share(tally, times)


def polled(failing: range, asked: int = 100) -> list[NamedTransaction]:
    return [unanswered(at * S) if at in failing else request(at * S) for at in range(asked)]


def at(second: int) -> int:
    return START_NS + second * S * MS


@pytest.mark.parametrize(
    ("failing", "share"),
    [
        (range(60, 100), FailedShare(40, 40, at(60), None)),
        (range(30), FailedShare(30, 30, None, at(29))),
        (range(30, 60), FailedShare(30, 30, at(30), at(59))),
        (range(60, 100, 4), FailedShare(10, 40, at(60), None)),
        (range(0, 100, 4), FailedShare(25, 100)),
        (range(60, 62), FailedShare(2, 100)),
    ],
)
def test_the_share_is_of_the_time_in_which_requests_fail(
    failing: range, share: FailedShare
) -> None:
    assert shares(polled(failing)) == (share, None)


def test_an_outage_that_is_short_beside_the_whole_time_has_no_time_of_its_own() -> None:
    assert shares(polled(range(500, 508), 1000))[0] == FailedShare(8, 1000)
    assert shares(polled(range(500, 520), 1000))[0] == FailedShare(20, 20, at(500), at(519))


def test_an_outage_at_the_end_is_grave_though_it_has_few_of_the_requests() -> None:
    well = [request(1000 * at) for at in range(2000)]
    silent = [unanswered(1000 * (2000 + 20 * at)) for at in range(6)]
    (share, _) = shares([*well, *silent])
    assert share == FailedShare(6, 6, at(2000))
    assert share is not None
    assert share.is_grave


def test_a_unit_that_is_silent_in_the_end_fails_gravely_however_long_it_was_well() -> None:
    well = [request(1000 * at) for at in range(5000)]
    silent = [unanswered(1000 * at) for at in range(5000, 5004)]
    (share, _) = shares([*well, *silent])
    assert share == FailedShare(4, 4, at(5000))
    (share, _) = shares([*well, *silent, request(1000 * 5004)])
    assert share == FailedShare(4, 5005)
    (share, _) = shares([*well, *silent[:2]])
    assert share == FailedShare(2, 5002)


@pytest.mark.parametrize(
    ("failing", "since", "until", "asked"),
    [
        (range(500, 550), 500, None, 50),
        (range(500, 550, 5), 500, None, 50),
        (range(200, 240, 4), 200, 236, 37),
        (range(40), None, 39, 40),
        (range(547, 550), 547, None, 3),
    ],
)
def test_misses_that_are_known_at_the_end_of_the_capture_are_counted_in_their_time(
    failing: range, since: int | None, until: int | None, asked: int
) -> None:
    answered = [request(number * S) for number in range(550) if number not in failing]
    (share, _) = shares([*answered, *(unanswered(number * S) for number in failing)])
    assert share is not None
    assert share.failed == len(failing)
    assert share.since_ns == (None if since is None else at(since))
    assert share.until_ns == (None if until is None else at(until))
    assert share.asked == pytest.approx(asked, abs=6)


def test_the_share_does_not_depend_on_the_order_of_requests() -> None:
    records = polled(range(150, 300, 2), 400)
    assert shares(records) == shares(list(reversed(records)))


def test_an_answer_that_came_before_a_silence_was_known_ends_it() -> None:
    records = [*(request(1000 * at) for at in range(1000)), request(1_005_000)]
    late = [unanswered(1000 * at) for at in range(1000, 1004)]
    assert shares([*records, *late])[0] == FailedShare(4, 1005)


def test_refusals_have_a_time_of_their_own() -> None:
    refused = [request(at * S, outcome=Outcome.EXCEPTION, exception=2) for at in range(50, 100)]
    assert shares([*polled(range(5))[:50], *refused]) == (
        FailedShare(5, 5, None, at(4)),
        FailedShare(50, 50, at(50)),
    )


def test_a_long_time_needs_dates() -> None:
    (share, _) = shares([one for day in range(5) for one in polled_on(day)])
    assert share is not None
    assert share.is_long


def polled_on(day: int) -> list[NamedTransaction]:
    begin = 86_400 * S * day
    return [unanswered(begin + at) if day > 2 else request(begin + at) for at in (0, 100, 200)]


def test_without_times_the_share_is_of_all_requests() -> None:
    tally = RequestTally()
    for one in polled(range(60, 100)):
        tally.add(one)
    assert missing_share(tally, None) == FailedShare(40, 100)
