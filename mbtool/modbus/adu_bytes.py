"""Makes the ADU of a PDU for each transport, and computes the CRC and the LRC."""

from __future__ import annotations

import struct

from fastcrc import crc16

MBAP_BYTES = 7
RTU_EXTRA_BYTES = 3
"""Unit and CRC."""


def crc(data: bytes) -> int:
    """CRC-16/MODBUS (Serial Line V1.02, 6.2.2); 0 over a frame with its own correct CRC."""
    return crc16.modbus(data)


def crc_on(before: int, data: bytes) -> int:
    """The CRC of some bytes followed by `data`; `before` is the CRC of these bytes."""
    return crc16.modbus(data, before)


def lrc(data: bytes) -> int:
    """The two's complement of the 8-bit sum (Serial Line V1.02, 6.2.1)."""
    return -sum(data) & 0xFF


def rtu_adu(unit: int, pdu: bytes) -> bytes:
    """Unit, PDU and CRC, its low byte first."""
    body = bytes([unit]) + pdu
    return body + crc(body).to_bytes(2, "little")


def ascii_adu(unit: int, pdu: bytes) -> bytes:
    """A colon, unit, PDU and LRC as upper-case hexadecimal digits, CR and LF."""
    body = bytes([unit]) + pdu
    return b":" + (body + bytes([lrc(body)])).hex().upper().encode("ascii") + b"\r\n"


def mbap_adu(transaction_id: int, unit: int, pdu: bytes) -> bytes:
    """The MBAP header and the PDU (TCP/IP Implementation Guide V1.0b, 3.1.3)."""
    return struct.pack(">HHHB", transaction_id, 0, 1 + len(pdu), unit) + pdu
