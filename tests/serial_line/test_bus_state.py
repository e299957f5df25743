"""Bus states as values."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
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


def test_damage_explains_the_silence_before_it() -> None:
    assert BusState(unexplained_silence_ns=9).after_damage().unexplained_silence_ns == 0


def test_request_is_pending_for_a_second() -> None:
    state = BusState(pending=pending(7))
    assert state.pending_at(1_000_000_007) == pending(7)
    assert state.pending_at(1_000_000_008) is None
    assert BusState().pending_at(0) is None


def test_response_awaited_exactly_has_unit_function_and_size() -> None:
    state = BusState(pending=pending())
    assert state.awaits_exactly(5, 0x06, 5)
    for unit, code, size in ((6, 0x06, 5), (5, 0x86, 5), (5, 0x06, 4)):
        assert state.awaits_exactly(unit, code, size) is False
    assert BusState().awaits_exactly(5, 0x06, 5) is False


@pytest.mark.parametrize(
    ("role", "answered", "start_ns", "inside_ns", "is_settled"),
    [
        (Direction.RESPONSE, False, 101, 0, True),
        (Direction.RESPONSE, False, 100, 0, False),
        (Direction.RESPONSE, False, 100, 1, True),
        (Direction.REQUEST, True, 101, 0, True),
        (Direction.REQUEST, False, 101, 0, False),
        (Direction.REQUEST, False, 101, 1, False),
    ],
)
def test_next_silence_settles_the_last_unless_a_response_is_missing(
    role: Direction, answered: bool, start_ns: int, inside_ns: int, is_settled: bool
) -> None:
    one = pending() if answered else None
    state = BusState(answered=one, last_ns=100, unexplained_silence_ns=9)
    assert state.settles_silence(role, start_ns, inside_ns) is is_settled
    assert BusState(answered=one, last_ns=100).settles_silence(role, start_ns, inside_ns) is False
    unknown = BusState(answered=one, unexplained_silence_ns=9)
    assert unknown.settles_silence(role, start_ns, 0) is False


def test_recent_request_is_the_answered_or_the_overdue_one() -> None:
    state = BusState(answered=pending(), last_response=WRITE)
    assert state.has_recent_request(5, 0x06)
    assert state.has_recent_request(5, 0x86)
    assert not state.has_recent_request(5, 0x03)
    assert not state.has_recent_request(6, 0x06)
    assert BusState(overdue=pending()).has_recent_request(5, 0x06)
    assert not BusState(pending=pending()).has_recent_request(5, 0x06)
