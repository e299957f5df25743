"""Tells the Decoder of connections that were read from arrays, from their SYN to their FINs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from ipaddress import ip_address
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Int64s
from mbtool.columns.whole_connections import WholeConnections, find_whole
from mbtool.core import Connection, Endpoint
from mbtool.decode.decoder import closing_event, opening_event
from mbtool.packets.ended_connection import EndedConnection
from mbtool.packets.reassembler import IDLE_NS, MAX_CONNECTIONS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.columns.flows import FlowNumbers
    from mbtool.columns.headers import Headers, Segments
    from mbtool.columns.stretches import Stretches
    from mbtool.decode.decoder import Decoder, Record
    from mbtool.packets.reassembler import FlowEnds


@dataclass(slots=True)
class PassedConnections:
    """Connections that the Decoder was not fed. Each array and list has an element for each."""

    connections: list[Connection]
    flow: Int64s
    """The number of the connection's flow."""
    stretch: Int64s
    """The index of its stretch in `Stretches`."""
    opened: Int64s
    """The index of the packet that opened it."""
    opened_ns: Int64s
    closed: Int64s
    """The index of the packet that closed it."""
    closed_ns: Int64s

    def events(self) -> list[tuple[int, Record]]:
        """Their begins and ends, each with its sort number as in `DecodedBlock.records`."""
        found: list[tuple[int, Record]] = []
        for event, packets, times in (
            (opening_event, self.opened, self.opened_ns),
            (closing_event, self.closed, self.closed_ns),
        ):
            for packet, ts_ns, connection in zip(
                packets.tolist(), times.tolist(), self.connections, strict=True
            ):
                found.append((2 * packet + 1, event(ts_ns, connection)))
        return found


def pass_whole(
    decoder: Decoder, flows: FlowNumbers, headers: Headers, stretches: Stretches
) -> PassedConnections | None:
    """Find the connections that are whole and plain, and tell the Decoder of them."""
    segments = headers.segments
    times = segments.ts_ns
    # A hidden packet may belong to any connection.
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
    first = decoder.reassembler.number_next(len(whole))
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
    )


def _ended(
    segments: Segments,
    whole: WholeConnections,
    connections: list[Connection],
    is_lower: list[bool],
) -> Iterator[EndedConnection]:
    """The connections as the reassembler knows them; `is_lower` is True of a lower master."""
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
    """The connection between two ends; `is_lower` is True if the lower one is the master."""
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
