"""Describes transactions of a TCP connection that the array decoder (columns/) decoded."""

# A plain stretch is a part of a TCP connection in which each segment with bytes is one whole ADU of
# Modbus/TCP, in order; a response follows each request, with its transaction id, unit and function,
# in at most TIMEOUT_NS; each segment acknowledges all bytes that came before it; and times do not
# go back. If no request is pending before it, such a stretch can be decoded in one way only,
# whatever was learned about the master. So the array decoder (columns/) can decode it. Afterwards
# the Decoder is told what it would have learned from the stretch: ids, latencies and positions.
#
# A request that got no response may still get a late one, or a retry, after its master has sent
# further requests. PlainLimits tells which transactions of a stretch such requests could matter to:
# the array decoder leaves these transactions to the Decoder.

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mbtool.packets.plain_bytes import PlainBytes


class PlainStretch(NamedTuple):
    """A plain stretch: transactions in a row that the array decoder (columns/) decoded."""

    requests: PlainBytes
    responses: PlainBytes
    last_response_size: int
    """The length of the last response in bytes."""
    transaction_ids: Sequence[int]
    latencies: Mapping[int, Sequence[int]]
    """By function code, the time from request to response of each transaction, in ns, in the order
    of the transactions."""


class PlainLimits(NamedTuple):
    """Tells which transactions the array decoder must leave to the Decoder, because earlier
    requests without a response could matter to them.
    """

    requests: frozenset[bytes]
    """Unit and PDU of the unanswered requests. A request with the same unit and PDU is a retry."""
    responses: frozenset[tuple[int | None, int, int]]
    """Transaction id, unit and function code of the late responses that may still come to the
    unanswered requests."""
    until_ns: int
    """The time (UTC ns) at which the Decoder gives up the first of the unanswered requests. The
    array decoder may take only transactions whose response comes before it."""


NO_LIMITS = PlainLimits(frozenset(), frozenset(), 2**63 - 1)
