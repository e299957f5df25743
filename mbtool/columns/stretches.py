"""Finds in the segments of a block the plain stretches of connections, and their transactions."""

# decode/plain_stretch.py defines a plain stretch. A segment follows the one before it of its
# connection if sequence number and acknowledgement are the next ones of both directions. In a row
# of such segments, requests, responses and pure acknowledgements follow one another without a gap,
# whatever came before. Only the decoder knows if the connection is at rest where a stretch begins.
#
# A hidden packet (headers.py) may belong to any connection, so every stretch ends before it.
#
# Two kinds of disorder may be within a stretch. A segment that is sent again right after its first
# copy, or after the response to it, with equal bytes and numbers, changes nothing (sent_again.py).
# A request may come in two segments; its bytes are then put together behind the block's data, and
# its time is that of the second one.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mbtool.columns.arrays import Bools, Int64s, Octets, gather, narrow, pieces
from mbtool.columns.packet_block import SPARE
from mbtool.columns.sent_again import is_sent_again
from mbtool.decode.network_pairing import TIMEOUT_NS
from mbtool.framing.mbap import MAX_LENGTH, MAX_REQUEST_NS, MIN_LENGTH
from mbtool.modbus.adu_bytes import MBAP_BYTES
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.packets.segment import ACK

if TYPE_CHECKING:
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

    request_first: Int64s
    """The index in `Stretches.order` of the first segment with bytes of the request."""
    request: Int64s
    """The index of the segment that completed the request; mostly the same one."""
    response: Int64s
    request_begin: Int64s
    """The offset of the request's ADU in `Stretches.data`."""
    request_size: Int64s
    response_begin: Int64s
    response_size: Int64s
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
    data: Octets
    """The data of the block, and behind it the requests that were put together."""
    sent_again: Int64s
    """The indices in `order` of the segments that only repeat one before them."""


@dataclass(slots=True)
class _Payloads:
    """Bytes of one segment, or of two that hold one request. Each array has one element for each.

    `first` and `last` are the indices of the first and the last segment in `Stretches.order`.
    """

    first: Int64s
    last: Int64s
    begin: Int64s
    size: Int64s
    ts_ns: Int64s
    from_master: Bools
    run: Int64s
    """Equal for payloads between which each segment follows the one before it."""


def find_stretches(headers: Headers, flows: Int64s, data: Octets) -> Stretches:
    """Find the plain stretches; `flows` are the flow numbers of the segments."""
    segments = headers.segments
    order = np.argsort(narrow(flows), kind="stable")
    flows = flows[order]
    repeats = is_sent_again(segments, order, flows, data)
    kept = np.flatnonzero(~repeats)
    chosen = order[kept]
    runs = np.cumsum(~_follows(segments, chosen, flows[kept], headers.hidden), dtype=np.int64)
    places = np.flatnonzero(segments.size[chosen] > 0)
    chosen = chosen[places]
    payloads = _Payloads(
        first=kept[places],
        last=kept[places],
        begin=segments.begin[chosen],
        size=segments.size[chosen],
        ts_ns=segments.ts_ns[chosen],
        from_master=segments.from_master[chosen],
        run=runs[places],
    )
    payloads, data = _joined(payloads, data)
    transactions, starts = _pair(payloads, data)
    bounds = np.concatenate([starts, [len(transactions.request)]])
    sent_again = np.flatnonzero(repeats)
    return Stretches(order, flows, transactions, bounds.astype(np.int64), data, sent_again)


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


def _joined(payloads: _Payloads, data: Octets) -> tuple[_Payloads, Octets]:
    """Put requests together that came in two segments; return the data with their bytes."""
    is_adu, _ = _whole_adus(payloads.begin, payloads.size, data)
    size = payloads.size
    may_be = payloads.from_master & ~is_adu & (size < MAX_LENGTH + _LENGTH_END)
    first = np.flatnonzero(
        may_be[:-1]
        & may_be[1:]
        & (payloads.run[:-1] == payloads.run[1:])
        & (size[:-1] + size[1:] <= MAX_LENGTH + _LENGTH_END)
        & (payloads.ts_ns[1:] - payloads.ts_ns[:-1] <= MAX_REQUEST_NS)
    )
    if not len(first):
        return payloads, data
    halves = np.stack([first, first + 1], axis=1).ravel()
    sizes = size[first] + size[first + 1]
    begins = len(data) - SPARE + np.cumsum(sizes) - sizes
    more = pieces(data, payloads.begin[halves], size[halves])
    data = np.concatenate([data[:-SPARE], more, np.zeros(SPARE, np.uint8)])
    is_adu, _ = _whole_adus(begins, sizes, data)
    # Of two requests that would share a segment, the later one is left to the decoder.
    is_adu[1:] &= ~(is_adu[:-1] & (first[1:] == first[:-1] + 1))
    first, sizes, begins = first[is_adu], sizes[is_adu], begins[is_adu]
    last, begin, size = payloads.last.copy(), payloads.begin.copy(), size.copy()
    ts_ns = payloads.ts_ns.copy()
    last[first], ts_ns[first] = payloads.last[first + 1], payloads.ts_ns[first + 1]
    begin[first], size[first] = begins, sizes
    stays = np.ones(len(last), np.bool_)
    stays[first + 1] = False
    joined = _Payloads(
        first=payloads.first[stays],
        last=last[stays],
        begin=begin[stays],
        size=size[stays],
        ts_ns=ts_ns[stays],
        from_master=payloads.from_master[stays],
        run=payloads.run[stays],
    )
    return joined, data


def _whole_adus(begin: Int64s, size: Int64s, data: Octets) -> tuple[Bools, npt.NDArray[np.void]]:
    """True for each payload that is one whole ADU; and the headers of all."""
    mbap = gather(data, begin, _MBAP)
    length = mbap["length"].astype(np.int64)
    is_adu = (
        (mbap["protocol"] == 0)
        & (length == size - _LENGTH_END)
        & (length >= MIN_LENGTH)
        & (length <= MAX_LENGTH)
    )
    return is_adu, mbap


def _pair(payloads: _Payloads, data: Octets) -> tuple[PlainTransactions, Int64s]:
    """Join requests and responses; return transactions, and the indices that begin a stretch."""
    from_master, run, ts_ns = payloads.from_master, payloads.run, payloads.ts_ns
    is_adu, mbap = _whole_adus(payloads.begin, payloads.size, data)
    code = mbap["code"]
    is_pair = np.zeros(len(run), np.bool_)
    is_pair[:-1] = (
        (from_master[:-1] & ~from_master[1:])
        & (is_adu[:-1] & is_adu[1:])
        & (run[:-1] == run[1:])
        & (mbap["id"][:-1] == mbap["id"][1:])
        & (mbap["unit"][:-1] == mbap["unit"][1:])
        & ((code[:-1] == code[1:]) | (code[:-1] | EXCEPTION_BIT == code[1:]))
        & (ts_ns[1:] - ts_ns[:-1] <= TIMEOUT_NS)
    )
    first = np.flatnonzero(is_pair)
    goes_on = np.zeros(len(first), np.bool_)
    goes_on[1:] = (first[1:] == first[:-1] + 2) & (run[first[1:]] == run[first[:-1]])
    found = PlainTransactions(
        request_first=payloads.first[first],
        request=payloads.last[first],
        response=payloads.last[first + 1],
        request_begin=payloads.begin[first],
        request_size=payloads.size[first],
        response_begin=payloads.begin[first + 1],
        response_size=payloads.size[first + 1],
        transaction_id=mbap["id"][first].astype(np.int64),
        unit=mbap["unit"][first].astype(np.int64),
        code=code[first].astype(np.int64),
        response_code=code[first + 1].astype(np.int64),
    )
    return found, np.flatnonzero(~goes_on)
