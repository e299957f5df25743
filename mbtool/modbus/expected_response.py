"""The response that a request asks for: its first bytes and its length."""

# The first bytes and the length follow from the request (V1.1b3, section 6). Every frame of a
# serial line is compared with them, so this must be quick: bytes are compared, and no PDU is
# parsed.

from __future__ import annotations

from functools import lru_cache

import msgspec

from mbtool.core import Direction
from mbtool.modbus.functions import (
    ECHOING,
    EXCEPTION_BIT,
    FORCE_LISTEN_ONLY,
    FUNCTIONS,
    QUERY_DATA,
    READ_BITS,
    READS,
    WRITE_SEVERAL,
)
from mbtool.modbus.layouts import bit_bytes
from mbtool.modbus.pdu import Pdu, parse_pdu

UNKNOWN_SIZE = 0
EXCEPTION_SIZE = 2
"""The size of the PDU of an exception response in bytes."""
MAX_KNOWN = 1024
"""The expected responses of this many different requests are remembered; beyond that, the least
recently used one is forgotten."""

_ECHOED = ECHOING - {0x08}  # 08 echoes only some of its sub-functions.
_SIZES = {code: one.response.length(b"") or UNKNOWN_SIZE for code, one in FUNCTIONS.items()}
"""The size in bytes of the response's PDU, by function code; UNKNOWN_SIZE if the function alone
does not tell it."""


class ExpectedResponse(msgspec.Struct, frozen=True, gc=False):
    """The properties of a response that follow from its request."""

    code: int
    """The function code of the request."""
    prefix: bytes
    """The bytes with which the response's PDU must begin, unless it is an exception response."""
    size: int = UNKNOWN_SIZE
    """The length of the response's PDU in bytes; UNKNOWN_SIZE if the request does not tell it."""

    @classmethod
    @lru_cache(maxsize=MAX_KNOWN)  # Masters repeat the same few requests.
    def of(cls, request: bytes) -> ExpectedResponse | None:
        """The response expected to the request with this PDU; None if it has no response."""
        code = request[0]
        if code in _ECHOED:
            return cls(code, request, len(request))
        if code in READS:
            quantity = int.from_bytes(request[3:5])
            count = bit_bytes(quantity) if code in READ_BITS else 2 * quantity
            # If the quantity is above the limit, the count may exceed 255. Then no response fits,
            # as no PDU has this many bytes.
            return cls(code, bytes((code, count & 0xFF)), 2 + count)
        if code in WRITE_SEVERAL:
            return cls(code, request[:5], 5)
        if code == 0x08:
            sub_function = int.from_bytes(request[1:3])
            if sub_function == FORCE_LISTEN_ONLY:
                return None
            echoed = request if sub_function == QUERY_DATA else request[:3]
            return cls(code, echoed, len(request))
        if code == 0x2B:
            return cls(code, request[:2])
        return cls(code, request[:1], _SIZES.get(code, UNKNOWN_SIZE))

    def fits(self, pdu: bytes) -> bool:
        """True if a PDU can be the normal response or an exception response to this request."""
        if pdu[0] == self.code:
            return pdu.startswith(self.prefix) and self.size in (UNKNOWN_SIZE, len(pdu))
        return len(pdu) == EXCEPTION_SIZE and self.is_named_by(pdu[0])

    def fits_start(self, pdu: bytes, size: int) -> bool:
        """True if a response with a PDU of `size` bytes can begin with the bytes of `pdu`."""
        if pdu[0] != self.code:
            return size == EXCEPTION_SIZE and self.is_named_by(pdu[0])
        return self.prefix.startswith(pdu[: len(self.prefix)]) and self.size in (UNKNOWN_SIZE, size)

    def is_named_by(self, code: int) -> bool:
        """True if `code` is the request's function code, with or without the exception bit."""
        return code in (self.code, self.code | EXCEPTION_BIT)


# The code below decides whether a response belongs to a request of the same unit, and says why it
# does not.
#
# The fields of the two PDUs are compared: a field that a response repeats must be equal in both.
# Decoders of a serial line use ExpectedResponse instead, which compares bytes and is stricter: each
# response that it accepts, the functions below accept, too.

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
