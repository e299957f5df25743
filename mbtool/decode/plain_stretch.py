"""Transactions of a TCP connection that were decoded elsewhere, as the decoder takes them."""

# In a plain stretch each segment with bytes is one whole ADU of Modbus/TCP, in order; a response
# follows each request, with its transaction id, unit and function, in at most TIMEOUT_NS; each
# segment acknowledges all bytes that came before it; and times do not go back. A connection at rest
# decodes such a stretch in one way only, whatever it knows of its master. So the transactions can
# be read from arrays (columns/), and the decoder only has to know afterwards what it would know.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.packets.plain_bytes import PlainBytes


class PlainStretch(NamedTuple):
    """One or more transactions in a row, from the first request to the last response."""

    requests: PlainBytes
    responses: PlainBytes
    last_response_size: int
    """The length of the last response in bytes."""
    transaction_ids: Sequence[int]
    latencies: Mapping[int, Sequence[int]]
    """By function code, the time from request to response of each transaction, in ns."""
