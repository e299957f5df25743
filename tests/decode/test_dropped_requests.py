"""Requests beyond the limit of open requests, and their responses."""

from __future__ import annotations

import struct
from collections import Counter
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from mbtool.core import Connection, Direction, Endpoint
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.connections import ConnectionDecoder
from mbtool.decode.dropped_requests import DroppedRequests
from mbtool.modbus import Outcome, Transaction, Verdict, mbap_adu
from tests.decode.test_pairing import asked, told
from tests.modbus.reading import transactions

if TYPE_CHECKING:
    from collections.abc import Callable

MS = 1_000_000
COUNT = 4 * MAX_OPEN_REQUESTS
LIMITED = (Outcome.NOT_CAPTURED, (Verdict.OVER_LIMIT,))


def request(id_: int, address: int) -> bytes:
    return mbap_adu(id_, 1, struct.pack(">BHH", 3, address, 1))


def response(id_: int, address: int) -> bytes:
    """The response tells the address that was read, so that a wrong pair is seen."""
    return mbap_adu(id_, 1, struct.pack(">BBH", 3, 2, address))


def decoder() -> ConnectionDecoder:
    return ConnectionDecoder(Connection(Endpoint("10.0.0.1", 40000), Endpoint("10.0.0.9", 502)))


def demand_no_wrong_pair(done: list[Transaction]) -> None:
    for one in done:
        if one.request_raw is not None and one.response_raw is not None:
            assert one.response_values == [one.address]


@pytest.mark.parametrize(
    "id_of",
    [lambda _: 0, lambda number: number, lambda number: number * 211 & 0xFFFF],
    ids=["constant", "counting", "wrapping within the dropped requests"],
)
def test_all_responses_to_pipelined_requests_over_the_limit_are_told_as_such(
    id_of: Callable[[int], int],
) -> None:
    talk = decoder()
    decoded = talk.feed(
        Direction.REQUEST, b"".join(request(id_of(at), at) for at in range(COUNT)), MS
    )
    decoded += talk.feed(
        Direction.RESPONSE, b"".join(response(id_of(at), at) for at in range(COUNT)), 2 * MS
    )
    done = transactions([*decoded, *talk.close()])
    demand_no_wrong_pair(done)
    dropped = COUNT - MAX_OPEN_REQUESTS
    assert Counter((one.outcome, tuple(one.verdicts), one.request_raw is None) for one in done) == {
        (*LIMITED, False): dropped,
        (*LIMITED, True): dropped,
        (Outcome.OK, (), False): MAX_OPEN_REQUESTS,
    }


@pytest.mark.parametrize("silent", [9, 20, MAX_OPEN_REQUESTS - 1, COUNT])
def test_a_slave_that_is_silent_for_long_is_told_as_silent_and_then_answers(silent: int) -> None:
    """A master that sends one request after the other has given up those before the last."""
    talk = decoder()
    decoded = []
    for at in range(10):
        decoded += talk.feed(Direction.REQUEST, request(0, at), at * 100 * MS)
        decoded += talk.feed(Direction.RESPONSE, response(0, at), (at * 100 + 5) * MS)
    again = 10 + silent
    for at in range(10, again):
        decoded += talk.feed(Direction.REQUEST, request(0, at), at * 100 * MS)
    for at in range(again, again + 10):
        decoded += talk.feed(Direction.REQUEST, request(0, at), at * 100 * MS)
        decoded += talk.feed(Direction.RESPONSE, response(0, at), (at * 100 + 5) * MS)
    done = transactions([*decoded, *talk.close()])
    demand_no_wrong_pair(done)
    assert Counter(one.outcome for one in done) == {Outcome.OK: 20, Outcome.NO_ANSWER: silent}
    assert not any(one.verdicts for one in done)


def dropped(*keys: tuple[int, int], at_ns: int = 0) -> DroppedRequests:
    """Requests that were dropped, by transaction id and unit."""
    found = DroppedRequests()
    for id_, unit in keys:
        found.note(asked("03 0000 0001", 0, id_, unit), at_ns)
    return found


@pytest.mark.parametrize(("late_ns", "is_known"), [(0, True), (1, False)])
def test_a_dropped_request_is_remembered_for_a_minute(late_ns: int, is_known: bool) -> None:
    requests = dropped((3, 1), (3, 1), at_ns=5 * MS)
    response = told("03 02 0001", 5 + 60_000, 3)
    response = replace(response, start_ns=response.start_ns + late_ns)
    assert requests.take_response(response) is is_known
    assert requests.is_empty is not is_known


def test_each_dropped_request_gets_one_response() -> None:
    requests = dropped((3, 1), (3, 1), (4, 1))
    for id_, unit, is_known in ((3, 2, False), (3, 1, True), (4, 1, True), (3, 1, True)):
        assert not requests.is_empty
        assert requests.take_response(told("03 02 0001", 5, id_, unit)) is is_known
    assert requests.is_empty
    assert not requests.take_response(told("03 02 0001", 5, 3))


def test_dropped_requests_are_bounded_by_their_ids_and_units() -> None:
    requests = dropped(*((id_, 1) for id_ in range(1 << 16)), (5, 1))
    assert requests.take_response(told("03 02 0001", 5, 0))
    requests = dropped(*((id_, 1) for id_ in range(1 << 16)), (0, 2))
    # The oldest one made room.
    assert not requests.take_response(told("03 02 0001", 5, 0))
    assert requests.take_response(told("03 02 0001", 5, 1))
    assert requests.take_response(told("03 02 0001", 5, 0, 2))


def test_dropped_requests_are_forgotten_after_a_minute() -> None:
    talk = decoder()
    requests = b"".join(request(0, at) for at in range(COUNT))
    decoded = talk.feed(Direction.REQUEST, requests, MS)
    later = 61_000 * MS
    decoded += talk.feed(Direction.REQUEST, request(0, COUNT), later)
    decoded += talk.feed(Direction.RESPONSE, response(0, COUNT), later + MS)
    assert transactions(decoded)[-1].outcome is Outcome.OK
