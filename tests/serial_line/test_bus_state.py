"""Turns as values."""

from __future__ import annotations

import pytest

from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.serial_line.bus_state import (
    DOUBT,
    MOST_TURNS,
    BusState,
    PendingRequest,
    bits_of,
    likeliest,
    likelihood,
)

WRITE = bytes.fromhex("06 0001 0003")


def waiting(since_ns: int = 0) -> PendingRequest:
    expected = ExpectedResponse.of(WRITE)
    assert expected is not None
    return PendingRequest(5, WRITE, expected, since_ns, None)


def test_likelihood_of_the_better_of_two() -> None:
    assert likelihood(0) == 0.5
    assert likelihood(1) == pytest.approx(2 / 3)
    assert likelihood(10) > 0.999


def test_bits_are_the_reverse_of_likelihood() -> None:
    for bits in (0.0, 0.5, 1.0, 6.0, 12.0):
        assert bits_of(likelihood(bits)) == pytest.approx(bits)
    assert bits_of(1.0) == float("inf")


def test_likeliest_turns_are_in_order_and_each_there_once() -> None:
    asked, answered = BusState(waiting=waiting()), BusState(answered=waiting(), answer=WRITE)
    turns = [(2.0, asked), (0.0, answered), (1.0, BusState(waiting=waiting()))]
    assert likeliest(turns) == [(0.0, answered), (1.0, asked)]


def test_turns_that_are_much_less_likely_are_given_up() -> None:
    turns = [(0.0, BusState()), (DOUBT, BusState(waiting=waiting()))]
    assert likeliest(turns) == [(0.0, BusState())]


def test_number_of_turns_is_bounded() -> None:
    turns = [(0.1, BusState(waiting=waiting(since_ns))) for since_ns in range(3 * MOST_TURNS)]
    assert len(likeliest(turns)) == MOST_TURNS


def test_damage_leaves_the_answer_owed() -> None:
    lost = BusState(waiting=waiting(), last_ns=7).behind_damage()
    assert (lost.waiting, lost.owed, lost.lost, lost.last_ns) == (None, waiting(), True, 7)


def test_turn_names_the_request_that_was_just_answered() -> None:
    turn = BusState(answered=waiting(), answer=WRITE)
    assert turn.is_of_turn(5, 0x06)
    assert turn.is_of_turn(5, 0x86)
    assert not turn.is_of_turn(5, 0x03)
    assert not turn.is_of_turn(6, 0x06)
    assert BusState(owed=waiting()).is_of_turn(5, 0x06)
    assert not BusState(waiting=waiting()).is_of_turn(5, 0x06)
