"""Bus states as values."""

from __future__ import annotations

import pytest

from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.serial_line.bus_state import (
    DOUBT_BITS,
    MAX_STATES,
    BusState,
    PendingRequest,
    bits_of,
    confidence_of,
    most_likely,
)

WRITE = bytes.fromhex("06 0001 0003")


def pending(awaited_from_ns: int = 0) -> PendingRequest:
    expected = ExpectedResponse.of(WRITE)
    assert expected is not None
    return PendingRequest(5, WRITE, expected, awaited_from_ns, None)


def test_confidence_of_the_better_of_two() -> None:
    assert confidence_of(0) == 0.5
    assert confidence_of(1) == pytest.approx(2 / 3)
    assert confidence_of(10) > 0.999


def test_bits_are_the_inverse_of_confidence() -> None:
    for bits in (0.0, 0.5, 1.0, 6.0, 12.0):
        assert bits_of(confidence_of(bits)) == pytest.approx(bits)
    assert bits_of(1.0) == float("inf")


def test_most_likely_states_are_in_order_and_without_duplicates() -> None:
    asked, answered = BusState(pending=pending()), BusState(answered=pending(), last_response=WRITE)
    states = [(2.0, asked), (0.0, answered), (1.0, BusState(pending=pending()))]
    assert most_likely(states) == [(0.0, answered), (1.0, asked)]


def test_states_that_are_much_less_likely_are_dropped() -> None:
    states = [(0.0, BusState()), (DOUBT_BITS, BusState(pending=pending()))]
    assert most_likely(states) == [(0.0, BusState())]


def test_number_of_states_is_bounded() -> None:
    states = [
        (0.1, BusState(pending=pending(awaited_from_ns)))
        for awaited_from_ns in range(3 * MAX_STATES)
    ]
    assert len(most_likely(states)) == MAX_STATES


def test_damage_makes_the_pending_request_overdue() -> None:
    lost = BusState(pending=pending(), last_ns=7).after_damage()
    assert (lost.pending, lost.overdue, lost.follows_damage, lost.last_ns) == (
        None,
        pending(),
        True,
        7,
    )


def test_recent_request_is_the_answered_or_the_overdue_one() -> None:
    state = BusState(answered=pending(), last_response=WRITE)
    assert state.has_recent_request(5, 0x06)
    assert state.has_recent_request(5, 0x86)
    assert not state.has_recent_request(5, 0x03)
    assert not state.has_recent_request(6, 0x06)
    assert BusState(overdue=pending()).has_recent_request(5, 0x06)
    assert not BusState(pending=pending()).has_recent_request(5, 0x06)
