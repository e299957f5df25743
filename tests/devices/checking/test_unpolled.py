from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import pytest

from mbtool.devices.checking import unpolled
from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.security_cases import SecurityCases
from mbtool.devices.checking.security_limits import SecurityLimit
from mbtool.devices.checking.unpolled import MAX_ATTEMPTS, MAX_TARGETS, OPENED, Unpolled

if TYPE_CHECKING:
    from collections.abc import Iterable

SCOPE = ("10.0.0.9",)


def _as_is(case: tuple[str, Finding]) -> tuple[str, Finding]:
    return case


class Asked:
    """Things that a master asks, one each ns, and what is found."""

    def __init__(self, number: int = 3, window_ns: int = 10**9) -> None:
        self.cases = SecurityCases()
        limit = SecurityLimit(number, window_ns)
        self.things = Unpolled[tuple[str, Finding]]("SEC-201", _as_is, limit, self.cases)
        self.now_ns = 0

    def ask(self, item: int, request: int = 1, *, is_answered: bool = True) -> bool:
        self.now_ns += 1
        finding = Finding(code="SEC-201", message="{count}: {examples}", ts_ns=self.now_ns, link="")
        return self.things.note(
            SCOPE,
            item,
            request,
            self.now_ns,
            lambda: (str(item), finding),
            is_answered=is_answered,
        )

    def found(self) -> list[str]:
        self.things.close()
        return [finding.message for finding in self.cases.close()]


def test_things_that_are_asked_once_are_counted() -> None:
    asked = Asked(number=3)
    for item in range(5):
        assert not asked.ask(item)
    assert asked.found() == ["5: 0, 1, 2, ..."]


def test_one_thing_less_than_the_limit_is_nothing() -> None:
    asked = Asked(number=6)
    for item in range(5):
        asked.ask(item)
    assert asked.found() == []


def test_things_that_are_asked_again_after_an_answer_are_polled() -> None:
    asked = Asked()
    for _ in range(2):
        for item in range(50):
            asked.ask(item)
    assert asked.things.is_polled(SCOPE, 7)
    assert asked.found() == []


def test_retries_are_no_poll() -> None:
    asked = Asked()
    for item in range(5):
        for _ in range(MAX_ATTEMPTS):
            assert not asked.ask(item, is_answered=False)
    assert asked.found() == ["5: 0, 1, 2, ..."]


def test_a_retry_that_is_answered_is_no_poll_but_the_next_request_is() -> None:
    asked = Asked()
    for item in range(5):
        asked.ask(item, is_answered=False)
        assert not asked.ask(item)
        assert asked.ask(item)
    assert asked.found() == []


def test_a_master_that_asks_in_vain_again_and_again_polls() -> None:
    asked = Asked()
    for _ in range(MAX_ATTEMPTS + 1):
        for item in range(50):
            asked.ask(item, is_answered=False)
    assert asked.found() == []


@pytest.mark.parametrize("length", [1, 2, 3, 7, 8, 9, 30, 100])
@pytest.mark.parametrize("before", [0, 1, 5])
def test_requests_in_turn_are_a_poll_in_the_third_turn_at_the_latest(
    length: int, before: int
) -> None:
    asked = Asked()
    requests: Iterable[int] = itertools.chain(
        range(1000, 1000 + before), itertools.cycle(range(1, length + 1))
    )
    taken = next(number for number, one in enumerate(requests, 1) if asked.ask(0, one))
    assert taken <= before + max(3 * length, 4 * before)


def test_a_scan_that_opens_a_connection_for_each_request_is_no_poll() -> None:
    asked = Asked()
    for item in range(5):
        asked.ask(item, OPENED, is_answered=False)
        for request in range(1, 50):
            assert not asked.ask(item, request)
            assert not asked.ask(item, OPENED, is_answered=False)
    assert asked.found() == ["5: 0, 1, 2, ..."]


def test_an_address_that_is_opened_again_and_again_in_vain_is_polled() -> None:
    asked = Asked()
    for _ in range(MAX_ATTEMPTS + 1):
        for item in range(50):
            asked.ask(item, OPENED, is_answered=False)
    assert asked.found() == []


def test_a_connection_for_each_poll_is_a_poll() -> None:
    asked = Asked()
    for _ in range(2):
        for item in range(50):
            asked.ask(item, OPENED, is_answered=False)
            asked.ask(item)
    assert asked.found() == []


def test_the_oldest_things_are_counted_where_there_are_too_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(unpolled, "MAX_TARGETS", 100)
    asked = Asked()
    for item in range(10_000):
        asked.ask(item)
        assert len(asked.things._attempts) <= 100
    assert asked.found() == ["10000: 0, 1, 2, ..."]


def test_memory_is_bounded() -> None:
    asked = Asked()
    for item in range(MAX_TARGETS + 10):
        asked.things.set_polled(SCOPE, item)
    assert len(asked.things._polled) == MAX_TARGETS
