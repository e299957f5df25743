"""What a PDU says that none of its function does, or that hardly any does by chance."""

from __future__ import annotations

from mbtool.modbus.functions import EXCEPTION_BIT, READ_REGISTERS
from mbtool.modbus.packing import bit_bytes

COUNTS = frozenset((2, *range(11, 19)))
"""Sub-functions of 08 that ask for a register or a count (V1.1b3, 6.8.1)."""
ODD_EXCEPTIONS = 0x40
"""Exception codes from here on, and 0, are nobody's."""


def is_odd_request(pdu: bytes) -> bool:
    """Whether a PDU has the form of a request and says what none does.

    One for a register or a count of 08 has 0000 in its data (V1.1b3, 6.8.1).
    """
    if pdu[0] & EXCEPTION_BIT:
        return True
    return pdu[0] == 0x08 and int.from_bytes(pdu[1:3]) in COUNTS and any(pdu[3:])


def is_odd_response(pdu: bytes) -> bool:
    """Whether a PDU has the form of a response and says what none does.

    Half a register, or an exception far from those that the specification and devices have.
    """
    if pdu[0] & EXCEPTION_BIT:
        return len(pdu) == 2 and not 0 < pdu[1] < ODD_EXCEPTIONS
    return pdu[0] in READ_REGISTERS and len(pdu) % 2 == 1


def is_counted(pdu: bytes) -> bool:
    """Whether a PDU begins as a write whose byte count agrees with its quantity."""
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
    """Whether the bits behind those that a read asked for are 0 (V1.1b3, 6.1)."""
    used = int.from_bytes(request[3:5]) % 8
    return not used or response[-1] >> used == 0
