"""Decodes blocks of packets: plain stretches of connections as arrays, all else by the Decoder."""

# Every packet that is in no plain stretch is fed to the Decoder, in its place in the file. Where a
# stretch begins, the Decoder tells if the connection is at rest (nothing of it is open or held). If
# it is, the stretch's transactions are read from the arrays, and the Decoder is told of them
# (plain_stretch.py). If it is not, the packets up to the stretch's next request are fed, and it is
# asked again.
#
# So the Decoder owns what is known of connections, and its results are the same as if it had been
# fed every packet. The results of a block are sorted by the packet that completed them.
#
# A block is fed to the Decoder packet by packet if times go back in it, or if a limit of the
# reassembler (idle connections, their number) may be reached, since the order of all packets of all
# connections counts there.

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbtool.columns.arrays import Bools, Int64s, Octets, gather, ranges
from mbtool.columns.flows import UNKNOWN, FlowNumbers
from mbtool.columns.headers import read_headers
from mbtool.columns.packet_block import PacketBlock
from mbtool.columns.stretches import find_stretches
from mbtool.core import Connection, LinkAddresses
from mbtool.decode.decoder import Record
from mbtool.decode.plain_stretch import PlainStretch
from mbtool.packets.link_addresses import link_addresses
from mbtool.packets.plain_bytes import PlainBytes
from mbtool.packets.segment import RST, SYN
from mbtool.packets.stream import RECENT_BYTES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.columns.headers import Headers, Segments
    from mbtool.columns.stretches import Stretches
    from mbtool.decode.decoder import Decoder
    from mbtool.packets.connection import TcpConnection

_LINK_HEADER = np.dtype("V32")
"""The first 32 bytes of a packet: more than the link layer headers that headers.py reads."""


@dataclass(slots=True)
class PlainRows:
    """Transactions that were read from arrays. Each array has one element per transaction."""

    block: PacketBlock
    data: Octets
    """The data of the block, and behind it the ADUs that came in pieces."""
    connections: list[Connection]
    """The connection of each stretch."""
    addresses: list[tuple[LinkAddresses | None, LinkAddresses | None]]
    """The addresses on the link layer of the first request and response of each stretch."""
    connection: Int64s
    """The index of the transaction's stretch in `connections` and `addresses`."""
    has_addresses: Bools
    """True if request and response have the same addresses as the first ones of their stretch."""
    request_ip_at: Int64s
    """The length, in bytes, of the link layer header of the request's packet."""
    response_ip_at: Int64s
    request: Int64s
    """The index of the request's packet in the block."""
    response: Int64s
    request_begin: Int64s
    """The offset of the request's ADU in `data`."""
    request_size: Int64s
    response_begin: Int64s
    response_size: Int64s
    request_ns: Int64s
    response_ns: Int64s
    transaction_id: Int64s
    unit: Int64s
    code: Int64s
    response_code: Int64s


@dataclass(slots=True)
class DecodedBlock:
    """The transactions and events that the packets of a block completed."""

    plain: PlainRows | None = None
    records: list[tuple[int, Record]] = field(default_factory=list)
    """The Decoder's records in order, each with a number that sorts it among the plain rows. A
    plain row has the number that `order_of` gives for its response's packet."""


def order_of(packets: Int64s) -> Int64s:
    """The sort numbers of results that packets themselves completed, by the packets' indices."""
    # Odd numbers: results that a packet's bytes complete. Even: those that only its time completes.
    return 2 * packets + 1


class ColumnDecoder:
    """Takes the blocks of one capture in order."""

    def __init__(self, decoder: Decoder, ports: Iterable[int]) -> None:
        """`decoder` follows only the TCP ports `ports`, and joins packets of all interfaces."""
        self._decoder = decoder
        self._ports = frozenset(ports)
        self._flows = FlowNumbers()
        self.plain_rows = 0
        """The number of transactions read from arrays so far."""

    def feed(self, block: PacketBlock) -> DecodedBlock:
        headers = read_headers(block, self._ports)
        segments = headers.segments
        numbers = self._flows.numbers(segments.lower, segments.upper)
        if not self._may_skip(block, headers, numbers):
            return self._fed(block)
        stretches = find_stretches(headers, numbers, block.data)
        decoded = _BlockPass(self._decoder, self._flows, block, headers, numbers, stretches).run()
        if decoded.plain is not None:
            self.plain_rows += len(decoded.plain.request)
        return decoded

    def close(self) -> DecodedBlock:
        return DecodedBlock(records=[(0, one) for one in self._decoder.close()])

    def _may_skip(self, block: PacketBlock, headers: Headers, numbers: Int64s) -> bool:
        """True if the results do not depend on the order of packets of different connections."""
        segments = headers.segments
        if not len(segments.index):
            return True
        if (np.diff(segments.ts_ns) < 0).any() or (numbers == UNKNOWN).any():
            return False
        if (segments.flags & (SYN | RST) == SYN | RST).any():
            return False
        more = (
            int(np.count_nonzero(np.bincount(numbers))) + len(headers.hidden) + len(headers.apart)
        )
        last_ns = int(block.ts_ns.max())
        return not self._decoder.reassembler.may_drop(last_ns, more)

    def _fed(self, block: PacketBlock) -> DecodedBlock:
        decoded = DecodedBlock()
        for index in range(len(block)):
            for record in self._decoder.feed(block.packet(index)):
                decoded.records.append((2 * index + 1, record))
        return decoded


class _BlockPass:
    """One pass over a block: feeds packets, and takes the stretches of connections at rest."""

    def __init__(
        self,
        decoder: Decoder,
        flows: FlowNumbers,
        block: PacketBlock,
        headers: Headers,
        numbers: Int64s,
        stretches: Stretches,
    ) -> None:
        self._decoder = decoder
        self._flows = flows
        self._block = block
        self._headers = headers
        self._segments = headers.segments
        self._numbers = numbers
        self._stretches = stretches
        self._times: list[int] = self._segments.ts_ns.tolist()
        self._rows = _TransactionArrays(stretches, self._segments)
        self._passed = 0
        """The segments before this index were fed, or the Decoder was told of their times."""
        self._used = 0
        """The segments before this index are counted in the order of the connections' last use."""
        self._decoded = DecodedBlock()
        self._taken: list[tuple[int, int, Connection]] = []
        """By stretch taken: its first transaction, the one behind its last, its connection."""
        self._ends_ns: dict[TcpConnection, int] = {}
        """By connection, when its last stretch ended, in ns."""

    def run(self) -> DecodedBlock:
        index = self._segments.index
        begins = self._rows.first_packet[self._stretches.bounds[:-1]].tolist()
        due = [(packet, number, -1) for number, packet in enumerate(begins)]
        due += [(packet, -1, place) for packet, place in self._fed_segments()]
        apart = {*self._headers.hidden.tolist(), *self._headers.apart.tolist()}
        due += [(packet, -1, -1) for packet in apart]
        heapq.heapify(due)
        bounds = self._stretches.bounds.tolist()
        while due:
            packet, number, place = heapq.heappop(due)
            if number < 0:
                self._feed(packet, place)
                continue
            at = bounds[number] if place < 0 else place
            if self._take(at, bounds[number + 1]):
                continue
            until = at + 1
            for one in self._rows.packets(at, until, bounds[number + 1]):
                heapq.heappush(due, (int(index[one]), -1, int(one)))
            if until < bounds[number + 1]:
                begin = int(self._rows.first_packet[until])
                heapq.heappush(due, (begin, number, until))
        self._pass_times(len(self._times))
        self._note_used(len(self._times))
        self._decoder.note_time(int(self._block.ts_ns.max()))
        for connection, end_ns in self._ends_ns.items():
            # Since the stretch was taken, the connection may have been told earlier times, of
            # packets of other connections.
            connection.note_time(end_ns)
        self._decoded.plain = self._rows.rows(self._block, self._taken) if self._taken else None
        return self._decoded

    def _fed_segments(self) -> list[tuple[int, int]]:
        """The packet index and the segment index of each segment that is in no stretch."""
        order, bounds = self._stretches.order, self._stretches.bounds
        change = np.zeros(len(order) + 1, np.int64)
        change[self._rows.first_place[bounds[:-1]]] += 1
        change[self._rows.response_place[bounds[1:] - 1] + 1] -= 1
        places = order[np.cumsum(change[:-1]) == 0]
        packets = self._segments.index[places]
        return list(zip(packets.tolist(), places.tolist(), strict=True))

    def _feed(self, packet: int, place: int) -> None:
        """Feed a packet; `place` is its index among the segments, or -1 if it is no segment."""
        if place < 0:
            behind = int(np.searchsorted(self._segments.index, packet))
            self._pass_times(behind)
            self._note_used(behind)
        else:
            self._pass_times(place)
            self._passed = place + 1
        for record in self._decoder.feed(self._block.packet(packet)):
            self._decoded.records.append((2 * packet + 1, record))

    def _pass_times(self, until: int) -> None:
        """Tell the Decoder of the times of segments that are not fed."""
        if self._passed >= until:
            return
        found = self._decoder.pass_times(self._times, self._passed, until)
        self._passed = until
        for at, records in found:
            packet = int(self._segments.index[at])
            self._decoded.records += [(2 * packet, record) for record in records]

    def _note_used(self, until: int) -> None:
        """Mark the connections of the segments before `until` as used, in the segments' order."""
        newest_first = dict.fromkeys(self._numbers[self._used : until][::-1].tolist())
        self._used = max(self._used, until)
        self._decoder.reassembler.note_used(self._flows.ends[one] for one in reversed(newest_first))

    def _take(self, at: int, end: int) -> bool:
        """Take the transactions from `at` to `end` if their connection is at rest at the first."""
        rows = self._rows
        place = int(self._stretches.order[rows.first_place[at]])
        ends = self._flows.ends[int(self._numbers[place])]
        resting = self._decoder.at_rest(ends, self._times[place])
        if resting is None:
            return False
        sequences = self._segments.sequence[place], self._segments.acknowledged[place]
        if sequences != (resting.place.request_sequence, resting.place.response_sequence):
            return False
        stretch = rows.stretch(at, end)
        resting.pass_plain(stretch)
        self._ends_ns[resting.connection] = stretch.responses.last_ns
        self._taken.append((at, end, resting.connection.identity))
        return True


class _Lists(NamedTuple):
    """The same as the arrays of these names: of a few elements lists are read faster."""

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


class _TransactionArrays:
    """The arrays of the transactions in all stretches of a block."""

    def __init__(self, stretches: Stretches, segments: Segments) -> None:
        found, order = stretches.transactions, stretches.order
        self._found = found
        self._order = order
        self._data = stretches.data
        self.first_place, self._request_place = found.request_first, found.request
        """For each transaction, the index in `order` of its request's first and last segment."""
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
        """The segments of transaction `at`, with those before `until` unless that is `end`."""
        stop = self.response_place[at] + 1 if until == end else self.first_place[until]
        return self._order[self.first_place[at] : stop]

    def stretch(self, at: int, end: int) -> PlainStretch:
        """The transactions from `at` to `end` in the form in which the Decoder takes them."""
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
            last_requests=[
                self._bytes(begins[one], sizes[one]) for one in range(max(at, end - 2), end)
            ],
            last_response_size=lists.response_size[last],
            transaction_ids=lists.transaction_id[some],
            latencies=latencies,
        )

    def _bytes(self, begin: int, size: int) -> bytes:
        return self._data[begin : begin + size].tobytes()

    def _tail(self, begins: list[int], sizes: list[int], at: int, end: int) -> bytes:
        """The last bytes of the ADUs from `at` to `end`: RECENT_BYTES, or all if they are fewer."""
        adus: list[bytes] = []
        room = RECENT_BYTES
        while end > at and room > 0:
            end -= 1
            adus.append(self._bytes(begins[end], sizes[end]))
            room -= sizes[end]
        return b"".join(reversed(adus))[-RECENT_BYTES:]

    @staticmethod
    def _link_headers(block: PacketBlock, packets: Int64s, ip_at: Int64s) -> Octets:
        """One row per packet: its link layer header, padded with zeros, and the header's length."""
        headers = gather(block.data, block.starts[packets], _LINK_HEADER).view(np.uint8)
        headers = headers.reshape(len(packets), _LINK_HEADER.itemsize)
        headers[np.arange(_LINK_HEADER.itemsize) >= ip_at[:, None]] = 0
        headers[:, -1] = ip_at
        return headers

    def rows(self, block: PacketBlock, taken: list[tuple[int, int, Connection]]) -> PlainRows:
        """The rows of the transactions that were taken, in the order of their responses."""
        firsts = np.array([first for first, _, _ in taken])
        sizes = np.array([end - first for first, end, _ in taken])
        chosen = ranges(firsts, sizes)
        connection = np.repeat(np.arange(len(taken)), sizes)
        requests = self._link_headers(block, self._request_packet, self._request_ip_at)
        responses = self._link_headers(block, self._response_packet, self._response_ip_at)
        like = np.repeat(firsts, sizes)
        has_addresses = (requests[chosen] == requests[like]).all(axis=1)
        has_addresses &= (responses[chosen] == responses[like]).all(axis=1)
        addresses = [
            (
                link_addresses_of(block, self._request_packet[first], self._request_ip_at[first]),
                link_addresses_of(block, self._response_packet[first], self._response_ip_at[first]),
            )
            for first in firsts.tolist()
        ]
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


def link_addresses_of(block: PacketBlock, packet: int, ip_at: int) -> LinkAddresses | None:
    """The addresses in the header of the link layer of a packet, which has `ip_at` bytes."""
    start = int(block.starts[packet])
    _, link_type = block.links[0 if block.interfaces is None else block.interfaces[packet]]
    return link_addresses(link_type, block.data[start : start + ip_at].tobytes())
