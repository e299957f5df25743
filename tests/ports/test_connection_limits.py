from __future__ import annotations

import pytest

from mbtool.core.limits import CONNECTIONS_PER_SECOND
from mbtool.ports.tcp_listener import ConnectionRate


def test_a_burst_of_one_second_passes_and_then_one_for_each_token() -> None:
    rate = ConnectionRate(8)
    assert [rate.admits(5.0) for _ in range(10)] == [True] * 8 + [False] * 2
    assert [rate.admits(at) for at in (5.125, 5.125, 5.375, 5.375)] == [True, False, True, True]


def test_a_long_rest_saves_no_more_than_one_burst() -> None:
    rate = ConnectionRate(3)
    rate.admits(0.0)
    assert [rate.admits(1000.0) for _ in range(4)] == [True, True, True, False]


def test_less_than_one_in_a_second_is_possible() -> None:
    rate = ConnectionRate(0.5)
    assert [rate.admits(at) for at in (0.0, 1.0, 2.0)] == [True, False, True]


def test_a_clock_that_goes_back_gives_nothing_and_takes_nothing() -> None:
    rate = ConnectionRate(1)
    assert [rate.admits(at) for at in (10.0, 5.0, 6.0)] == [True, False, True]


@pytest.mark.parametrize(("given", "used"), [(None, CONNECTIONS_PER_SECOND), (7.0, 7.0)])
def test_the_default_is_used_if_the_user_gives_none(given: float | None, used: float) -> None:
    assert ConnectionRate(given).per_second == used
