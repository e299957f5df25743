"""Holds the transactions of a block that were read without the Decoder, each field as an array."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbtool.columns.arrays import Bools, Int64s, Octets, gather, ranges
from mbtool.columns.packet_block import PacketBlock
from mbtool.core import Connection, LinkAddresses
from mbtool.decode.plain_stretch import PlainLimits, PlainStretch
from mbtool.modbus.adu import MBAP_BYTES
from mbtool.packets.link_layer import link_addresses
from mbtool.packets.plain_bytes import PlainBytes
from mbtool.packets.stream import RECENT_BYTES

if TYPE_CHECKING:
    from mbtool.columns.headers import Segments
    from mbtool.columns.stretches import Stretches

_UNIT_AT = MBAP_BYTES - 1
"""The offset in bytes of the unit in an ADU of Modbus/TCP."""
_LINK_HEADER = np.dtype("V32")
"""The first 32 bytes of a packet. No link layer header that headers.py reads is longer than 28
bytes, so the last byte is free for the header's length."""


@dataclass(slots=True)
class PlainRows:
    """Transactions of a block that were read from arrays, in the order of their responses.

    Each array has one element per transaction.
    """

    block: PacketBlock
    data: Octets
    """The bytes of all packets of the block, followed by copies of the request ADUs that came in
    two segments each."""
    connections: list[Connection]
    """For each plain stretch, its connection."""
    addresses: list[tuple[LinkAddresses | None, LinkAddresses | None]]
    """For each plain stretch, the MAC addresses and VLAN in the packets of its first request and of
    its first response; None for a packet without MAC addresses."""
    connection: Int64s
    """The index, in `connections` and in `addresses`, of the transaction's plain stretch."""
    has_addresses: Bools
    """True if the link layer headers of the transaction's packets equal those of the first
    transaction in its stretch, so that `addresses` holds for it, too."""
    request_ip_at: Int64s
    """The number of bytes before the IP header, in the packet that completed the request."""
    response_ip_at: Int64s
    request: Int64s
    """The index in the block of the packet that completed the request."""
    response: Int64s
    request_begin: Int64s
    """The offset in `data` at which the request's ADU begins, in bytes."""
    request_size: Int64s
    response_begin: Int64s
    response_size: Int64s
    request_ns: Int64s
    response_ns: Int64s
    transaction_id: Int64s
    unit: Int64s
    code: Int64s
    response_code: Int64s

    def part(self, begin: int, end: int) -> PlainRows:
        """Return the transactions with the indices `begin` to `end` (exclusive)."""
        some: dict[str, Any] = {name: getattr(self, name)[begin:end] for name in PER_ROW}
        return replace(self, **some)


_OF_A_BLOCK = ("block", "data", "connections", "addresses")
"""The fields of PlainRows that are for the whole block; all others have one element per
transaction."""
PER_ROW = [one.name for one in fields(PlainRows) if one.name not in _OF_A_BLOCK]
"""The names of the arrays that have one element per transaction."""


class _Lists(NamedTuple):
    """Fields of TransactionArrays as lists of int, with one element per transaction.

    Reading single elements from a list is faster than from a numpy array.
    """

    first_place: list[int]
    request_place: list[int]
    response_place: list[int]
    request_ns: list[int]
    response_ns: list[int]
    latency_ns: list[int]
    request_begin: list[int]
    request_size: list[int]
    response_begin: list[int]
    response_size: list[int]
    transaction_id: list[int]
    code: list[int]


class TransactionArrays:
    """Holds the fields of all transactions in the plain stretches of a block, each field as an
    array, and some as a list, too.
    """

    def __init__(self, stretches: Stretches, segments: Segments) -> None:
        found, order = stretches.transactions, stretches.order
        self._found = found
        self._order = order
        self._data = stretches.data
        self._octets = stretches.data.data  # Small slices are faster on a memoryview.
        self.first_place, self._request_place = found.request_first, found.request
        """For each transaction, the index in `Stretches.order` of its request's first segment, and
        that of its request's last segment."""
        self.response_place = found.response
        requests, responses = order[found.request], order[found.response]
        self.first_packet = segments.index[order[found.request_first]]
        self._request_packet = segments.index[requests]
        self._response_packet = segments.index[responses]
        self._request_ip_at = segments.ip_at[requests]
        self._response_ip_at = segments.ip_at[responses]
        self._request_ns = segments.ts_ns[requests]
        self._response_ns = segments.ts_ns[responses]
        self._lists = _Lists(
            first_place=self.first_place.tolist(),
            request_place=self._request_place.tolist(),
            response_place=self.response_place.tolist(),
            request_ns=self._request_ns.tolist(),
            response_ns=self._response_ns.tolist(),
            latency_ns=(self._response_ns - self._request_ns).tolist(),
            request_begin=found.request_begin.tolist(),
            request_size=found.request_size.tolist(),
            response_begin=found.response_begin.tolist(),
            response_size=found.response_size.tolist(),
            transaction_id=found.transaction_id.tolist(),
            code=found.code.tolist(),
        )

    def packets(self, at: int, until: int, end: int) -> Int64s:
        """Return the indices in `Segments` of the segments of the transactions with the indices
        `at` to `until` (exclusive).

        `end` is the index behind the last transaction of the stretch. If `until` is smaller,
        further segments before the transaction `until`, such as acknowledgements, are returned too.
        """
        stop = self.response_place[at] + 1 if until == end else self.first_place[until]
        return self._order[self.first_place[at] : stop]

    def end_within(self, limits: PlainLimits, at: int, end: int) -> int:
        """Return the index of the first transaction between `at` and `end` that `limits` leaves to
        the Decoder; `end` if there is none.
        """
        lists, code = self._lists, self._lists.code
        end = bisect_left(lists.response_ns, limits.until_ns, at, end)
        for one in range(at, end):
            begin = lists.request_begin[one] + _UNIT_AT
            request = self._bytes(begin, lists.request_size[one] - _UNIT_AT)
            if request in limits.requests:
                return one
            if (lists.transaction_id[one], request[0], code[one]) in limits.responses:
                return one
        return end

    def stretch(self, at: int, end: int) -> PlainStretch:
        """Return the facts from the transactions with the indices `at` to `end` (exclusive) that
        the Decoder must learn, as if it had decoded them itself.
        """
        some, last, lists = slice(at, end), end - 1, self._lists
        first_place = lists.first_place[at]
        codes, latencies_ns = lists.code[some], lists.latency_ns[some]
        kinds = set(codes)
        latencies = {next(iter(kinds)): latencies_ns} if len(kinds) == 1 else {}
        if len(kinds) > 1:
            for code, latency_ns in zip(codes, latencies_ns, strict=True):
                latencies.setdefault(code, []).append(latency_ns)
        begins, sizes = lists.request_begin, lists.request_size
        return PlainStretch(
            requests=PlainBytes(
                sum(sizes[some]),
                self._tail(begins, sizes, at, end),
                lists.request_place[last] - first_place + 1,
                lists.request_ns[last],
            ),
            responses=PlainBytes(
                sum(lists.response_size[some]),
                self._tail(lists.response_begin, lists.response_size, at, end),
                lists.response_place[last] - first_place + 1,
                lists.response_ns[last],
            ),
            last_response_size=lists.response_size[last],
            transaction_ids=lists.transaction_id[some],
            latencies=latencies,
        )

    def _bytes(self, begin: int, size: int) -> bytes:
        return self._octets[begin : begin + size].tobytes()

    def _tail(self, begins: list[int], sizes: list[int], at: int, end: int) -> bytes:
        """Return the last RECENT_BYTES bytes of the ADUs with the indices `at` to `end`
        (exclusive); all their bytes if they have fewer.

        ADU i has `sizes[i]` bytes from the offset `begins[i]` on. The reassembler compares
        retransmissions with the returned bytes.
        """
        adus: list[bytes] = []
        room = RECENT_BYTES
        while end > at and room > 0:
            end -= 1
            adus.append(self._bytes(begins[end], sizes[end]))
            room -= sizes[end]
        return b"".join(reversed(adus))[-RECENT_BYTES:]

    def rows(self, block: PacketBlock, taken: list[tuple[int, int, Connection]]) -> PlainRows:
        """Return the transactions of the plain stretches in `taken`, in the order of their
        responses.

        Each item of `taken` has the index of a stretch's first transaction, the index behind its
        last one, and its connection.
        """
        firsts = np.array([first for first, _, _ in taken])
        sizes = np.array([end - first for first, end, _ in taken])
        chosen = ranges(firsts, sizes)
        connection = np.repeat(np.arange(len(taken)), sizes)
        requests = link_headers(block, self._request_packet, self._request_ip_at)
        responses = link_headers(block, self._response_packet, self._response_ip_at)
        like = np.repeat(firsts, sizes)
        has_addresses = _are_equal(requests, chosen, like) & _are_equal(responses, chosen, like)
        addresses = self._addresses(block, firsts, requests[firsts], responses[firsts])
        order = np.argsort(self._response_packet[chosen], kind="stable")
        chosen = chosen[order]
        return PlainRows(
            block=block,
            data=self._data,
            connections=[one for _, _, one in taken],
            addresses=addresses,
            connection=connection[order],
            has_addresses=has_addresses[order],
            request_ip_at=self._request_ip_at[chosen],
            response_ip_at=self._response_ip_at[chosen],
            request=self._request_packet[chosen],
            response=self._response_packet[chosen],
            request_begin=self._found.request_begin[chosen],
            request_size=self._found.request_size[chosen],
            response_begin=self._found.response_begin[chosen],
            response_size=self._found.response_size[chosen],
            request_ns=self._request_ns[chosen],
            response_ns=self._response_ns[chosen],
            transaction_id=self._found.transaction_id[chosen],
            unit=self._found.unit[chosen],
            code=self._found.code[chosen],
            response_code=self._found.response_code[chosen],
        )

    def _addresses(
        self, block: PacketBlock, firsts: Int64s, requests: Octets, responses: Octets
    ) -> list[tuple[LinkAddresses | None, LinkAddresses | None]]:
        """Return the MAC addresses and VLAN in the packets of request and response, for each of the
        transactions with the indices `firsts`; None for a packet without MAC addresses.

        `requests` and `responses` are the rows that `link_headers` gives for these transactions.
        """
        both = np.ascontiguousarray(np.concatenate([requests, responses], axis=1))
        _, some, like = np.unique(
            both.view(f"S{both.shape[1]}")[:, 0], return_index=True, return_inverse=True
        )
        found = [
            (
                link_addresses_of(block, self._request_packet[one], self._request_ip_at[one]),
                link_addresses_of(block, self._response_packet[one], self._response_ip_at[one]),
            )
            for one in firsts[some].tolist()
        ]
        return [found[one] for one in like.tolist()]


def link_headers(block: PacketBlock, packets: Int64s, ip_at: Int64s) -> Octets:
    """Return a row of 32 bytes for each packet with an index in `packets`.

    A row has the packet's link layer header, zeros behind it, and in the last byte the header's
    length, which `ip_at` gives. So two rows are equal if the headers are equal.
    """
    headers = gather(block.data, block.starts[packets], _LINK_HEADER).view(np.uint8)
    headers = headers.reshape(len(packets), _LINK_HEADER.itemsize)
    least = int(ip_at.min(initial=_LINK_HEADER.itemsize))
    if (ip_at == least).all():
        headers[:, least:] = 0
    else:
        headers[np.arange(_LINK_HEADER.itemsize) >= ip_at[:, None]] = 0
    headers[:, -1] = ip_at
    return headers


def _are_equal(headers: Octets, first: Int64s, second: Int64s) -> Bools:
    """Return for each i True if the rows `first[i]` and `second[i]` of `headers` are equal."""
    words = headers.view(np.uint64)  # Compared as 8-byte words: much faster.
    is_equal: Bools = (words[first] == words[second]).all(axis=1)
    return is_equal


def link_addresses_of(block: PacketBlock, packet: int, ip_at: int) -> LinkAddresses | None:
    """Return the MAC addresses and VLAN of the packet with the index `packet` in the block.

    `ip_at` is the length of its link layer header in bytes. None if the header has no MAC address.
    """
    start = int(block.starts[packet])
    _, link_type = block.links[0 if block.interfaces is None else block.interfaces[packet]]
    return link_addresses(link_type, block.data[start : start + ip_at].tobytes())
