"""Describes transactions of a TCP connection that the array decoder (columns/) decoded."""

# A plain stretch is a part of a TCP connection in which each segment with bytes is one whole ADU of
# Modbus/TCP, in order; a response follows each request, with its transaction id, unit and function,
# in at most TIMEOUT_NS; each segment acknowledges all bytes that came before it; and times do not
# go back. If no request is pending before it, such a stretch can be decoded in one way only,
# whatever was learned about the master. So the array decoder (columns/) can decode it. Afterwards
# the Decoder is told what it would have learned from the stretch: ids, latencies and positions.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction
from mbtool.modbus.adu import Adu, DirectionBy, Transport
from mbtool.modbus.adu_bytes import MBAP_BYTES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.packets.plain_bytes import PlainBytes


class PlainStretch(NamedTuple):
    """A plain stretch: transactions in a row that the array decoder (columns/) decoded."""

    requests: PlainBytes
    responses: PlainBytes
    last_requests: Sequence[bytes]
    """The ADUs of the last two requests, in order; of the only request if there is one."""
    last_response_size: int
    """The length of the last response in bytes."""
    transaction_ids: Sequence[int]
    latencies: Mapping[int, Sequence[int]]
    """By function code, the time from request to response of each transaction, in ns, in the order
    of the transactions."""


def plain_request(raw: bytes, ts_ns: int) -> Adu:
    """Make the ADU of a Modbus/TCP request from its bytes."""
    return Adu(
        start_ns=ts_ns,
        end_ns=ts_ns,
        transport=Transport.TCP,
        direction=Direction.REQUEST,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=raw[MBAP_BYTES - 1],
        pdu=raw[MBAP_BYTES:],
        raw=raw,
        transaction_id=raw[0] << 8 | raw[1],
    )
