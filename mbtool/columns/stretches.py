"""Finds in the segments of a block the plain stretches of connections, and their transactions."""

# decode/plain_stretch.py defines a plain stretch. A segment follows the one before it of its
# connection if sequence number and acknowledgement are the next ones of both directions. In a row
# of such segments, requests, responses and pure acknowledgements follow one another without a gap,
# whatever came before. Only the decoder knows if the connection is at rest where a stretch begins.
#
# A hidden packet (headers.py) may belong to any connection, so every stretch ends before it.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s, gather
from mbtool.decode.network_pairing import TIMEOUT_NS
from mbtool.framing.mbap import MAX_LENGTH, MIN_LENGTH
from mbtool.modbus.adu_bytes import MBAP_BYTES
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.packets.segment import ACK

if TYPE_CHECKING:
    from mbtool.columns.arrays import Octets
    from mbtool.columns.headers import Headers, Segments

_PSH = 0x08
_MASK = 0xFFFFFFFF
_LENGTH_END = MBAP_BYTES - 1
_MBAP = np.dtype(
    [("id", ">u2"), ("protocol", ">u2"), ("length", ">u2"), ("unit", "u1"), ("code", "u1")]
)


@dataclass(slots=True)
class PlainTransactions:
    """The transactions of all plain stretches in a block, one stretch after the other.

    Each array has one element per transaction.
    """

    request: Int64s
    """The index of the request's segment in `Stretches.order`."""
    response: Int64s
    transaction_id: Int64s
    unit: Int64s
    code: Int64s
    """The request's function code."""
    response_code: Int64s


@dataclass(slots=True)
class Stretches:
    """The plain stretches of a block."""

    order: Int64s
    """The indices of the block's segments in `Segments`, sorted by connection, then by time."""
    flows: Int64s
    """The number of the flow of each segment in `order`."""
    transactions: PlainTransactions
    bounds: Int64s
    """The index of each stretch's first transaction; last, the number of transactions."""


def find_stretches(headers: Headers, flows: Int64s, data: Octets) -> Stretches:
    """Find the plain stretches; `flows` are the flow numbers of the segments."""
    segments = headers.segments
    order = np.argsort(flows, kind="stable")
    flows = flows[order]
    breaks = np.cumsum(~_follows(segments, order, flows, headers.hidden), dtype=np.int64)
    transactions, starts = _pair(segments, order, breaks, data)
    bounds = np.concatenate([starts, [len(transactions.request)]])
    return Stretches(order, flows, transactions, bounds.astype(np.int64))


def _follows(segments: Segments, order: Int64s, flows: Int64s, hidden: Int64s) -> Bools:
    """True for each segment that continues the one before it in `order`."""
    flags = segments.flags[order]
    is_usual = segments.is_plain[order] & ((flags == ACK) | (flags == ACK | _PSH)) & (flows >= 0)
    sequence, acknowledged = segments.sequence[order], segments.acknowledged[order]
    lower = segments.from_lower[order]
    ts_ns = segments.ts_ns[order]
    behind = sequence + segments.size[order] & _MASK
    is_same_sender = lower[1:] == lower[:-1]
    next_own = np.where(is_same_sender, behind[:-1], acknowledged[:-1])
    next_other = np.where(is_same_sender, acknowledged[:-1], behind[:-1])
    follows = np.zeros(len(order), np.bool_)
    follows[1:] = (
        (flows[1:] == flows[:-1])
        & (is_usual[1:] & is_usual[:-1])
        & (sequence[1:] == next_own)
        & (acknowledged[1:] == next_other)
        & (ts_ns[1:] >= ts_ns[:-1])
    )
    if len(hidden):
        before = np.searchsorted(hidden, segments.index[order])
        follows[1:] &= before[1:] == before[:-1]
    return follows


def _pair(
    segments: Segments, order: Int64s, breaks: Int64s, data: Octets
) -> tuple[PlainTransactions, Int64s]:
    """Join requests and responses; return transactions, and the indices that begin a stretch."""
    places = np.flatnonzero(segments.size[order] > 0)
    chosen = order[places]
    size, from_master = segments.size[chosen], segments.from_master[chosen]
    ts_ns = segments.ts_ns[chosen]
    mbap = gather(data, segments.begin[chosen], _MBAP)
    length = mbap["length"].astype(np.int64)
    is_adu = (
        (mbap["protocol"] == 0)
        & (length == size - _LENGTH_END)
        & (length >= MIN_LENGTH)
        & (length <= MAX_LENGTH)
    )
    code, broken = mbap["code"], breaks[places]
    is_pair = np.zeros(len(places), np.bool_)
    is_pair[:-1] = (
        (from_master[:-1] & ~from_master[1:])
        & (is_adu[:-1] & is_adu[1:])
        & (broken[:-1] == broken[1:])
        & (mbap["id"][:-1] == mbap["id"][1:])
        & (mbap["unit"][:-1] == mbap["unit"][1:])
        & ((code[:-1] == code[1:]) | (code[:-1] | EXCEPTION_BIT == code[1:]))
        & (ts_ns[1:] - ts_ns[:-1] <= TIMEOUT_NS)
    )
    first = np.flatnonzero(is_pair)
    goes_on = np.zeros(len(first), np.bool_)
    goes_on[1:] = (first[1:] == first[:-1] + 2) & (broken[first[1:]] == broken[first[:-1]])
    found = PlainTransactions(
        request=places[first],
        response=places[first + 1],
        transaction_id=mbap["id"][first].astype(np.int64),
        unit=mbap["unit"][first].astype(np.int64),
        code=code[first].astype(np.int64),
        response_code=code[first + 1].astype(np.int64),
    )
    return found, np.flatnonzero(~goes_on)
