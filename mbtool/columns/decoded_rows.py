"""Puts ordinary transactions that the Decoder made of a block among those read from arrays."""

# Pipelined requests, several ADUs in a segment, and polls between a request without response and
# its retry are decoded packet by packet, but most of the transactions are ordinary: answered reads
# and writes with nothing noticed about them. They become rows of the numpy arrays that hold the
# block's other transactions, so that all rows are printed, counted and checked together. Otherwise
# each of them would divide the rows before and after it into short runs, which are slow.
#
# A transaction becomes a row if an object made from the row would equal it, and if the packet of
# its response also completed it, so that the row has the same place among the results.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from mbtool.columns.packet_block import SPARE, PacketBlock
from mbtool.columns.plain_rows import PER_ROW, PlainRows, link_addresses_of, link_headers
from mbtool.core import Connection, WireEvent
from mbtool.modbus.adu import MBAP_BYTES, DirectionBy, Transport
from mbtool.modbus.functions import READ_BITS, READ_REGISTERS, WRITE_ONE, WRITE_SEVERAL
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.columns.arrays import Int64s, Octets
    from mbtool.columns.headers import Segments
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction

_FUNCTIONS = (READ_BITS | READ_REGISTERS | WRITE_ONE | WRITE_SEVERAL) - {0x16, 0x17}
_ANSWERED = frozenset((Outcome.OK, Outcome.EXCEPTION))
_PACKETS = attrgetter("request_packet", "response_packet")
FEWEST = 16
"""If a part of a block has fewer chosen transactions of the Decoder than this, they stay objects:
to make rows of arrays of them would take longer."""


def with_decoded(
    block: PacketBlock,
    segments: Segments,
    rows: PlainRows | None,
    records: Sequence[tuple[int, Record]],
    connections: Sequence[Connection | None],
    data: Octets,
) -> tuple[PlainRows | None, list[tuple[int, Record]]]:
    """Return the rows of a block, with ordinary transactions of `records` among them, and the
    records that are left.

    Each record has its sort key, and in `connections` the connection that it came from, None if
    unknown. `data` has the bytes of the block, for the case that there are no rows.
    """
    chosen = [
        place
        for place, ((key, one), connection) in enumerate(zip(records, connections, strict=True))
        if connection is not None
        and not isinstance(one, WireEvent)
        and _is_ordinary(one, key, block, connection)
    ]
    if len(chosen) < FEWEST or not len(segments.index):
        return rows, [*records]
    packets = (
        np.array([_PACKETS(records[place][1]) for place in chosen], np.int64) - block.first_number
    )
    places = np.searchsorted(segments.index, packets)
    places[places == len(segments.index)] = 0
    is_read = (segments.index[places] == packets).all(axis=1)
    chosen = [place for place, is_one in zip(chosen, is_read.tolist(), strict=True) if is_one]
    kept = _keys_without(records, chosen)
    chosen = [place for place in chosen if records[place][0] not in kept]
    if len(chosen) < FEWEST:
        return rows, [*records]
    taken = set(chosen)
    some = [one for place in chosen if not isinstance(one := records[place][1], WireEvent)]
    of = [each for place in chosen if (each := connections[place]) is not None]
    packets = np.array([_PACKETS(one) for one in some], np.int64) - block.first_number
    ip_at = segments.ip_at[np.searchsorted(segments.index, packets)]
    more = _rows(block, some, of, packets, ip_at, data if rows is None else rows.data)
    left = [each for place, each in enumerate(records) if place not in taken]
    return more if rows is None else _join_rows(rows, more), left


def _keys_without(records: Sequence[tuple[int, Record]], chosen: Sequence[int]) -> set[int]:
    """Return the keys of the records that are not chosen: the other records of these packets stay,
    too, as rows come behind records of the same packet.
    """
    taken = set(chosen)
    return {key for place, (key, _) in enumerate(records) if place not in taken}


def _is_ordinary(
    one: NamedTransaction, key: int, block: PacketBlock, connection: Connection
) -> bool:
    """True if an object made of a row of the arrays would be equal to `one`."""
    if (
        one.outcome not in _ANSWERED
        or one.verdicts
        or one.retries
        or one.function not in _FUNCTIONS
        or one.device is not None
        or one.transport is not Transport.TCP
        or one.direction_by is not DirectionBy.PORT
        or one.confidence != 1.0
        or one.pair_confidence is not None
        or one.request_parts_ns is not None
        or one.response_file is not None
    ):
        return False
    request, response, at_ns, end_ns = (
        one.request_packet, one.response_packet, one.request_ns, one.response_ns,
    )  # fmt: skip
    return (
        request is not None
        and response is not None
        and at_ns is not None
        and end_ns is not None
        and request >= block.first_number
        and key == 2 * (response - block.first_number) + 1
        and one.latency_ns == end_ns - at_ns
        and one.source == str(connection.master)
    )


def _rows(
    block: PacketBlock,
    found: Sequence[NamedTransaction],
    connections: Sequence[Connection],
    packets: Int64s,
    ip_at: Int64s,
    data: Octets,
) -> PlainRows:
    """Make rows of transactions. `packets` and `ip_at` have two columns: for the request, for the
    response. Their bytes are put behind those of `data`.
    """
    raws = [raw for one in found for raw in (one.request_raw or b"", one.response_raw or b"")]
    sizes = np.array([*map(len, raws)], np.int64)
    begins = len(data) - SPARE + np.cumsum(sizes) - sizes
    joined = np.frombuffer(b"".join(raws), np.uint8)
    data = np.concatenate([data[:-SPARE], joined, np.zeros(SPARE, np.uint8)])
    requests, responses = begins[::2], begins[1::2]
    known = {one: number for number, one in enumerate(dict.fromkeys(connections))}
    number = np.array([known[one] for one in connections], np.int64)
    headers = np.concatenate(
        [link_headers(block, packets[:, column], ip_at[:, column]) for column in (0, 1)], axis=1
    )
    _, like = np.unique(
        np.ascontiguousarray(headers).view(f"S{headers.shape[1]}")[:, 0], return_inverse=True
    )
    _, first, connection = np.unique(
        number * (len(like) + 1) + like, return_index=True, return_inverse=True
    )
    times = np.array([(one.request_ns or 0, one.response_ns or 0) for one in found], np.int64)
    return PlainRows(
        block=block,
        data=data,
        connections=[connections[place] for place in first.tolist()],
        addresses=[
            (
                link_addresses_of(block, int(packets[place, 0]), int(ip_at[place, 0])),
                link_addresses_of(block, int(packets[place, 1]), int(ip_at[place, 1])),
            )
            for place in first.tolist()
        ],
        connection=connection.astype(np.int64),
        has_addresses=np.ones(len(found), np.bool_),
        request_ip_at=ip_at[:, 0],
        response_ip_at=ip_at[:, 1],
        request=packets[:, 0],
        response=packets[:, 1],
        request_begin=requests,
        request_size=sizes[::2],
        response_begin=responses,
        response_size=sizes[1::2],
        request_ns=times[:, 0],
        response_ns=times[:, 1],
        transaction_id=np.array([one.transaction_id or 0 for one in found], np.int64),
        unit=data[requests + MBAP_BYTES - 1].astype(np.int64),
        code=data[requests + MBAP_BYTES].astype(np.int64),
        response_code=data[responses + MBAP_BYTES].astype(np.int64),
    )


def _join_rows(rows: PlainRows, more: PlainRows) -> PlainRows:
    """Return the rows of both in the order of their responses; `more` has the bytes of both."""
    order = np.argsort(np.concatenate([rows.response, more.response]), kind="stable")
    both: dict[str, Any] = {
        name: np.concatenate([getattr(rows, name), getattr(more, name)])[order]
        for name in PER_ROW
        if name != "connection"
    }
    connection = np.concatenate([rows.connection, more.connection + len(rows.connections)])[order]
    return replace(
        rows,
        data=more.data,
        connections=[*rows.connections, *more.connections],
        addresses=[*rows.addresses, *more.addresses],
        connection=connection,
        **both,
    )
