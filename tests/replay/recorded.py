"""Recordings written down in a line per transaction."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.decode.transactions import Ends, broadcast, no_answer, unsolicited, with_response
from mbtool.modbus import Adu, Transport, ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.adu import DirectionBy

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

MS = 1_000_000
LATENCY_NS = 5 * MS

_ENDS = Ends("rs485")


def answered(
    at_ms: int,
    request: str,
    response: str,
    *,
    unit: int = 1,
    latency_ns: int = LATENCY_NS,
    transport: Transport = Transport.RTU,
) -> Transaction:
    """A request complete at a time, and its answer that takes no time on the wire."""
    at_ns = at_ms * MS
    asked = _adu(request, unit, at_ns, Direction.REQUEST, transport)
    answer = _adu(response, unit, at_ns + latency_ns, Direction.RESPONSE, transport)
    return with_response(_ENDS, asked, answer, 0, ())


def unanswered(at_ms: int, request: str, *, unit: int = 1) -> Transaction:
    return no_answer(_ENDS, _adu(request, unit, at_ms * MS, Direction.REQUEST, Transport.RTU), 0)


def to_all(at_ms: int, request: str) -> Transaction:
    return broadcast(_ENDS, _adu(request, 0, at_ms * MS, Direction.REQUEST, Transport.RTU))


def unasked(at_ms: int, response: str, *, unit: int = 1) -> Transaction:
    return unsolicited(_ENDS, _adu(response, unit, at_ms * MS, Direction.RESPONSE, Transport.RTU))


def _adu(pdu: str, unit: int, at_ns: int, direction: Direction, transport: Transport) -> Adu:
    data = bytes.fromhex(pdu)
    match transport:
        case Transport.TCP | Transport.UDP:
            raw = mbap_adu(0, unit, data)
        case Transport.ASCII:
            raw = ascii_adu(unit, data)
        case _:
            raw = rtu_adu(unit, data)
    return Adu(
        start_ns=at_ns,
        end_ns=at_ns,
        transport=transport,
        direction=direction,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=unit,
        pdu=data,
        raw=raw,
    )
