"""What was seen of a slave."""

from __future__ import annotations

import pytest

from mbtool.devices.assignment import parse_who
from mbtool.devices.observed_slave import (
    MAX_REQUESTS,
    MAX_ROWS,
    MAX_SAMPLED,
    ObservedRequest,
    ObservedSlave,
    Samples,
)
from mbtool.modbus import rtu_adu
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome
from tests.devices.transactions import transaction

READ = ObservedRequest(3, Table.HOLDING_REGISTERS, 10, 2, writes=False)


def seen(*transactions: object) -> ObservedSlave:
    found = ObservedSlave("line", None, 1, with_values=True)
    for one in transactions:
        found.note(one)  # type: ignore[arg-type]
    return found


def test_equal_requests_are_counted_together() -> None:
    found = seen(
        transaction(3, 10, quantity=2, response_values=[1, 2]),
        transaction(3, 10, quantity=2, exception=2, outcome=Outcome.EXCEPTION),
        transaction(3, 10, quantity=2, outcome=Outcome.NO_ANSWER),
    )
    assert list(found.requests) == [READ]
    replies = found.requests[READ]
    assert (replies.ok, replies.silent, replies.exceptions) == (1, 1, {2: 1})
    assert found.samples[READ].rows == [(1, 2)]
    assert found.has_responded


def test_17h_reads_and_writes() -> None:
    found = seen(
        transaction(
            0x17, 10, quantity=2, write_address=20, request_values=[7], response_values=[1, 2]
        )
    )
    assert list(found.requests) == [
        ObservedRequest(0x17, Table.HOLDING_REGISTERS, 10, 2, writes=False),
        ObservedRequest(0x17, Table.HOLDING_REGISTERS, 20, 1, writes=True),
    ]


def test_a_response_without_its_request_shows_its_function_only() -> None:
    found = seen(transaction(3, outcome=Outcome.UNSOLICITED, response_values=[1]))
    assert [(ask.function, ask.address) for ask in found.requests] == [(3, None)]


def test_the_reported_identity_is_kept() -> None:
    pdu = bytes.fromhex("2b 0e 01 01 00 00 01 00 05") + b"Maker"
    assert seen(transaction(0x2B, response_raw=rtu_adu(1, pdu))).identity == {"vendor": "Maker"}


def test_the_word_of_a_vendors_function_is_kept() -> None:
    found = seen(transaction(0x42, response_raw=rtu_adu(1, b"\x42\x00\x16")))
    assert found.answer_words == {(0x42, 0x16)}


@pytest.mark.parametrize(
    ("destination", "who"),
    [(None, "1"), ("10.0.0.9:502", "10.0.0.9:502/1"), ("[::1]:502", "[::1]:502/1")],
)
def test_a_slave_has_the_name_of_the_device_option(destination: str | None, who: str) -> None:
    assert ObservedSlave("line", destination, 1).who == parse_who(who)


def test_the_number_of_different_requests_is_bounded() -> None:
    found = seen(*(transaction(6, at, request_values=[1]) for at in range(MAX_REQUESTS + 3)))
    assert len(found.requests) == MAX_REQUESTS
    assert len(found.samples) == MAX_SAMPLED
    assert found.forgotten == 3


def test_samples_are_spread_over_all_of_the_time() -> None:
    samples = Samples()
    for value in range(10_000):
        samples.add([value])
    assert samples.count == 10_000
    assert MAX_ROWS // 2 <= len(samples.rows) <= MAX_ROWS
    steps = {two[0] - one[0] for one, two in zip(samples.rows, samples.rows[1:], strict=False)}
    assert len(steps) == 1
    assert samples.rows[-1][0] > 9_000


def test_changes_are_counted_in_all_transactions_not_only_in_the_sample() -> None:
    samples = Samples()
    for value in range(1000):
        samples.add([5, value // 500])
    assert samples.changes == [0, 1]


def test_a_span_ends_with_the_last_address() -> None:
    assert ObservedRequest(3, Table.HOLDING_REGISTERS, 65_530, 125, writes=False).span == range(
        65_530, 65_536
    )
    assert ObservedRequest(3, Table.HOLDING_REGISTERS, 5, 0, writes=False).span == range(5, 6)
