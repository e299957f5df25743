"""Transactions of a TCP connection that were decoded elsewhere, as the decoder takes them."""

# In a plain stretch each segment with bytes is one whole ADU of Modbus/TCP, in order; a response
# follows each request, with its transaction id, unit and function, in at most TIMEOUT_NS; each
# segment acknowledges all bytes that came before it; and times do not go back. A connection at rest
# decodes such a stretch in one way only, whatever it knows of its master. So the transactions can
# be read from arrays (columns/), and afterwards the decoder is told what it would have learned from
# them.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction
from mbtool.modbus.adu import Adu, DirectionBy, Transport
from mbtool.modbus.adu_bytes import MBAP_BYTES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.packets.plain_bytes import PlainBytes


class PlainStretch(NamedTuple):
    """One or more transactions in a row, from the first request to the last response."""

    requests: PlainBytes
    responses: PlainBytes
    last_requests: Sequence[bytes]
    """The ADUs of the last request and of the one before it, if there is one; the last one last."""
    last_response_size: int
    """The length of the last response in bytes."""
    transaction_ids: Sequence[int]
    latencies: Mapping[int, Sequence[int]]
    """By function code, the time from request to response of each transaction, in ns."""


def plain_request(raw: bytes, ts_ns: int) -> Adu:
    """The ADU of a request in a plain stretch, from its bytes."""
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
