"""What the plant's masters ask: requests of which each has bytes of its own, so that a log's

transaction can be found by them.
"""

# A number counts the requests of a link. It is in the address of a read, and in the values of a
# write. Its lower 16 bits are the transaction id in Modbus/TCP. Built by hand from the standard
# (V1.1b3, 6.3, 6.12 and 6.17), so that no code of mbtool says what is right.

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum
from threading import Lock

REGISTERS = 20_000


class Touch(StrEnum):
    """What the plant did to a transaction on purpose."""

    NONE = ""
    NOISE_BEFORE = "noise before it"
    DAMAGED_REQUEST = "request damaged"
    DAMAGED_RESPONSE = "response damaged"
    FLOOD = "one of many sent at once"


NOISES = (Touch.NOISE_BEFORE, Touch.DAMAGED_REQUEST, Touch.DAMAGED_RESPONSE)


@dataclass(slots=True)
class Asked:
    """A request that was sent, and what came of it; times in UTC ns."""

    link: str
    request: bytes
    sent_ns: int
    response: bytes = b""
    answered_ns: int = 0
    touch: Touch = Touch.NONE
    is_broken: bool = False
    """True if its connection ended before the response."""


class Numbers:
    """Counts the requests of a link."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._last = 0

    def next(self) -> int:
        with self._lock:
            self._last += 1
            return self._last


def request_pdu(number: int) -> bytes:
    """A request PDU: in turn write, write and read at once, read."""
    address = number * 7 % (REGISTERS - 2)
    written = struct.pack(">HHBI", address, 2, 4, number)
    if number % 4 == 0:
        return struct.pack(">BHH", 3, address, 2)
    if number % 4 == 1:
        return b"\x17" + struct.pack(">HH", address, 2) + written
    return b"\x10" + written


def tcp_adu(number: int, pdu: bytes, unit: int = 1) -> bytes:
    return struct.pack(">HHHB", number & 0xFFFF, 0, len(pdu) + 1, unit) + pdu


def rtu_adu(unit: int, pdu: bytes) -> bytes:
    frame = bytes([unit]) + pdu
    return frame + struct.pack("<H", crc16(frame))


def crc16(data: bytes) -> int:
    """CRC of Modbus over serial line V1.02, 6.2.2."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def response_length(pdu: bytes) -> int:
    """How many bytes of PDU a response without exception to one of these requests has."""
    return 5 if pdu[0] == 0x10 else 6


def slow_response(request: bytes) -> bytes:
    """What a unit answers to a request PDU that holds nothing but zeros."""
    if request[0] == 0x10:
        return request[:5]
    return bytes([request[0], 4]) + bytes(4)
