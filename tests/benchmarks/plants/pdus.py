"""Makes PDUs and RTU frames from the words of the specification, without the package under test."""

# MODBUS Application Protocol V1.1b3 section 6, MODBUS over Serial Line V1.02 section 2.5.1. The
# benchmark's truth must not share a mistake with the decoder, so nothing of mbtool is used here.

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

READS_OF_BITS = (0x01, 0x02)
ECHOED = (0x05, 0x06, 0x08, 0x15, 0x16)
"""Functions whose response equals the request (08: of most sub-functions)."""
USER_DEFINED = (*range(65, 73), *range(100, 111))
UMAS = 0x5A
"""Schneider's programming protocol, which uses a code that the specification does not give away."""
MAX_PDU = 253


def crc(data: bytes) -> bytes:
    """The CRC of a frame, as it is sent: low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + crc(body)


def read(function: int, address: int, quantity: int) -> bytes:
    """A request of 01 to 04."""
    return struct.pack(">BHH", function, address, quantity)


def read_response(function: int, values: Sequence[int]) -> bytes:
    """The response to it: bits packed from the lowest on, or registers."""
    is_bits = function in READS_OF_BITS
    packed = bits(values) if is_bits else struct.pack(f">{len(values)}H", *values)
    return bytes([function, len(packed)]) + packed


def bits(values: Sequence[int]) -> bytes:
    whole = sum(1 << place for place, bit in enumerate(values) if bit)
    return whole.to_bytes(-(-len(values) // 8), "little")


def write_coil(address: int, is_on: bool) -> bytes:
    return struct.pack(">BHH", 0x05, address, 0xFF00 if is_on else 0)


def write_register(address: int, value: int) -> bytes:
    return struct.pack(">BHH", 0x06, address, value)


def write_coils(address: int, values: Sequence[int]) -> bytes:
    data = bits(values)
    return struct.pack(">BHHB", 0x0F, address, len(values), len(data)) + data


def write_registers(address: int, values: Sequence[int]) -> bytes:
    data = struct.pack(f">{len(values)}H", *values)
    return struct.pack(">BHHB", 0x10, address, len(values), len(data)) + data


def mask_write(address: int, and_mask: int, or_mask: int) -> bytes:
    return struct.pack(">BHHH", 0x16, address, and_mask, or_mask)


def diagnostics(sub_function: int, data: int) -> bytes:
    return struct.pack(">BHH", 0x08, sub_function, data)


def exception(function: int, code: int) -> bytes:
    return bytes([function | 0x80, code])


def write_response(request: bytes) -> bytes:
    """The response of a slave that did what a write asked for."""
    return request[:5] if request[0] in (0x0F, 0x10) else request
