"""Makes the bytes of a response on the wire, with simulated faults of a slave or a line."""

# A Response has a PDU and a Distortion, which lists the faults. A simulated slave calls
# `wire_pieces` for the bytes to send: the ADU with another unit or transaction id, with a wrong CRC
# or LRC, cut short, with more bytes behind it, or in pieces with pauses between them. The faults
# are applied in this order.
#
# A Modbus/TCP ADU has no CRC or LRC, so `wrong_check` changes nothing there.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.adu import Transport
from mbtool.modbus.adu_bytes import ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.response import Distortion

if TYPE_CHECKING:
    from mbtool.modbus.response import Response

_CR_LF_BYTES = 2
_HEX_DIGITS = b"0123456789ABCDEF"


def wire_pieces(
    response: Response, transport: Transport, unit: int, transaction_id: int = 0
) -> list[tuple[int, bytes]]:
    """Return the bytes to send for a response, in pieces; no pieces if it is not sent.

    Each piece comes with the time at which to send it, in ns after the first piece.
    """
    faults = response.distortion or Distortion()
    if faults.silent:
        return []
    adu = _adu(response.pdu, transport, unit + faults.unit_by & 0xFF, transaction_id + faults.id_by)
    if faults.wrong_check:
        adu = _with_wrong_check(adu, transport)
    adu = adu[: max(len(adu) - faults.cut, 0)] + faults.extra
    count = max(min(faults.pieces, len(adu)), 1)
    starts = [len(adu) * number // count for number in range(count + 1)]
    return [
        (number * faults.gap_ns, adu[starts[number] : starts[number + 1]])
        for number in range(count)
        if adu
    ]


def _adu(pdu: bytes, transport: Transport, unit: int, transaction_id: int) -> bytes:
    match transport:
        case Transport.TCP | Transport.UDP:
            return mbap_adu(transaction_id & 0xFFFF, unit, pdu)
        case Transport.ASCII:
            return ascii_adu(unit, pdu)
        case _:
            return rtu_adu(unit, pdu)


def _with_wrong_check(adu: bytes, transport: Transport) -> bytes:
    if transport.has_mbap:
        return adu
    if transport is not Transport.ASCII:
        return adu[:-1] + bytes([adu[-1] ^ 0xFF])
    at = len(adu) - _CR_LF_BYTES - 1  # The last digit of the LRC.
    digit = _HEX_DIGITS[_HEX_DIGITS.index(adu[at]) ^ 0xF]
    return adu[:at] + bytes([digit]) + adu[at + 1 :]
