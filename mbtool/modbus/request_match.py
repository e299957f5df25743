"""Decides if a response belongs to a request of the same unit, and says why it does not."""

# The fields of the two PDUs are compared: a field that a response repeats must be equal in both.
# Decoders of a serial line compare bytes instead (expected_response.py), which is stricter: every
# response that is accepted there is also accepted here.

from __future__ import annotations

from mbtool.core import Direction
from mbtool.modbus.functions import EXCEPTION_BIT, READ_BITS
from mbtool.modbus.packing import bit_bytes
from mbtool.modbus.pdu import Pdu, parse_pdu

_REPEATED = frozenset(
    {"address", "value", "sub_function", "and_mask", "or_mask", "mei_type", "quantity"}
)
"""The names of the fields that a response repeats from its request."""


def is_response_code(request_code: int, response_code: int) -> bool:
    """True if a response, or exception response, to `request_code` has the code `response_code`."""
    return response_code in (request_code, request_code | EXCEPTION_BIT)


def is_response_to(request: Pdu, pdu: bytes) -> bool:
    """True if a PDU can be the response to a request of the same unit."""
    if not pdu or not is_response_code(request.code, pdu[0]):
        return False
    response = parse_pdu(pdu, Direction.RESPONSE)
    return response.problem is None and mismatch(request, response) is None


def mismatch(request: Pdu, response: Pdu) -> str | None:
    """Return the reason why a response does not belong to a request, as text; None if it does."""
    quantity, values = request.fields.get("quantity"), response.fields.get("values")
    if isinstance(quantity, int) and isinstance(values, tuple):
        bits = request.code in READ_BITS
        if len(values) != (8 * bit_bytes(quantity) if bits else quantity):
            held = f"{len(values) // 8} bytes of bits" if bits else f"{len(values)} registers"
            return f"{held} for a quantity of {quantity}"
    for name in response.fields:
        if name in _REPEATED:
            asked, answered = request.number(name), response.number(name)
            if asked is not None and answered not in (None, asked):
                if name == "value":  # As manuals write it: 0000H for FF00H.
                    return f"value {answered:04X}H for {asked:04X}H"
                return f"{name.replace('_', ' ')} {answered} for {asked}"
    if request.code == 0x08 and request.number("sub_function") == 0:
        asked_for, echo = request.numbers("values"), response.numbers("values")
        if asked_for is not None and echo is not None and asked_for != echo:
            return f"data {echo} for {asked_for}"  # A slave must return it unchanged (6.8.1).
    return None
