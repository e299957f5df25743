"""Rules for PDUs of a correct form whose contents no master or slave sends, or hardly ever."""

from __future__ import annotations

from mbtool.modbus.functions import EXCEPTION_BIT, READ_REGISTERS
from mbtool.modbus.layouts import bit_bytes

COUNTS = frozenset((2, *range(11, 19)))
"""Sub-functions of 08 that read a register or a counter (V1.1b3, 6.8.1)."""
ODD_EXCEPTIONS = 0x40
"""No known device uses exception code 0, this exception code or a higher one."""


def is_odd_request(pdu: bytes) -> bool:
    """True if a PDU with the form of a request has contents that no master sends.

    A request for a counter (function 08) always has 0000 as data (V1.1b3, 6.8.1).
    """
    if pdu[0] & EXCEPTION_BIT:
        return True
    return pdu[0] == 0x08 and int.from_bytes(pdu[1:3]) in COUNTS and any(pdu[3:])


def is_odd_response(pdu: bytes) -> bool:
    """True if a PDU with the form of a response has contents that no slave sends.

    That is an odd number of bytes in a response that brings registers, or an exception code that
    neither the specification nor devices use.
    """
    if pdu[0] & EXCEPTION_BIT:
        return len(pdu) == 2 and not 0 < pdu[1] < ODD_EXCEPTIONS
    return pdu[0] in READ_REGISTERS and len(pdu) % 2 == 1


def is_counted(pdu: bytes) -> bool:
    """True if a PDU begins like a write request whose byte count agrees with its quantity."""
    match pdu[0]:
        case 0x0F:
            return len(pdu) > 5 and pdu[5] == bit_bytes(int.from_bytes(pdu[3:5]))
        case 0x10:
            return len(pdu) > 5 and pdu[5] == 2 * int.from_bytes(pdu[3:5])
        case 0x17:
            return len(pdu) > 9 and pdu[9] == 2 * int.from_bytes(pdu[7:9])
        case _:
            return False


def is_padded(request: bytes, response: bytes) -> bool:
    """True if the unused bits of a response to a read of bits, in its last byte, are 0.

    The standard demands it (V1.1b3, 6.1).
    """
    used = int.from_bytes(request[3:5]) % 8
    return not used or response[-1] >> used == 0
