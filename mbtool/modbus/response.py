"""A response that a simulated slave gives, and the interface of simulated slaves."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from mbtool.core import EventKind, WireEvent
from mbtool.modbus.adu import Transport, ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.transaction import Outcome, Transaction

# DamagedAnswers finds requests whose response came with a wrong CRC or LRC.
#
# If the CRC or LRC of a frame is wrong, its unit id proves nothing. So the frame is taken for the
# response to the request that was pending when it came. That request is known as soon as its
# transaction ends without a response.
#
# Memory: the times of the last MAX_FRAMES such frames of each line.

MAX_FRAMES = 16


class DamagedAnswers:
    """Matches damaged frames with requests without a response.

    Give `note` all events, and `has` or `frame_of` all transactions, in the order of a decoder's
    results.
    """

    def __init__(self) -> None:
        self._frames_ns: dict[str, deque[int]] = {}
        """By link, the times (UTC ns) of damaged frames that are not matched with a request yet."""

    def note(self, event: WireEvent) -> None:
        if event.kind is EventKind.BAD_CHECK:
            frames = self._frames_ns.setdefault(event.link, deque(maxlen=MAX_FRAMES))
            frames.append(event.ts_ns)

    def has(self, one: Transaction) -> bool:
        """True if a transaction has no response because a damaged frame was its response.

        Call this or `frame_of` once for each transaction: the damaged frame is then forgotten, as
        it is the response to one request only.
        """
        return self.frame_of(one) is not None

    def frame_of(self, one: Transaction) -> int | None:
        """Return the time (UTC ns) of the damaged frame that was a transaction's response.

        None if there was none.
        """
        if one.outcome is not Outcome.NO_ANSWER or one.link not in self._frames_ns:
            return None
        frames = self._frames_ns[one.link]
        while frames:
            frame_ns = frames.popleft()
            if frame_ns >= one.start_ns:
                return frame_ns
        return None


class ConnectionEnding(StrEnum):
    """The way in which a simulated slave ends a TCP connection after a response."""

    CLOSE = "close"
    """The slave closes the connection in the normal way, with a FIN."""
    RESET = "reset"
    """The slave ends the connection at once, with a RST."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distortion:
    """The faults of one response; by default none."""

    unit_by: int = 0
    """A number that is added to the unit of the response, modulo 256."""
    id_by: int = 0
    """A number that is added to the transaction id of a Modbus/TCP response, modulo 65536."""
    wrong_check: bool = False
    """True if the response is sent with a wrong CRC or LRC."""
    cut: int = 0
    """Number of bytes at the end of the ADU that are not sent."""
    extra: bytes = b""
    """Bytes that are sent directly after the ADU."""
    pieces: int = 1
    """The number of pieces in which the bytes are sent."""
    gap_ns: int = 0
    """The time from the beginning of one piece to the beginning of the next, in ns."""
    silent: bool = False
    """True if the response is not sent at all."""
    ending: ConnectionEnding | None = None
    """The way in which the connection ends after the response; None if it stays open."""


@dataclass(frozen=True, slots=True)
class Response:
    """A response PDU and the time that the slave waits before it sends the response."""

    pdu: bytes
    delay_ns: int = 0
    """The time from the end of the request to the start of the response, in ns."""
    distortion: Distortion | None = None
    """The faults with which the response is sent; None if it is sent without faults."""


class Responder(Protocol):
    """Responds to requests as one or more slaves."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        """The response to a request PDU; None if the slave stays silent. Never raises for a PDU."""
        ...


# The code below makes the bytes of a response on the wire, with simulated faults of a slave or a
# line.
#
# A Response has a PDU and a Distortion, which lists the faults. A simulated slave calls
# `wire_pieces` for the bytes to send: the ADU with another unit or transaction id, with a wrong CRC
# or LRC, cut short, with more bytes behind it, or in pieces with pauses between them. The faults
# are applied in this order.
#
# A Modbus/TCP ADU has no CRC or LRC, so `wrong_check` changes nothing there.

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
