"""What a request lets one expect of its response, as bytes."""

# From the request's form (V1.1b3, section 6): with which bytes its response begins and how long it
# is. This is asked of each frame on a line, so nothing is parsed.

from __future__ import annotations

from functools import lru_cache

import msgspec

from mbtool.modbus.functions import (
    ECHOING,
    EXCEPTION_BIT,
    QUERY_DATA,
    READ_BITS,
    READ_REGISTERS,
    WRITE_SEVERAL,
)
from mbtool.modbus.packing import bit_bytes

UNKNOWN_SIZE = 0
MAX_KNOWN = 1024
"""Requests whose responses are remembered; beyond that the one unasked longest is forgotten."""

_ECHOED = ECHOING - {0x08}  # Of which only some sub-functions are.
_FIXED = {0x07: 2, 0x0B: 5}
_FORCE_LISTEN_ONLY = 4
"""The sub-function of 08 that nobody answers (V1.1b3, 6.8.1)."""


class ExpectedResponse(msgspec.Struct, frozen=True, gc=False):
    """The response that a request asks for."""

    code: int
    head: bytes
    """How its PDU begins."""
    size: int = UNKNOWN_SIZE
    """How long its PDU is; UNKNOWN_SIZE where only the response itself says."""

    @classmethod
    @lru_cache(maxsize=MAX_KNOWN)  # Masters ask the same few requests over and over.
    def of(cls, request: bytes) -> ExpectedResponse | None:
        """Read a request's PDU; None where nobody answers it."""
        code = request[0]
        if code in _ECHOED:
            return cls(code, request, len(request))
        if code in READ_REGISTERS or code in READ_BITS:
            quantity = int.from_bytes(request[3:5])
            count = 2 * quantity if code in READ_REGISTERS else bit_bytes(quantity)
            # More than a byte can count has no response but an exception: no PDU is so long.
            return cls(code, bytes((code, count & 0xFF)), 2 + count)
        if code in WRITE_SEVERAL:
            return cls(code, request[:5], 5)
        if code == 0x08:
            sub_function = int.from_bytes(request[1:3])
            if sub_function == _FORCE_LISTEN_ONLY:
                return None
            echoed = request if sub_function == QUERY_DATA else request[:3]
            return cls(code, echoed, len(request))
        if code == 0x2B:
            return cls(code, request[:2])
        return cls(code, request[:1], _FIXED.get(code, UNKNOWN_SIZE))

    def fits(self, pdu: bytes) -> bool:
        """Whether a PDU can be the response, or an exception response to the request."""
        if pdu[0] == self.code:
            return pdu.startswith(self.head) and self.size in (UNKNOWN_SIZE, len(pdu))
        return len(pdu) == 2 and self.is_named_by(pdu[0])

    def is_named_by(self, code: int) -> bool:
        """Whether a function code is the request's, as it is or as an exception's."""
        return code in (self.code, self.code | EXCEPTION_BIT)
