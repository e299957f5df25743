"""Finds connections that lie in one block from SYN to FIN, such as those of a single poll each."""

# Such a connection has, in order and without a gap: SYN, SYN with ACK, an ACK, transactions that
# form one plain stretch (stretches.py), a FIN of each end, and acknowledgements. Its first request
# has the exact length of its function's requests, so the Decoder would recognise Modbus/TCP at the
# first request. Nothing that the Decoder knows from before can then change the connection's events
# and transactions, provided that no other connection between the same ends is open.
#
# All segments between the same two ends in the block must belong to such connections, and none may
# be a retransmission.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s
from mbtool.modbus.adu import MBAP_BYTES
from mbtool.modbus.functions import WRITE_SEVERAL
from mbtool.packets.segment import ACK, FIN, SYN

if TYPE_CHECKING:
    from mbtool.columns.headers import Segments
    from mbtool.columns.stretches import Stretches

_PSH = 0x08
_MASK = 0xFFFFFFFF
_FIXED_CODES = (1, 2, 3, 4, 5, 6)
"""Functions whose requests have a function code, an address, and a quantity or value."""
_FIXED = MBAP_BYTES + 5
_COUNTED = MBAP_BYTES + 6
"""The number of bytes before the values in a request ADU that writes several values, from the MBAP
header to the byte count."""
_COUNTED_CODES = tuple(WRITE_SEVERAL)


@dataclass(slots=True)
class WholeConnections:
    """Connections that lie in one block from SYN to FIN, in the order of their SYNs.

    Each array has one element per connection.
    """

    flow: Int64s
    """The number of the connection's flow (its pair of IP addresses and TCP ports)."""
    stretch: Int64s
    """The index, among those of the block, of the connection's only plain stretch. This stretch has
    all transactions of the connection."""
    opening: Int64s
    """The index in `Segments` of the connection's SYN."""
    answering: Int64s
    """The index in `Segments` of the connection's SYN with ACK."""
    closing: Int64s
    """The index in `Segments` of the connection's second FIN."""
    last: Int64s
    request_bytes: Int64s
    """The sum of the lengths of the connection's requests, in bytes."""
    response_bytes: Int64s

    def __len__(self) -> int:
        return len(self.flow)

    def only(self, wanted: Bools | Int64s) -> WholeConnections:
        """Return some of the connections. `wanted` has a bool for each connection, or the indices
        of those to return.
        """
        return WholeConnections(
            *(getattr(self, name)[wanted] for name in WholeConnections.__slots__)
        )


def find_whole(segments: Segments, stretches: Stretches) -> WholeConnections:
    """Find the connections that lie in the block from SYN to FIN and have nothing unusual.

    `stretches` are the plain stretches of the same block as `segments`.
    """
    if len(stretches.bounds) == 1 or not (segments.flags & SYN).any():
        return WholeConnections(*(np.zeros(0, np.int64) for _ in WholeConnections.__slots__))
    order, flows, found = stretches.order, stretches.flows, stretches.transactions
    flags, size = segments.flags[order], segments.size[order]
    is_flow_begin = np.ones(len(order), np.bool_)
    is_flow_begin[1:] = flows[1:] != flows[:-1]
    is_begin = is_flow_begin | (flags == SYN)
    begins = np.flatnonzero(is_begin)
    group = np.cumsum(is_begin) - 1
    is_fin, from_master = flags & FIN > 0, segments.from_master[order]
    fins = np.cumsum(is_fin)
    fins = fins - (fins - is_fin)[begins][group]
    good = _is_in_order(segments, order, group, begins) & ((size == 0) | (fins == 0))
    good[stretches.sent_again] = False
    is_whole = np.logical_and.reduceat(good, begins)
    is_whole &= _count(is_fin & from_master, begins) == 1
    is_whole &= _count(is_fin & ~from_master, begins) == 1
    stretch, has_one = _only_stretch(stretches, group, len(begins))
    first = stretches.bounds[stretch]
    last = stretches.bounds[stretch + 1] - 1
    transactions = last + 1 - first
    halved = np.concatenate([[0], np.cumsum(found.request_first != found.request)])
    payloads = 2 * transactions + halved[last + 1] - halved[first]
    is_whole &= has_one & (_count(size > 0, begins) == payloads)
    is_whole &= _has_known_length(stretches)[first]
    is_flow = np.logical_and.reduceat(is_whole, group[is_flow_begin])
    is_whole = is_flow[np.cumsum(is_flow_begin)[begins] - 1]
    second_fin = np.zeros(len(begins), np.int64)
    second_fin[group[is_fin]] = np.flatnonzero(is_fin)
    ends = np.append(begins[1:], len(order))
    connections = WholeConnections(
        flow=flows[begins],
        stretch=stretch,
        opening=order[begins],
        answering=order[np.minimum(begins + 1, len(order) - 1)],
        closing=order[second_fin],
        last=order[ends - 1],
        request_bytes=_sum(size * from_master, begins),
        response_bytes=_sum(size * ~from_master, begins),
    ).only(is_whole)
    return connections.only(np.argsort(connections.opening))


def _is_in_order(segments: Segments, order: Int64s, group: Int64s, begins: Int64s) -> Bools:
    """Return for each segment in `order` True if it is in order and has the flags that are expected
    at its position in a connection from SYN to FIN.

    `order` has indices in `Segments`. `group` has the number of each segment's connection, and
    `begins` the place in `order` of each connection's first segment.
    """
    flags, size = segments.flags[order], segments.size[order]
    sequence, acknowledged = segments.sequence[order], segments.acknowledged[order]
    from_master = segments.from_master[order]
    counted = size + (flags & SYN > 0) + (flags & FIN > 0)
    behind = sequence + counted & _MASK
    place = np.arange(len(order)) - begins[group]
    is_same = from_master[1:] == from_master[:-1]
    follows = np.zeros(len(order), np.bool_)
    follows[1:] = (sequence[1:] == np.where(is_same, behind[:-1], acknowledged[:-1])) & (
        acknowledged[1:] == np.where(is_same, acknowledged[:-1], behind[:-1])
    )
    is_answer = np.zeros(len(order), np.bool_)
    is_answer[1:] = ~is_same & (flags[1:] == SYN | ACK) & (acknowledged[1:] == behind[:-1])
    usual = flags & ~_PSH
    is_later = follows & ((usual == ACK) | (usual == ACK | FIN) & (size == 0))
    is_third = is_later & from_master & (flags == ACK) & (size == 0)
    is_good: Bools = np.select(
        [place == 0, place == 1, place == 2],
        [(flags == SYN) & from_master & (size == 0), is_answer & (size == 0), is_third],
        is_later,
    )
    return is_good & segments.is_plain[order]


def _only_stretch(stretches: Stretches, group: Int64s, count: int) -> tuple[Int64s, Bools]:
    """Return for each of the `count` connections the index of its plain stretch, and True if it has
    exactly one.

    `group` has the number of the connection of each segment in `Stretches.order`.
    """
    bounds = stretches.bounds
    where = group[stretches.transactions.request_first[bounds[:-1]]]
    stretch = np.zeros(count, np.int64)
    stretch[where] = np.arange(len(where))
    return stretch, np.bincount(where, minlength=count) == 1


def _has_known_length(stretches: Stretches) -> Bools:
    """Return for each transaction True if its request has exactly the length that its function code
    and, if it has one, its byte count demand.
    """
    found = stretches.transactions
    count = stretches.data[found.request_begin + _COUNTED - 1]
    is_fixed = np.isin(found.code, _FIXED_CODES) & (found.request_size == _FIXED)
    is_counted = np.isin(found.code, _COUNTED_CODES) & (found.request_size == _COUNTED + count)
    has_length: Bools = is_fixed | is_counted
    return has_length


def _count(values: Bools, begins: Int64s) -> Int64s:
    return _sum(values.astype(np.int64), begins)


def _sum(values: Int64s, begins: Int64s) -> Int64s:
    sums: Int64s = np.add.reduceat(values, begins)
    return sums
