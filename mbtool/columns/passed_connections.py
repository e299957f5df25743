"""Tells the Decoder of the connections whose packets, from SYN to FIN, were read from arrays and
not fed to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from ipaddress import ip_address
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s
from mbtool.core import Connection, Direction, Endpoint, WireEvent
from mbtool.decode.decoder import Decoder, Record, closing_event, opening_event
from mbtool.modbus.adu import MBAP_BYTES
from mbtool.modbus.functions import WRITE_SEVERAL
from mbtool.packets.ended_connection import EndedConnection
from mbtool.packets.reassembler import IDLE_NS, MAX_CONNECTIONS, FlowEnds
from mbtool.packets.segment import ACK, FIN, SYN

if TYPE_CHECKING:
    from mbtool.columns.flows import FlowNumbers
    from mbtool.columns.headers import Headers, Segments
    from mbtool.columns.stretches import Stretches


@dataclass(slots=True)
class PassedConnections:
    """Connections that were read from arrays, from SYN to FIN, without the Decoder.

    Each array and list has one element per connection.
    """

    connections: list[Connection]
    flow: Int64s
    """The number of the connection's flow: its pair of IP addresses and TCP ports."""
    stretch: Int64s
    """The index of the connection's only plain stretch among those of the block; it has all
    transactions of the connection."""
    opened: Int64s
    """The index in the block of the packet with the connection's SYN."""
    opened_ns: Int64s
    closed: Int64s
    """The index in the block of the packet with the connection's second FIN."""
    closed_ns: Int64s
    is_ended_by_slave: Bools
    """True if the first FIN is the slave's."""

    def events(self) -> list[tuple[int, Record]]:
        """Return the opening and the closing event of each connection, each with its sort key among
        the results of the block (`result_sort_keys`).
        """
        packets = enumerate(self.opened.tolist())
        found: list[tuple[int, Record]] = [(2 * at + 1, self.opening(one)) for one, at in packets]
        packets = enumerate(self.closed.tolist())
        return found + [(2 * at + 1, self.closing(one)) for one, at in packets]

    def opening(self, number: int) -> WireEvent:
        """Return the event of the opening of the connection with this index."""
        return opening_event(int(self.opened_ns[number]), self.connections[number])

    def closing(self, number: int) -> WireEvent:
        by = Direction.RESPONSE if self.is_ended_by_slave[number] else Direction.REQUEST
        return closing_event(int(self.closed_ns[number]), self.connections[number], by)


def take_whole_connections(
    decoder: Decoder, flows: FlowNumbers, headers: Headers, stretches: Stretches
) -> PassedConnections | None:
    """Find the connections that lie in the block from SYN to FIN, and tell the Decoder's
    reassembler that they have ended.

    Returns None if there are none. Returns None, too, if the block has hidden packets, which may
    belong to such a connection, or if it lasts as long as IDLE_NS (two hours), after which the
    reassembler drops a connection without segments.
    """
    segments = headers.segments
    times = segments.ts_ns
    # The headers of a hidden packet could not be read, so it may belong to any connection.
    if len(headers.hidden) or not len(times) or times[-1] - times[0] >= IDLE_NS:
        return None
    whole = find_whole(segments, stretches)
    ends = [flows.ends[flow] for flow in whole.flow.tolist()]
    is_new = np.array([decoder.opens_modbus_tcp(one) for one in ends], np.bool_)
    if not is_new.any():
        return None
    whole = whole.only(is_new)
    ends = [flows.ends[flow] for flow in whole.flow.tolist()]
    is_lower = segments.from_lower[whole.opening].tolist()
    first = decoder.reassembler.reserve_numbers(len(whole))
    connections = [
        _connection(each, is_lower=lower, number=number)
        for number, (each, lower) in enumerate(zip(ends, is_lower, strict=True), first)
    ]
    ended = _ended_connections(segments, whole, connections, is_lower)
    decoder.reassembler.take_ended(zip(ends, ended, strict=True))
    return PassedConnections(
        connections=connections,
        flow=whole.flow,
        stretch=whole.stretch,
        opened=segments.index[whole.opening],
        opened_ns=segments.ts_ns[whole.opening],
        closed=segments.index[whole.closing],
        closed_ns=segments.ts_ns[whole.closing],
        is_ended_by_slave=segments.from_master[whole.closing],  # Its FIN is the second one.
    )


def _ended_connections(
    segments: Segments,
    whole: WholeConnections,
    connections: list[Connection],
    is_lower: list[bool],
) -> Iterator[EndedConnection]:
    """Yield an EndedConnection for each connection in `whole`. The reassembler uses it to recognise
    segments that come after the end of the connection.

    `is_lower` is True for a connection whose master is the lower one of its two ends (by port, then
    address).
    """
    for connection, last_ns, asked, answered, requests, responses, lower in zip(
        connections,
        segments.ts_ns[whole.last].tolist(),
        (segments.sequence[whole.opening] + 1 & 0xFFFFFFFF).tolist(),
        (segments.sequence[whole.answering] + 1 & 0xFFFFFFFF).tolist(),
        whole.request_bytes.tolist(),
        whole.response_bytes.tolist(),
        is_lower,
        strict=True,
    ):
        begins, sizes = (asked, answered), (requests, responses)
        yield EndedConnection(connection, last_ns, begins, sizes, lower)


def _connection(ends: FlowEnds, *, is_lower: bool, number: int) -> Connection:
    """Return the connection between two ends.

    `is_lower` is True if the first one of `ends` is the master; `number` tells this connection from
    others between the same ends.
    """
    low, low_port, high, high_port = ends
    if is_lower:
        return Connection(Endpoint(_host(low), low_port), _endpoint(high, high_port), number)
    return Connection(Endpoint(_host(high), high_port), _endpoint(low, low_port), number)


@lru_cache(maxsize=MAX_CONNECTIONS)
def _host(address: bytes) -> str:
    return str(ip_address(address))


@lru_cache(maxsize=MAX_CONNECTIONS)
def _endpoint(address: bytes, port: int) -> Endpoint:
    return Endpoint(_host(address), port)


# The code below finds connections that lie in one block from SYN to FIN, such as those of a
# single poll each.
#
# Such a connection has, in order and without a gap: SYN, SYN with ACK, an ACK, transactions that
# form one plain stretch (stretches.py), a FIN of each end, and acknowledgements. Its first request
# has the exact length of its function's requests, so the Decoder would recognise Modbus/TCP at the
# first request. Nothing that the Decoder knows from before can then change the connection's events
# and transactions, provided that no other connection between the same ends is open.
#
# All segments between the same two ends in the block must belong to such connections, and none may
# be a retransmission.

_PSH = 0x08
_MASK = 0xFFFFFFFF
_FIXED_CODES = (1, 2, 3, 4, 5, 6)
"""Functions whose requests have a function code, an address, and a quantity or value."""
_FIXED = MBAP_BYTES + 5
"""The size in bytes of a request ADU with function code, address, and quantity or value."""
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
    """The index of the connection's only plain stretch among those of the block; it has all
    transactions of the connection."""
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
