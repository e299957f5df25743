"""Makes the ADU of a PDU for each transport, and computes the CRC and the LRC."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from fastcrc import crc16

if TYPE_CHECKING:
    from collections.abc import Callable

MBAP_BYTES = 7
CRC_BYTES = 2
RTU_EXTRA_BYTES = 3
"""The number of bytes that an RTU ADU has in addition to the PDU: 1 for the unit, 2 for the CRC."""


crc: Callable[[bytes], int] = crc16.modbus
"""Returns the CRC-16/MODBUS of bytes (Serial Line V1.02, 6.2.2).

It is 0 for a whole RTU frame that ends with its own correct CRC. This is the library's function
itself, as a function around it would cost time with every frame."""


def crc_on(before: int, data: bytes) -> int:
    """Continue a CRC: `before` is the CRC of the bytes that come before `data`."""
    return crc16.modbus(data, before)


CRC_TABLE = tuple(crc_on(0, bytes([byte])) for byte in range(256))
"""For each byte, the CRC of that byte alone, if the register begins with 0. To continue a CRC by
one byte: `CRC_TABLE[(crc ^ byte) & 0xFF] ^ crc >> 8`."""


def lrc(data: bytes) -> int:
    """The LRC: the two's complement of the 8-bit sum of the bytes (Serial Line V1.02, 6.2.1)."""
    return -sum(data) & 0xFF


def rtu_adu(unit: int, pdu: bytes) -> bytes:
    """The RTU ADU of a PDU: unit, PDU and CRC, the low byte of the CRC first."""
    body = bytes([unit]) + pdu
    return body + crc(body).to_bytes(2, "little")


def ascii_adu(unit: int, pdu: bytes) -> bytes:
    """The ASCII ADU of a PDU: colon, unit, PDU and LRC as upper-case hexadecimal digits, CR, LF."""
    body = bytes([unit]) + pdu
    return b":" + (body + bytes([lrc(body)])).hex().upper().encode("ascii") + b"\r\n"


def mbap_size(header: bytes) -> int:
    """Return the size in bytes of the Modbus/TCP ADU with this MBAP header, by its length field."""
    return MBAP_BYTES - 1 + int.from_bytes(header[4:6])


def mbap_adu(transaction_id: int, unit: int, pdu: bytes) -> bytes:
    """The Modbus/TCP ADU: MBAP header and PDU (TCP/IP Implementation Guide V1.0b, 3.1.3)."""
    return struct.pack(">HHHB", transaction_id, 0, 1 + len(pdu), unit) + pdu
