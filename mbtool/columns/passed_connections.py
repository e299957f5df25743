"""Tells the Decoder of the connections whose packets, from SYN to FIN, were read from arrays and
not fed to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from ipaddress import ip_address
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s
from mbtool.columns.whole_connections import WholeConnections, find_whole
from mbtool.core import Connection, Direction, Endpoint
from mbtool.decode.decoder import closing_event, opening_event
from mbtool.packets.ended_connection import EndedConnection
from mbtool.packets.reassembler import IDLE_NS, MAX_CONNECTIONS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.columns.flows import FlowNumbers
    from mbtool.columns.headers import Headers, Segments
    from mbtool.columns.stretches import Stretches
    from mbtool.core import WireEvent
    from mbtool.decode.decoder import Decoder, Record
    from mbtool.packets.reassembler import FlowEnds


@dataclass(slots=True)
class PassedConnections:
    """Connections that were read from arrays, from SYN to FIN, without the Decoder.

    Each array and list has one element per connection.
    """

    connections: list[Connection]
    flow: Int64s
    """The number of the connection's flow: its pair of IP addresses and TCP ports."""
    stretch: Int64s
    """The index, among the block's plain stretches, of the one that has all its transactions."""
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
        the results of the block (`order_of`).
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
    ended = _ended(segments, whole, connections, is_lower)
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


def _ended(
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
