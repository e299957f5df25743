"""What a faulty slave, or a line, does to an answer on its way out."""

# A Spoiling stands beside the PDU in an Answer, and the shell that sends it asks `wire_pieces` for
# what really leaves: the ADU under another unit or transaction id, with a wrong check, cut short,
# with bytes behind it, or in pieces with silence between them. What is done is done in that order.
#
# A Modbus/TCP ADU has no check, so there a wrong one is none.

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from mbtool.modbus.adu import Transport
from mbtool.modbus.adu_bytes import ascii_adu, mbap_adu, rtu_adu

if TYPE_CHECKING:
    from mbtool.modbus.response import Response

_CR_LF_BYTES = 2
_HEX_DIGITS = b"0123456789ABCDEF"


class ConnectionEnding(StrEnum):
    """What becomes of a connection behind an answer."""

    CLOSE = "close"
    """Closed in order, with a FIN."""
    RESET = "reset"
    """Cut off, with a RST."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distortion:
    """How an answer is spoilt; by default it is not."""

    unit_by: int = 0
    """What is added to the unit."""
    id_by: int = 0
    """What is added to the transaction id of Modbus/TCP."""
    wrong_check: bool = False
    """The CRC or LRC is another one."""
    cut: int = 0
    """How many bytes of the ADU are missing at its end."""
    extra: bytes = b""
    """What follows the ADU."""
    pieces: int = 1
    gap_ns: int = 0
    """The silence between two pieces."""
    silent: bool = False
    """Nothing is sent."""
    ending: ConnectionEnding | None = None


def wire_pieces(
    answer: Response, transport: Transport, unit: int, transaction_id: int = 0
) -> list[tuple[int, bytes]]:
    """What leaves for an answer: pieces, each with its time from the first one on, in ns."""
    spoiling = answer.spoiling or Distortion()
    if spoiling.silent:
        return []
    adu = _adu(
        answer.pdu, transport, unit + spoiling.unit_by & 0xFF, transaction_id + spoiling.id_by
    )
    if spoiling.wrong_check:
        adu = _with_wrong_check(adu, transport)
    adu = adu[: max(len(adu) - spoiling.cut, 0)] + spoiling.extra
    count = max(min(spoiling.pieces, len(adu)), 1)
    starts = [len(adu) * number // count for number in range(count + 1)]
    return [
        (number * spoiling.gap_ns, adu[starts[number] : starts[number + 1]])
        for number in range(count)
        if adu
    ]


def _adu(pdu: bytes, transport: Transport, unit: int, transaction_id: int) -> bytes:
    match transport:
        case Transport.TCP:
            return mbap_adu(transaction_id & 0xFFFF, unit, pdu)
        case Transport.ASCII:
            return ascii_adu(unit, pdu)
        case _:
            return rtu_adu(unit, pdu)


def _with_wrong_check(adu: bytes, transport: Transport) -> bytes:
    if transport is Transport.TCP:
        return adu
    if transport is not Transport.ASCII:
        return adu[:-1] + bytes([adu[-1] ^ 0xFF])
    at = len(adu) - _CR_LF_BYTES - 1  # The LRC's last digit becomes another digit.
    digit = _HEX_DIGITS[_HEX_DIGITS.index(adu[at]) ^ 0xF]
    return adu[:at] + bytes([digit]) + adu[at + 1 :]
