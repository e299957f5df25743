"""Whether a response belongs to a request of the same unit, and in words why it does not."""

# By meaning: what both PDUs name must agree. Whose turn it is on a line goes by the bytes of a
# response, which say more than that (expectation.py); what fits there belongs together here too.

from __future__ import annotations

from mbtool.core import Direction
from mbtool.modbus.functions import EXCEPTION_BIT, READ_BITS
from mbtool.modbus.packing import bit_bytes
from mbtool.modbus.pdu import Pdu, parse_pdu

ECHOED = frozenset(
    {"address", "value", "sub_function", "and_mask", "or_mask", "mei_type", "quantity"}
)
"""The numbers that a response has only to repeat them."""


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
    for name in response.fields:
        if name not in ECHOED:
            continue
        asked, answered = request.number(name), response.number(name)
        if asked is not None and answered is not None and asked != answered:
            return f"{name.replace('_', ' ')} {answered} for {asked}"
    if request.code == 0x08 and request.number("sub_function") == 0:
        asked_for, echo = request.numbers("values"), response.numbers("values")
        if asked_for is not None and echo is not None and asked_for != echo:
            return f"data {echo} for {asked_for}"  # It is returned as it is (V1.1b3, 6.8.1).
    return None
