"""Whose turn it is on a bus where nothing says who speaks."""

# One tap on a two-wire line hears the master and the slaves alike. What a frame is follows from its
# form and from the request that waits for an answer: an answer names the request's unit and
# function, and fits its quantity or echoes its address. Without such a request a frame that has
# the form of a request is one. Requests and answers of 05, 06, 08, 15H and 16H look alike, so there
# only the turn decides.

from __future__ import annotations

from dataclasses import dataclass

from mbtool.core import Direction
from mbtool.modbus.adu import DirectionBy
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.modbus.packing import bit_bytes
from mbtool.modbus.pdu import Pdu, parse_pdu, pdu_length

DEFAULT_TURN_NS = 1_000_000_000
"""How long a request waits for its answer before the turn goes back to the master.

Serial Line V1.02, 2.4.1, gives 1 s to several seconds as the usual response timeout.
"""

READ_BITS = (0x01, 0x02)
ECHOED = ("address", "value", "sub_function", "and_mask", "or_mask", "mei_type", "quantity")
"""The numbers that a response has only to repeat them."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a frame is taken for."""

    direction: Direction
    by: DirectionBy
    confidence: float


@dataclass(frozen=True, slots=True)
class _Waiting:
    unit: int
    pdu: bytes
    parsed: Pdu
    since_ns: int


class Turns:
    """Keeps the one request that waits for an answer. Holds no more than that."""

    def __init__(self, turn_ns: int = DEFAULT_TURN_NS) -> None:
        self._turn_ns = turn_ns
        self._waiting: _Waiting | None = None

    def order(self, unit: int, code: int, at_ns: int) -> tuple[Direction, Direction]:
        """The roles to try for a frame that begins like this, the likelier first."""
        waiting = self._waiting_at(at_ns)
        if waiting and waiting.unit == unit and answers(waiting.parsed.code, code):
            return Direction.RESPONSE, Direction.REQUEST
        return Direction.REQUEST, Direction.RESPONSE

    def judge(self, unit: int, pdu: bytes, at_ns: int) -> Judgement:
        """Say what a whole frame is. `at_ns` is the time of its first byte."""
        waiting = self._waiting_at(at_ns)
        if waiting and waiting.unit == unit and is_answer_to(waiting.parsed, pdu):
            if pdu == waiting.pdu and pdu[0] in READ_BITS:
                # A read of 17 to 24 bits from 0300H to 03FFH has the form of its own answer. Its
                # repetition is likelier than an answer of just these bits.
                return Judgement(Direction.REQUEST, DirectionBy.IDLE, 0.9)
            return Judgement(Direction.RESPONSE, DirectionBy.PENDING, 0.99)
        as_request = pdu_length(pdu, Direction.REQUEST) == len(pdu)
        as_response = pdu_length(pdu, Direction.RESPONSE) == len(pdu)
        if as_request and as_response:
            # Both forms fit, and it answers nothing: the master speaks, or this is the middle of
            # a capture. An answer to another request than the one that waits is the rarer case.
            return Judgement(Direction.REQUEST, DirectionBy.IDLE, 0.7 if waiting else 0.9)
        if as_request:
            return Judgement(Direction.REQUEST, DirectionBy.FORM, 1.0)
        if as_response:
            return Judgement(Direction.RESPONSE, DirectionBy.FORM, 1.0)
        return Judgement(Direction.REQUEST, DirectionBy.IDLE, 0.5)

    def spoke(self, judgement: Judgement, unit: int, pdu: bytes, end_ns: int) -> None:
        """Note a frame that was given out. `end_ns` is the time of its last byte."""
        if judgement.direction is Direction.REQUEST:
            request = _Waiting(unit, pdu, parse_pdu(pdu, Direction.REQUEST), end_ns)
            self._waiting = request if unit != 0 else None  # Nobody answers a broadcast.
        elif self._waiting is not None and self._waiting.unit == unit:
            self._waiting = None

    def _waiting_at(self, at_ns: int) -> _Waiting | None:
        waiting = self._waiting
        if waiting is None or at_ns - waiting.since_ns > self._turn_ns:
            return None
        return waiting


def answers(request_code: int, response_code: int) -> bool:
    """Whether a function code answers another, as its response or as its exception response."""
    return response_code in (request_code, request_code | EXCEPTION_BIT)


def is_answer_to(request: Pdu, pdu: bytes) -> bool:
    """Whether a PDU can be the response to a request of the same unit."""
    if not pdu or not answers(request.code, pdu[0]):
        return False
    response = parse_pdu(pdu, Direction.RESPONSE)
    return response.problem is None and mismatch(request, response) is None


def mismatch(request: Pdu, response: Pdu) -> str | None:
    """How a response does not belong to its request, or None where it does."""
    quantity, values = request.number("quantity"), response.numbers("values")
    if quantity is not None and values is not None:
        bits = request.code in READ_BITS
        if len(values) != (8 * bit_bytes(quantity) if bits else quantity):
            held = f"{len(values) // 8} bytes of bits" if bits else f"{len(values)} registers"
            return f"{held} for a quantity of {quantity}"
    for echoed in ECHOED:
        asked, answered = request.number(echoed), response.number(echoed)
        if asked is not None and answered is not None and asked != answered:
            return f"{echoed.replace('_', ' ')} {answered} for {asked}"
    return None
