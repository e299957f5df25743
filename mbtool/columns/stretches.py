"""Finds the plain stretches of a block of packets: consecutive requests and responses of one
connection, with no segment missing or out of order. Works on the arrays of `Segments`.
"""

# A plain stretch is a series of request and response pairs of one connection, one Modbus/TCP ADU in
# each segment, in order and without a gap (decode/plain_stretch.py has the exact rule). A segment
# continues the previous one of its connection if its sequence number and its acknowledgement number
# are exactly the next ones of both directions. This module looks at the segments only. Only the
# Decoder knows whether a request or bytes were still pending on the connection when a stretch
# begins, so the Decoder is asked before a stretch is used.
#
# A hidden packet is one whose headers this package cannot read as arrays, such as an IP fragment or
# a tunnel (headers.py). It may belong to any connection, so every stretch ends before it.
#
# Two irregularities are allowed within a stretch. The first is a copy: a segment with the bytes and
# numbers of an earlier one, right after it or after the response to it. It changes
# nothing and is skipped. The second is a request in two segments, at most PARTS_NS apart: its bytes
# are joined and appended to the block's data, and its time is that of the second segment.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mbtool.columns.arrays import Bools, Int64s, Octets, gather, narrow, pieces
from mbtool.columns.packet_block import SPARE
from mbtool.decode.network_pairing import TIMEOUT_NS
from mbtool.framing.mbap import MAX_LENGTH, MIN_LENGTH, PARTS_NS
from mbtool.modbus.adu import MBAP_BYTES
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.packets.connection import RETRANSMISSION_NS
from mbtool.packets.segment import ACK

if TYPE_CHECKING:
    from mbtool.columns.headers import Headers, Segments

_PSH = 0x08
_MASK = 0xFFFFFFFF
_LENGTH_END = MBAP_BYTES - 1
"""The number of bytes of an MBAP header up to its length field, which does not count them."""
_MBAP = np.dtype(
    [("id", ">u2"), ("protocol", ">u2"), ("length", ">u2"), ("unit", "u1"), ("code", "u1")]
)


@dataclass(slots=True)
class PlainTransactions:
    """The transactions of all plain stretches in a block of packets, one stretch after the other.
    Each array has one element per transaction.
    """

    request_first: Int64s
    """The index in `Stretches.order` of the first segment with bytes of the request."""
    request: Int64s
    """The index in `Stretches.order` of the segment that completed the request; differs from
    `request_first` only for a request in two segments."""
    response: Int64s
    request_begin: Int64s
    """The offset in `Stretches.data` at which the request's ADU begins, in bytes."""
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
    """The plain stretches of a block of packets, with their transactions and segments."""

    order: Int64s
    """The index in `Segments` of each segment of the block. The indices are sorted by connection,
    then by time."""
    flows: Int64s
    """For each segment in `order`, the number of its flow (pair of IP addresses and TCP ports)."""
    transactions: PlainTransactions
    bounds: Int64s
    """For each plain stretch, the index of its first transaction in the arrays of `transactions`;
    then, as last element, the number of all transactions."""
    data: Octets
    """The bytes of all packets of the block, followed by copies of the requests that were joined
    from two segments."""
    sent_again: Int64s
    """The places in `order` of the segments that are copies and add no bytes."""


@dataclass(slots=True)
class _Payloads:
    """TCP payloads: each from one segment, or joined from the two segments of one request.

    Each array has one element per payload. `first` and `last` are the places of its first and last
    segment in `Stretches.order`. The payload has `size` bytes from the offset `begin` on in the
    data.
    """

    first: Int64s
    last: Int64s
    begin: Int64s
    size: Int64s
    ts_ns: Int64s
    from_master: Bools
    run: Int64s
    """Payloads with the same number come from one series of segments, each of which continues the
    segment before it, without a gap."""


def find_stretches(headers: Headers, flows: Int64s, data: Octets) -> Stretches:
    """Find the plain stretches of a block of packets.

    `flows` has the flow number of each segment in `headers.segments`, and `data` the bytes of the
    block.
    """
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
    payloads, data = _join_split_requests(payloads, data)
    transactions, starts = _pair(payloads, data)
    bounds = np.concatenate([starts, [len(transactions.request)]])
    sent_again = np.flatnonzero(repeats)
    return Stretches(order, flows, transactions, bounds.astype(np.int64), data, sent_again)


def _follows(segments: Segments, order: Int64s, flows: Int64s, hidden: Int64s) -> Bools:
    """Return for each segment in `order` True if it continues the previous segment of its
    connection.

    It does if its sequence and acknowledgement numbers are the next ones, its time is not earlier,
    and no packet whose headers could not be read (its index is in `hidden`) lies between the two.
    `order` has indices in `Segments`; `flows` has the flow number of each segment in `order`.
    """
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


def _join_split_requests(payloads: _Payloads, data: Octets) -> tuple[_Payloads, Octets]:
    """Join the two payloads of each request that came in two segments.

    Returns the payloads, with each joined pair as one payload, and the data with the bytes of the
    joined pairs appended.
    """
    is_adu, _ = _whole_adus(payloads.begin, payloads.size, data)
    size = payloads.size
    may_be = payloads.from_master & ~is_adu & (size < MAX_LENGTH + _LENGTH_END)
    first = np.flatnonzero(
        may_be[:-1]
        & may_be[1:]
        & (payloads.run[:-1] == payloads.run[1:])
        & (size[:-1] + size[1:] <= MAX_LENGTH + _LENGTH_END)
        & (payloads.ts_ns[1:] - payloads.ts_ns[:-1] <= PARTS_NS)
    )
    if not len(first):
        return payloads, data
    halves = np.stack([first, first + 1], axis=1).ravel()
    sizes = size[first] + size[first + 1]
    begins = len(data) - SPARE + np.cumsum(sizes) - sizes
    more = pieces(data, payloads.begin[halves], size[halves])
    data = np.concatenate([data[:-SPARE], more, np.zeros(SPARE, np.uint8)])
    is_adu, _ = _whole_adus(begins, sizes, data)
    # Three payloads in a row may give two pairs that share the middle one. Then only the earlier
    # pair is joined; the Decoder reads the later request packet by packet.
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
    """Return two arrays with an element per payload: True if the payload is one whole Modbus/TCP
    ADU; its first 8 bytes as MBAP header and function code, even if they are something else.

    Payload i has `size[i]` bytes from the offset `begin[i]` on in `data`.
    """
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
    """Pair each request with the response in the next payload. `data` has the bytes of the
    payloads.

    Returns the transactions, and the index of the first transaction of each plain stretch.
    """
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


# The code below finds TCP segments that repeat an earlier segment at once, so that decoding can
# skip them.
#
# Such a copy, as a mirror port makes, has the sequence number, acknowledgement number and bytes of
# an earlier segment, less than RETRANSMISSION_NS before it. Between the two, no other segment of
# the connection has bytes, except one response if the repeated segment is a request. So both
# segments are in the same plain stretch, and the second one adds nothing.
#
# A copy that comes later than that was sent again by its sender, which the Decoder reports.
#
# A segment of one byte may be a keep-alive probe. The Decoder counts those, so they are not treated
# as copies here.

_LONGEST = 512
"""TCP payloads of more bytes are not compared. Segments with such payloads go to the Decoder."""


def is_sent_again(segments: Segments, order: Int64s, flows: Int64s, data: Octets) -> Bools:
    """Return for each segment in `order` True if it repeats the connection's previous segment with
    bytes, or the request that this previous segment answers.

    `order` has indices in `Segments`, sorted by connection, then by time. `flows` has the flow
    number of each segment in `order`, and `data` the bytes of the block.
    """
    found = np.zeros(len(order), np.bool_)
    places = np.flatnonzero(segments.size[order] > 1)
    chosen, flows = order[places], flows[places]
    for distance in (1, 2):
        first, second = chosen[:-distance], chosen[distance:]
        is_copy = (
            (flows[:-distance] == flows[distance:])
            & (segments.from_master[first] == segments.from_master[second])
            & (segments.sequence[first] == segments.sequence[second])
            & (segments.size[first] == segments.size[second])
            & (segments.acknowledged[first] == segments.acknowledged[second])
            & (segments.flags[first] == segments.flags[second])
            & (segments.size[second] <= _LONGEST)
            & (segments.ts_ns[second] - segments.ts_ns[first] < RETRANSMISSION_NS)
        )
        if distance == 2:
            middle = chosen[1:-1]
            is_copy &= segments.from_master[second] & ~segments.from_master[middle]
        both = np.flatnonzero(is_copy)
        is_equal = _are_equal(segments, first[both], second[both], data)
        found[places[both[is_equal] + distance]] = True
    return found


def _are_equal(segments: Segments, first: Int64s, second: Int64s, data: Octets) -> Bools:
    """Return for each i True if the payloads of the segments `first[i]` and `second[i]`, which have
    equal sizes, have the same bytes.
    """
    if not len(first):
        return np.zeros(0, np.bool_)
    sizes = segments.size[first]
    differs = pieces(data, segments.begin[first], sizes) != pieces(
        data, segments.begin[second], sizes
    )
    counts: Int64s = np.add.reduceat(differs.astype(np.int64), np.cumsum(sizes) - sizes)
    is_equal: Bools = counts == 0
    return is_equal
