"""Advice which requests of a polled list could be one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from mbtool.ledger.account import Account
from mbtool.ledger.advice import CycleAdvice, advise, forecast
from mbtool.ledger.statistics_report import report
from mbtool.modbus import Outcome, Transport
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import request

if TYPE_CHECKING:
    from collections.abc import Sequence

FIXED_MS, EACH_MS, PAUSE_MS = 10.0, 0.5, 4.0
"""The slave takes 10 ms for a request and 0.5 ms for each register; the master pauses 4 ms."""


NETWORK: dict[str, Any] = {
    "transport": Transport.TCP,
    "source": "10.0.0.1:50000",
    "destination": "10.0.0.9:502",
    "request_raw": None,
    "response_raw": None,
}


def took_ms(quantity: int) -> float:
    return FIXED_MS + EACH_MS * quantity


def polled(
    reads: Sequence[tuple[int, int]],
    *,
    cycles: int = 30,
    wait_ms: float = 0.0,
    refused: Sequence[tuple[int, int]] = (),
) -> Account:
    """A master that reads these (address, quantity) again and again."""
    account = Account(lambda _: None)
    at_ms = 1000.0
    for address, quantity in refused:
        account.add(
            request(
                at_ms, address, quantity=quantity, outcome=Outcome.EXCEPTION, exception=2,
                response_values=None, **NETWORK,
            )
        )  # fmt: skip
        at_ms += 500
    for _ in range(cycles):
        for address, quantity in reads:
            end_ms = at_ms + took_ms(quantity)
            account.add(
                request(
                    at_ms,
                    address,
                    quantity=quantity,
                    response_ns=START_NS + round(end_ms * MS),
                    latency_ns=round(took_ms(quantity) * MS),
                    response_values=[0] * quantity,
                    **NETWORK,
                )
            )
            at_ms = end_ms + PAUSE_MS
        at_ms += wait_ms
    return account


def advice_on(account: Account, limit: int | None = None) -> CycleAdvice | None:
    account.settle()
    (link,) = report(account)
    (one,) = link.masters[0].lists.lists
    return advise(one, [each.poll for each in link.polls], None, lambda unit, function: limit)


def test_reads_side_by_side_can_be_one() -> None:
    advice = advice_on(polled([(0, 2), (2, 4), (6, 10), (100, 2)]))
    assert advice is not None
    assert (advice.requests, advice.requests_then) == (4, 2)
    (merged,) = advice.merged
    assert (merged.address, merged.quantity, merged.count, merged.most_asked) == (0, 16, 3, 10)


@pytest.mark.parametrize("wait_ms", [0.0, 500.0])
def test_the_cycle_then_is_what_the_same_slave_takes(wait_ms: float) -> None:
    advice = advice_on(polled([(0, 2), (2, 4), (6, 10), (100, 2)], wait_ms=wait_ms))
    then = polled([(0, 16), (100, 2)], wait_ms=wait_ms)
    then.settle()
    (one,) = report(then)[0].masters[0].lists.lists
    assert advice is not None
    assert advice.waits is (wait_ms > 0)
    assert advice.cycle_then_ns == pytest.approx(one.period_ns, rel=0.05)


def test_a_gap_that_nobody_has_read_is_not_read_over() -> None:
    assert advice_on(polled([(0, 2), (3, 2), (10, 2)])) is None


def test_a_gap_that_was_read_by_another_request_is_read_over() -> None:
    account = polled([(0, 2), (3, 2), (20, 9)])
    account.add(request(100_000, 0, quantity=8, response_values=[0] * 8, **NETWORK))
    advice = advice_on(account)
    assert advice is not None
    assert [(one.address, one.quantity) for one in advice.merged] == [(0, 5)]


def test_a_range_that_the_slave_refused_is_not_asked() -> None:
    assert advice_on(polled([(0, 2), (2, 2)], refused=[(0, 4)])) is None
    assert advice_on(polled([(0, 2), (2, 2)], refused=[(1, 2)])) is None
    assert advice_on(polled([(0, 2), (2, 2)], refused=[(50, 4)])) is not None


def test_the_limits_of_the_standard_and_of_a_profile_are_kept() -> None:
    assert advice_on(polled([(0, 100), (100, 100)])) is None
    assert advice_on(polled([(0, 4), (4, 4)]), limit=6) is None
    assert advice_on(polled([(0, 4), (4, 4)]), limit=8) is not None


@pytest.mark.parametrize("wait_ms", [0, 400])
def test_a_faster_line_shortens_only_the_characters_and_a_unit_more_costs_its_share(
    wait_ms: int,
) -> None:
    account = polled([(0, 2), (2, 4)], wait_ms=wait_ms)
    account.settle()
    (link,) = report(account)
    (one,) = link.masters[0].lists.lists
    characters = {id(step.poll): 10e6 for step in one.steps}
    found = forecast(one, 9600, characters)
    assert found.at_bauds == ((19200, 10_000_000), (38400, 15_000_000))
    assert (found.units, found.waits) == (1, wait_ms > 0)
    assert found.with_unit_ns == pytest.approx(found.busy_ns + PAUSE_MS * MS, rel=0.01)
