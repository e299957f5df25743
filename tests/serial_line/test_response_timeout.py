"""The master's response timeout, named or learned."""

from __future__ import annotations

import pytest

from mbtool.core import SerialFormat
from mbtool.decode.connections import Bus
from mbtool.modbus import Outcome, Transaction
from mbtool.modbus.adu import rtu_adu
from mbtool.serial_line.response_timeout import SAMPLES, ResponseTimeout
from tests.feeding import Line, feed_all

MS = 1_000_000
FORMAT = SerialFormat(19200, 8, "E", 1)
READ = rtu_adu(1, bytes.fromhex("03 0000 0001"))
ANSWER = rtu_adu(1, bytes.fromhex("03 02 0001"))
WRITE = rtu_adu(1, bytes.fromhex("06 0001 0003"))


def learned(*waits_ms: float) -> ResponseTimeout:
    timeout = ResponseTimeout()
    for wait_ms in waits_ms:
        timeout.learn(int(wait_ms * MS))
    return timeout


def test_unknown_timeout_says_nothing() -> None:
    timeout = ResponseTimeout()
    assert not timeout.is_known
    for wait_ns in (0, MS, 1000 * MS):
        assert not timeout.is_not_over(wait_ns)
        assert timeout.over_probability(wait_ns) == 0.0
        assert not timeout.is_over_at(wait_ns)


def test_timeout_becomes_more_exact_with_each_retry() -> None:
    once, often = learned(200), learned(*[200] * SAMPLES)
    assert once.is_over_at(200 * MS)
    assert often.is_over_at(200 * MS)
    assert 0.0 < once.over_probability(180 * MS) < 1.0
    assert often.is_not_over(180 * MS)


def test_each_wait_is_running_doubtful_over_or_longer() -> None:
    timeout = learned(200, 205, 213)
    said = [
        (
            timeout.is_not_over(ms * MS),
            0.0 < timeout.over_probability(ms * MS) < 1.0,
            timeout.is_over_at(ms * MS),
        )
        for ms in range(300)
    ]
    kinds = [one for at, one in enumerate(said) if at == 0 or said[at - 1] != one]
    assert kinds == [
        (True, False, False), (False, True, False), (False, False, True), (False, False, False),
    ]  # fmt: skip


def test_few_odd_waits_do_not_count() -> None:
    timeout = learned(*[200] * 14, 20, 900)
    assert timeout.is_not_over(150 * MS)
    assert not timeout.is_over_at(500 * MS)


def test_timeout_that_the_user_names_is_not_learned() -> None:
    timeout = ResponseTimeout(200 * MS)
    timeout.learn(500 * MS)
    assert timeout.is_over_at(210 * MS)
    assert timeout.is_not_over(150 * MS)
    assert not timeout.is_over_at(500 * MS)


@pytest.mark.parametrize("wait_ms", [60, 100, 150])
@pytest.mark.parametrize("is_retry", [True, False])
def test_named_timeout_tells_the_first_retry_from_a_slow_response(
    wait_ms: int, is_retry: bool
) -> None:
    """Nothing else tells: no write was heard before, and no request was repeated."""
    sent = Line(FORMAT)
    for _ in range(20):
        sent.frame(READ, 30 * MS).frame(ANSWER, 3 * MS)
    sent.frame(WRITE, 30 * MS).frame(WRITE, wait_ms * MS)
    if is_retry:
        sent.frame(WRITE, 3 * MS)
    sent.frame(READ, 30 * MS).frame(ANSWER, 3 * MS)
    timeout_ms = wait_ms if is_retry else 400
    bus = Bus("line", FORMAT, response_timeout_ns=timeout_ms * MS)
    told = [one for one in feed_all(bus, sent.reads()) if isinstance(one, Transaction)]
    writes = [one for one in told if one.function == 0x06]
    expected = [Outcome.NO_ANSWER, Outcome.OK] if is_retry else [Outcome.OK]
    assert [one.outcome for one in writes] == expected
    assert all(one.confidence >= 0.8 for one in writes)
