"""Decodes a capture in blocks of packets: reads undisturbed polling from arrays, and feeds all
other packets that may carry Modbus to the Decoder.
"""

# A plain stretch is a series of request and response pairs of one connection, in order and without
# a gap (stretches.py). Where a stretch begins, the Decoder is asked whether the connection is at
# rest: no request is pending and no byte is out of order. If it is at rest, the transactions are
# read from the arrays, and the Decoder is told what it would have learned from them
# (decode/plain_stretch.py). If it is not, the Decoder is fed the stretch's packets up to its next
# request, and is asked again there. The Decoder is fed all packets outside of stretches that may
# carry Modbus, in the order of the file.
#
# So the Decoder alone keeps the state of connections, and the results are the same as if it had
# been fed every packet. The results of a block are sorted by the packet that completed them.
#
# A connection that lies in one block from its SYN to its FINs, with nothing unusual, is read from
# the arrays without asking the Decoder (passed_connections.py). The Decoder is only told that the
# connection has ended.
#
# In two cases the results depend on the order of all packets of all connections: the packets' times
# go back by PATIENCE_NS or more, or the reassembler may reach a limit (idle time, number of
# connections) and drop an open connection. Then the block is cut in halves again and again, until
# the Decoder is fed all packets of a part of at most SMALLEST packets. A block with very many
# connections is decoded in several parts, each with so few connections that they cannot make the
# reassembler drop one of them.

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s, narrow
from mbtool.columns.decoded_rows import with_decoded
from mbtool.columns.flows import UNKNOWN, FlowNumbers
from mbtool.columns.headers import Headers, Segments, read_headers
from mbtool.columns.passed_connections import PassedConnections, take_whole_connections
from mbtool.columns.plain_rows import PlainRows, TransactionArrays
from mbtool.columns.stretches import Stretches, find_stretches
from mbtool.core import Connection, WireEvent
from mbtool.decode.decoder import Decoder, Record
from mbtool.decode.plain_stretch import NO_LIMITS
from mbtool.packets.connection import PATIENCE_NS, TcpConnection
from mbtool.packets.reassembler import IDLE_NS, MAX_CONNECTIONS
from mbtool.packets.segment import RST, SYN

if TYPE_CHECKING:
    from mbtool.columns.packet_block import PacketBlock

SMALLEST = 256
"""A part of a block with at most this many packets is not cut further: the Decoder gets all its
packets."""
_FLOWS_AT_ONCE = MAX_CONNECTIONS // 2
"""At most this many flows (a flow is all segments between two TCP ends) are decoded in one part of
a block. It is half of the connections that the reassembler keeps, so the flows of one part cannot
make it drop one of them."""


@dataclass(slots=True)
class DecodedBlock:
    """The transactions and events that the packets of a block completed."""

    plain: PlainRows | None = None
    records: list[tuple[int, Record]] = field(default_factory=list)
    """The transactions and events from the Decoder, each with its sort key (`result_sort_keys`). A
    transaction in `plain` has the key that `result_sort_keys` gives for the packet of its
    response."""
    passed: PassedConnections | None = None
    """The connections that were read from arrays as a whole, from SYN to FIN; None if there are
    none. `records` lacks their opening and closing events."""

    def sorted_records(self, *, with_passed: bool = False) -> list[tuple[int, Record]]:
        """Return `records` sorted by their keys.

        `with_passed` adds the opening and closing events of the connections in `passed`.
        """
        passed = self.passed.events() if with_passed and self.passed is not None else []
        return sorted([*passed, *self.records], key=lambda one: one[0])

    def last_ns(self) -> int | None:
        """Return the time (UTC ns) of the transaction or event that was completed last.

        The time of a transaction is that of its request, or of its response if it has no request.
        None if the block completed nothing.
        """
        found: list[tuple[int, int]] = []
        if self.records:
            # If several records have the highest key, `max` returns the first of them. On the
            # reversed list that is the record that stands last in `records`.
            number, last = max(reversed(self.records), key=lambda one: one[0])
            found.append((number, last.ts_ns if isinstance(last, WireEvent) else last.start_ns))
        if self.plain is not None:
            found.append((2 * int(self.plain.response[-1]) + 1, int(self.plain.request_ns[-1])))
        if self.passed is not None:
            last_closed = int(self.passed.closed.argmax())
            closed = int(self.passed.closed[last_closed])
            found.append((2 * closed + 1, int(self.passed.closed_ns[last_closed])))
        return max(found)[1] if found else None


def result_sort_keys(packets: Int64s) -> Int64s:
    """Return, for each index of a packet in the block, the sort key of the results that the
    packet's bytes complete.
    """
    # Results that the bytes of packet i complete have the key 2i + 1. Results that only the time of
    # packet i completes, such as timeouts, have the key 2i and so come before them.
    return 2 * packets + 1


class ColumnDecoder:
    """Decodes a capture that is given in blocks of packets, which must come in order."""

    def __init__(self, decoder: Decoder, ports: Iterable[int]) -> None:
        """Take the Decoder that reads whatever is no plain stretch, and the TCP ports that carry
        Modbus.

        The Decoder must follow exactly these ports, and must have been made with `across=True`, so
        that packets from different interfaces may belong to one connection.
        """
        self._decoder = decoder
        self._ports = frozenset(ports)
        self._flows = FlowNumbers()
        self.plain_rows = 0
        """The number of transactions that were read from arrays so far, without the Decoder."""

    def feed(self, block: PacketBlock) -> Iterator[DecodedBlock]:
        """Decode a block. Yields its results once, or once per part if the block has so many flows
        (more than _FLOWS_AT_ONCE) that it is decoded in parts.
        """
        self._flows.make_room()
        headers = read_headers(block, self._ports, self._flows.addresses)
        segments = headers.segments
        numbers = self._flows.numbers(segments.lower, segments.upper)
        cuts = _cuts(segments, numbers)
        if not cuts:
            yield from self._feed(block, headers, numbers)
            return
        for begin, end in pairwise((0, *cuts, len(block))):
            yield from self._feed(*_part(block, headers, numbers, begin, end))

    def _feed(
        self, block: PacketBlock, headers: Headers, numbers: Int64s
    ) -> Iterator[DecodedBlock]:
        """Decode a block; if the order of all its packets counts, its halves one after the other.

        `numbers` has the flow number of each segment.
        """
        if self._may_skip(block, headers, numbers):
            yield self._decode_arrays(block, headers, numbers)
        elif len(block) <= SMALLEST:
            yield self._decode_singly(block)
        else:
            middle = len(block) // 2
            for begin, end in ((0, middle), (middle, len(block))):
                yield from self._feed(*_part(block, headers, numbers, begin, end))

    def _decode_arrays(self, block: PacketBlock, headers: Headers, numbers: Int64s) -> DecodedBlock:
        stretches = find_stretches(headers, numbers, block.data)
        taken = _BlockPass(self._decoder, self._flows, block, headers, numbers, stretches)
        decoded = taken.run()
        self.plain_rows += taken.plain_rows
        return decoded

    def close(self) -> DecodedBlock:
        return DecodedBlock(records=[(0, one) for one in self._decoder.close()])

    def _may_skip(self, block: PacketBlock, headers: Headers, numbers: Int64s) -> bool:
        """True if plain stretches of the block may be read from arrays.

        That is so if the order in which packets of different connections are decoded makes no
        difference to the results. It makes one, for example, if the packets' times go back.
        `numbers` has the flow number of each segment.
        """
        segments = headers.segments
        if not len(segments.index):
            return True
        latest = np.maximum.accumulate(segments.ts_ns)
        if (latest - segments.ts_ns).max() >= PATIENCE_NS or (numbers == UNKNOWN).any():
            return False
        if (segments.flags & (SYN | RST) == SYN | RST).any():
            return False
        order = np.argsort(narrow(numbers), kind="stable")
        flows, times = numbers[order], segments.ts_ns[order]
        begins = np.flatnonzero(np.append(True, flows[1:] != flows[:-1]))
        idle_ns = np.diff(times, append=latest[-1])
        idle_ns[begins[1:] - 1] = latest[-1] - times[begins[1:] - 1]
        if idle_ns.max() >= IDLE_NS - PATIENCE_NS:
            return False
        firsts = zip(flows[begins].tolist(), times[begins].tolist(), strict=True)
        used = {self._flows.ends[flow]: first_ns for flow, first_ns in firsts}
        last_ns = int(block.ts_ns.max())
        return not self._decoder.reassembler.may_drop(last_ns, used, len(headers.hidden))

    def _decode_singly(self, block: PacketBlock) -> DecodedBlock:
        decoded = DecodedBlock()
        for index in range(len(block)):
            for record in self._decoder.feed(block.packet(index)):
                decoded.records.append((2 * index + 1, record))
        return decoded


def _part(
    block: PacketBlock, headers: Headers, numbers: Int64s, begin: int, end: int
) -> tuple[PacketBlock, Headers, Int64s]:
    """Return the packets with the indices `begin` to `end` (exclusive) of a block, with their
    headers and the flow numbers of their segments.
    """
    part = headers.part(begin, end)
    first = int(np.searchsorted(headers.segments.index, begin))
    some = numbers[first : first + len(part.segments.index)]
    return block.part(begin, end), part, some


def _cuts(segments: Segments, numbers: Int64s) -> list[int]:
    """Return the index of the first packet of each part but the first, if a block has more than
    _FLOWS_AT_ONCE flows and so must be cut into parts; else an empty list.

    `numbers` has the flow number of each segment.
    """
    _, firsts = np.unique(numbers, return_index=True)
    if len(firsts) <= _FLOWS_AT_ONCE:
        return []
    cuts: list[int] = segments.index[np.sort(firsts)[_FLOWS_AT_ONCE::_FLOWS_AT_ONCE]].tolist()
    return cuts


class _BlockPass:
    """Decodes one block. Reads polls from arrays if their connection is at rest (no request
    pending, no byte missing), and feeds the other packets to the Decoder.
    """

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
        self._latest: list[int] = np.maximum.accumulate(self._segments.ts_ns).tolist()
        """For each segment, the latest time so far: times may go back by less than PATIENCE_NS."""
        self._rows = TransactionArrays(stretches, self._segments)
        self._passed = 0
        """An index in `Segments`: each segment before it was given to the Decoder, whole or only
        with its time."""
        self._used = 0
        """An index in `Segments`: the connections of all segments before it were marked as used in
        the reassembler, which drops the connection that was not used for longest."""
        self._decoded = DecodedBlock()
        self._connections: list[Connection | None] = []
        """The connection that each of the decoder's records came from; None if unknown."""
        self.plain_rows = 0
        """The number of transactions that were read from arrays, without the Decoder."""
        self._taken: list[tuple[int, int, Connection]] = []
        """For each plain stretch that was read from arrays: the index of its first transaction, the
        index behind its last one, and its connection."""
        self._ends_ns: dict[TcpConnection, int] = {}
        """For each connection, the time of its last response that was read from arrays, in UTC
        ns."""

    def run(self) -> DecodedBlock:
        index = self._segments.index
        is_whole = self._take_whole_connections()
        begins = self._rows.first_packet[self._stretches.bounds[:-1]]
        asked = np.flatnonzero(~is_whole[self._stretch_flows()])
        due = [
            (packet, number, -1)
            for number, packet in zip(asked.tolist(), begins[asked].tolist(), strict=True)
        ]
        due += [(packet, -1, place) for packet, place in self._fed_segments(is_whole)]
        due += [(packet, -1, -1) for packet in self._headers.hidden.tolist()]
        heapq.heapify(due)
        bounds = self._stretches.bounds.tolist()
        while due:
            packet, number, place = heapq.heappop(due)
            if number < 0:
                self._feed(packet, place)
                continue
            at = bounds[number] if place < 0 else place
            until = self._take(at, bounds[number + 1])
            if until > at:
                if until < bounds[number + 1]:
                    begin = int(self._rows.first_packet[until])
                    heapq.heappush(due, (begin, number, until))
                continue
            until = at + 1
            for one in self._rows.packets(at, until, bounds[number + 1]):
                heapq.heappush(due, (int(index[one]), -1, int(one)))
            if until < bounds[number + 1]:
                begin = int(self._rows.first_packet[until])
                heapq.heappush(due, (begin, number, until))
        self._pass_times(len(self._times))
        self._note_used(len(self._times))
        self._decoder.reassembler.forget_excess()
        self._decoder.note_time(int(self._block.ts_ns.max()))
        for connection, end_ns in self._ends_ns.items():
            # A stretch is read when its first packet is reached. After that, packets of other
            # connections were fed whose times may be earlier than the end of the stretch, and these
            # may have set the time of this connection back.
            connection.note_time(end_ns)
        rows = self._rows.rows(self._block, self._taken) if self._taken else None
        self.plain_rows = 0 if rows is None else len(rows.request)
        self._decoded.plain, self._decoded.records = with_decoded(
            self._block,
            self._segments,
            rows,
            self._decoded.records,
            self._connections,
            self._stretches.data,
        )
        return self._decoded

    def _take_whole_connections(self) -> Bools:
        """Read from arrays the connections that lie in the block from SYN to FIN, with nothing
        unusual.

        Returns for each flow number True if all segments of the flow were read in this way.
        """
        is_whole = np.zeros(len(self._flows.ends), np.bool_)
        passed = take_whole_connections(self._decoder, self._flows, self._headers, self._stretches)
        if passed is not None:
            is_whole[passed.flow] = True
            bounds = self._stretches.bounds
            firsts, ends = bounds[passed.stretch].tolist(), bounds[passed.stretch + 1].tolist()
            self._taken += zip(firsts, ends, passed.connections, strict=True)
            self._decoded.passed = passed
        return is_whole

    def _stretch_flows(self) -> Int64s:
        """Return the flow number of each plain stretch."""
        firsts = self._rows.first_place[self._stretches.bounds[:-1]]
        flows: Int64s = self._stretches.flows[firsts]
        return flows

    def _fed_segments(self, is_whole: Bools) -> list[tuple[int, int]]:
        """Return the segments outside of all plain stretches, which must be fed to the Decoder.

        Each item has the index of the segment's packet in the block, and the segment's own index in
        `Segments`. Flows whose number has True in `is_whole` are left out: they were read from
        arrays.
        """
        order, bounds = self._stretches.order, self._stretches.bounds
        change = np.zeros(len(order) + 1, np.int64)
        change[self._rows.first_place[bounds[:-1]]] += 1
        change[self._rows.response_place[bounds[1:] - 1] + 1] -= 1
        places = order[(np.cumsum(change[:-1]) == 0) & ~is_whole[self._stretches.flows]]
        packets = self._segments.index[places]
        return list(zip(packets.tolist(), places.tolist(), strict=True))

    def _feed(self, packet: int, place: int) -> None:
        """Feed the packet with the index `packet` in the block to the Decoder.

        `place` is the index of the packet's segment in `Segments`, or -1 if it has none there
        (IPv6, or headers that cannot be read as arrays).
        """
        if place < 0:
            behind = int(np.searchsorted(self._segments.index, packet))
            self._pass_times(behind)
            self._note_used(behind)
        else:
            self._pass_times(place)
            self._passed = place + 1
        records = self._decoder.feed(self._block.packet(packet))
        if not records:
            return
        ends = None if place < 0 else self._flows.ends[int(self._numbers[place])]
        connection = None if ends is None else self._decoder.reassembler.find(ends)
        identity = None if connection is None else connection.identity
        for record in records:
            self._decoded.records.append((2 * packet + 1, record))
            self._connections.append(identity)

    def _pass_times(self, until: int) -> None:
        """Tell the Decoder the times of those segments before the index `until` that were not fed
        to it, so that its timeouts expire as if they had been.
        """
        if self._passed >= until:
            return
        found = self._decoder.pass_times(self._latest, self._passed, until)
        self._passed = until
        for at, records in found:
            packet = int(self._segments.index[at])
            self._decoded.records += [(2 * packet, record) for record in records]
            self._connections += [None] * len(records)

    def _note_used(self, until: int) -> None:
        """Mark the connections of the segments before the index `until` as used in the reassembler,
        in the order of the segments. The reassembler drops the connection that was not used for
        longest.
        """
        newest_first = dict.fromkeys(self._numbers[self._used : until][::-1].tolist())
        self._used = max(self._used, until)
        self._decoder.reassembler.note_used(self._flows.ends[one] for one in reversed(newest_first))

    def _take(self, at: int, end: int) -> int:
        """Read the transactions with the indices `at` to `end` (exclusive) from arrays, if their
        connection is at rest: those before the first one that may belong to an earlier request.

        Returns the index behind those that were read. That is `at` if nothing was read: a request
        is pending, or bytes are missing or out of order.
        """
        rows = self._rows
        place = int(self._stretches.order[rows.first_place[at]])
        ends = self._flows.ends[int(self._numbers[place])]
        resting = self._decoder.at_rest(ends, self._times[place])
        if resting is None:
            return at
        sequences = self._segments.sequence[place], self._segments.acknowledged[place]
        if sequences != (resting.place.request_sequence, resting.place.response_sequence):
            return at
        limits = resting.decoder.limits()
        if limits is not NO_LIMITS:
            end = rows.end_within(limits, at, end)
            if end == at:
                return at
        stretch = rows.stretch(at, end)
        resting.pass_plain(stretch)
        self._ends_ns[resting.connection] = stretch.responses.last_ns
        self._taken.append((at, end, resting.connection.identity))
        return end
