"""Requests and responses prove their order again after a loss."""

from __future__ import annotations

from mbtool.core import Direction
from mbtool.decode.open_requests import OpenRequest
from mbtool.decode.order_doubt import MAX_IDS, MAX_SHIFT, OrderDoubt
from mbtool.decode.stream_progress import AduPlace
from mbtool.framing import MbapSplitter
from mbtool.modbus.adu import Adu, mbap_adu

SIZES = (2, 10, 64)


def request(number: int, size: int, transaction_id: int = 0) -> OpenRequest:
    pdu = b"\x03" + bytes(2) + size.to_bytes(2)
    (adu,) = MbapSplitter(Direction.REQUEST).feed(mbap_adu(transaction_id, 1, pdu), number)
    assert isinstance(adu, Adu)
    place = AduPlace(12 * number, 0)
    return OpenRequest(number=number, since_ns=number, adu=adu, place=place)


def response(size: int, transaction_id: int = 0) -> Adu:
    pdu = b"\x03" + bytes([2 * size]) + bytes(2 * size)
    (adu,) = MbapSplitter(Direction.RESPONSE).feed(mbap_adu(transaction_id, 1, pdu), 9)
    assert isinstance(adu, Adu)
    return adu


def test_responses_of_different_lengths_prove_the_order() -> None:
    requests = [request(number, SIZES[number % 3]) for number in range(1, 7)]
    doubt = OrderDoubt(requests)
    settled = []
    for number, one in enumerate(requests, 1):
        doubt.exclude_shifts(response(SIZES[number % 3]), AduPlace(900, 72), one, 3)
        settled.append(doubt.is_settled(3))
    assert settled == [False, False, True, True, True, True]


def test_equal_requests_prove_nothing() -> None:
    requests = [request(number, 2) for number in range(1, 9)]
    doubt = OrderDoubt(requests)
    for one in requests:
        doubt.exclude_shifts(response(2), AduPlace(900, 96), one, 2)
    assert not doubt.is_settled(2)


def test_what_was_not_received_cannot_be_answered() -> None:
    first, second = request(1, 2), request(2, 2)
    doubt = OrderDoubt([first, second], others_answered=True)
    doubt.exclude_shifts(response(2), AduPlace(900, 24), first, 2)
    assert not doubt.is_settled(2)  # The slave had received both.
    doubt = OrderDoubt([first, second], others_answered=True)
    doubt.exclude_shifts(response(2), AduPlace(900, 12), first, 2)
    assert doubt.is_settled(2)


def test_a_request_that_is_passed_over_begins_the_proof_anew() -> None:
    requests = [request(number, SIZES[number % 3]) for number in range(1, 7)]
    doubt = OrderDoubt(requests, others_answered=True)
    doubt.exclude_shifts(response(SIZES[1]), AduPlace(900, 72), requests[0], 2)
    assert doubt.is_settled(2)
    doubt = OrderDoubt(requests)
    for place in (0, 1, 2):
        doubt.exclude_shifts(
            response(SIZES[(place + 1) % 3]), AduPlace(900, 72), requests[place], 3
        )
    assert doubt.is_settled(3)
    doubt.exclude_shifts(response(SIZES[2]), AduPlace(900, 72), requests[4], 4)
    assert not doubt.is_settled(4)


def test_a_response_to_a_request_before_the_last_answered_one_proves_nothing() -> None:
    requests = [request(number, SIZES[number % 3]) for number in range(1, 7)]
    doubt = OrderDoubt(requests)
    for at in (0, 1, 3):
        doubt.exclude_shifts(response(SIZES[(at + 1) % 3]), AduPlace(900, 72), requests[at], 3)
    doubt.exclude_shifts(response(SIZES[0]), AduPlace(900, 72), requests[2], 3)
    assert not doubt.is_settled(3)


def test_each_transaction_id_has_its_own_order() -> None:
    one, two = request(1, 2, transaction_id=1), request(2, 2, transaction_id=2)
    doubt = OrderDoubt([one, two])
    assert doubt.is_settled(1)
    assert not doubt.is_settled(2)


def test_after_a_choice_a_response_may_have_come_late() -> None:
    one = request(1, 2)
    assert OrderDoubt([one]).is_settled(1)
    assert not OrderDoubt([one], is_of_choice=True).is_settled(1)


def test_a_lost_request_begins_the_doubt_anew() -> None:
    one = request(1, 2)
    doubt = OrderDoubt([one])
    doubt.note_request(OpenRequest(number=2, since_ns=2, adu=None))
    assert not doubt.is_settled(1)


def test_what_is_remembered_is_bounded() -> None:
    doubt = OrderDoubt(request(number, 2, transaction_id=number) for number in range(1, 1000))
    assert len(doubt._queues) <= MAX_IDS + 1
    doubt = OrderDoubt(request(number, 2) for number in range(1, 1000))
    assert len(doubt._queues[0].requests) == 2 * MAX_SHIFT
    assert not doubt.is_settled(MAX_SHIFT + 1)
