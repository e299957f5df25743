"""Finds, for `check` and `report`, transactions in arrays that break no rule, without making an
object of each.
"""

# A row of the arrays is one transaction. It is quiet if it is one of the usual reads and writes
# (usual_rows.py), has a function, address, quantity and exception code that give no finding, has no
# exception of a gateway, does not read holding registers of a SunSpec slave (sunspec_rows.py), and
# if no other request was open on its connection meanwhile. Every other row is made a transaction
# object.

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Groups, Int64s, Numbers, distinct, narrow
from mbtool.columns.column_decoder import DecodedBlock, result_sort_keys
from mbtool.columns.passed_connections import PassedConnections
from mbtool.columns.plain_transactions import PlainObjects
from mbtool.columns.poll_runs import BlockPolls, BlockRun, Likes
from mbtool.columns.sunspec_rows import SunSpecRows
from mbtool.columns.usual_values import UsualValues
from mbtool.core import Connection, WireEvent
from mbtool.devices.checking.connections import MAX_RECENT
from mbtool.devices.checking.quiet_run import ConnectionCounts, QuietConnection
from mbtool.ledger.answered_reads import AnsweredReads, ValueChanges
from mbtool.modbus.functions import GATEWAY_EXCEPTIONS
from mbtool.modbus.tables import ADDRESSES

if TYPE_CHECKING:
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction, Namer

# Finds in a block of a capture when the registers and bits that a poll reads or writes changed.


class BlockValues:
    """The values that the reads or writes of one poll bring. Implements ReadValues."""

    def __init__(self, rows: PlainRows, usual: UsualValues, places: Int64s) -> None:
        self._rows = rows
        self._usual = usual
        self._places = places

    def last(self) -> list[int]:
        return self._usual.values_of(self._places[-1:])

    def words(self) -> bytes:
        return self._usual.response_values(self._places).numbers.tobytes()

    def changes(
        self, before: Sequence[int] | None, place: int, *, every: bool = False
    ) -> ValueChanges:
        values = self._usual.value_of(self._places, place)
        has_changed = np.ones(len(values), np.bool_)
        has_changed[1:] = every | (values[1:] != values[:-1])
        has_changed[0] = every or before is None or values[0] != before[place]
        rows = self._places[has_changed]
        return ValueChanges(
            rows.tolist(), self._rows.response_ns[rows].tolist(), values[has_changed].tolist()
        )


class BlockReads:
    """Answered reads and writes of a block by poll, sorted by their first rows. Implements
    AnsweredValues.
    """

    def __init__(self, polls: BlockPolls, begin: int, end: int) -> None:
        """Take the rows (transactions) with the indices `begin` to `end` (exclusive)."""
        self._polls = polls
        self._rows: Int64s = np.flatnonzero(polls.usual.exception[begin:end] < 0) + begin
        number = polls.poll[self._rows]
        if polls.has_masters:
            of_slaves = polls.unit[self._rows] << 48 | polls.asked[self._rows]
            _, number = np.unique(of_slaves, return_inverse=True)
        self._groups = Groups(number)
        self._by_first = np.argsort(self._groups.first)

    def __len__(self) -> int:
        return len(self._by_first)

    @cached_property
    def asked(self) -> list[tuple[str, int, int, int, int]]:
        names = self._polls.names
        first = self._rows[self._groups.first[self._by_first]]
        found = [names[one] for one in self._polls.poll[first].tolist()]
        return [
            (link, unit, code, address, quantity)
            for link, _, unit, code, _, address, quantity, _, _ in found
        ]

    def __getitem__(self, index: int) -> AnsweredReads:
        groups, one = self._groups, self._by_first[index]
        rows = self._rows[groups.order[groups.starts[one] : groups.ends[one]]]
        return AnsweredReads(
            self._polls.rows.request_ns[rows].tolist(),
            BlockValues(self._polls.rows, self._polls.usual, rows),
        )


_EVENT, _RECORD, _ROW = range(3)
_FIRST = itemgetter(0)
FEWEST = 24
"""The fewest rows (transactions) of a QuietRows. A shorter series of quiet rows is given as
transaction objects, which is faster."""


MOST = 2048
"""The most rows of a QuietRows that may have events, so that the rules have room for their
connections."""


class QuietParts:
    """Splits the transactions of each block of packets: FEWEST or more consecutive answered reads
    and writes without findings, of slaves without a profile, become a group, every other
    transaction an object. A group has the openings and closings among its transactions, too, of the
    connections that were read from arrays as a whole.
    """

    def __init__(self, namer: Namer) -> None:
        self._objects = PlainObjects(namer)
        self._sunspec = SunSpecRows()
        self._likes: Likes = {}

    def parts(self, decoded: DecodedBlock) -> Iterator[Record | BlockRows]:
        """Yield the transactions and events of a block in the order in which packets completed
        them.

        Consecutive reads and writes without findings come together as one BlockRows, if they are at
        least FEWEST.
        """
        # A slave with a profile may have rules about connections, which need every event.
        passed = None if any(self._objects.namer.assignments) else decoded.passed
        records = decoded.sorted_records(with_passed=passed is None)
        self._sunspec.note(records)
        rows = decoded.plain
        if rows is None:
            yield from (record for _, record in records)
            return
        block = _QuietBlock(rows, self._objects, self._sunspec, self._likes)
        yield from block.parts(records, passed)


class _QuietBlock:
    """The transactions of a block that were read from arrays.

    An item is a transaction (a row), an event of a connection that was read as a whole, or a record
    of the Decoder; items are in the order in which packets completed them.
    """

    def __init__(
        self,
        rows: PlainRows,
        objects: PlainObjects,
        sunspec: SunSpecRows,
        likes: Likes,
    ) -> None:
        self._rows = rows
        self._usual = usual = UsualValues(rows)
        self._objects = objects.of(rows, usual)
        usual.is_usual &= ~(sunspec.find(rows, usual) | self._objects.have_profile())
        is_apart = np.isin(usual.exception, [*GATEWAY_EXCEPTIONS])
        self._polls = BlockPolls(rows, usual, self._objects, likes)
        self._connection = narrow(self._polls.connection)
        self._is_quiet = self._without_findings(usual.is_usual & ~is_apart)
        self._is_quiet &= ~_overlap(rows, self._connection)
        self._row_items = self._rows_before = self._events_before = np.zeros(0, np.int64)
        """The item of each row; for each item, the number of rows (events) before it."""
        self._events = _no_events()

    def parts(
        self, records: list[tuple[int, Record]], passed: PassedConnections | None
    ) -> Iterator[Record | BlockRows]:
        """Yield the items in order; FEWEST or more quiet rows, and the events among them, as one
        BlockRows. `records` are those of the Decoder, `passed` the connections whose events are
        items.
        """
        if passed is not None:
            self._events = _connection_events(passed, self._polls.known)
        events, rows = self._events, self._rows
        keys = np.concatenate([
            events.key, np.array([key for key, _ in records], np.int64),
            result_sort_keys(rows.response),
        ])  # fmt: skip
        order = np.argsort(keys, kind="stable")
        sizes = [len(events.key), len(records), len(rows.response)]
        of_kind = np.repeat(np.arange(3), sizes)[order]
        self._row_items = np.flatnonzero(of_kind == _ROW)
        self._rows_before = _counts_before(of_kind == _ROW)
        self._events_before = _counts_before(of_kind == _EVENT)
        is_together = of_kind == _EVENT
        is_together[self._row_items] = self._is_quiet
        cuts = np.flatnonzero(is_together[1:] != is_together[:-1]) + 1
        records_before = _counts_before(of_kind == _RECORD).tolist()
        for begin, end in pairwise([0, *cuts.tolist(), len(order)]):
            if is_together[begin]:
                yield from self._rows_or_items(begin, end)
                continue
            at = begin
            for number in range(records_before[begin], records_before[end]):
                place = records_before.index(number + 1, at) - 1
                yield from self.items(at, place)
                yield records[number][1]
                at = place + 1
            yield from self.items(at, end)

    def _rows_or_items(self, begin: int, end: int) -> Iterator[BlockRows | Record]:
        """Yield quiet items together, or single if too few of them are rows."""
        first, last = self._rows_before[[begin, end]].tolist()
        if last - first < FEWEST:
            yield from self.items(begin, end)
            return
        has_events = end - begin > last - first
        while has_events and last - first > MOST:
            first += MOST
            middle = int(self._row_items[first])
            yield BlockRows(self, begin, middle)
            begin = middle
        yield BlockRows(self, begin, end)

    def items(self, begin: int, end: int) -> Iterator[Record]:
        """Yield the items with the indices `begin` to `end` (exclusive), none of them a record of
        the Decoder: transactions and events.
        """
        first, last = self._rows_before[[begin, end]].tolist()
        event, until = self._events_before[[begin, end]].tolist()
        if event == until:
            yield from self.transactions(first, last)
            return
        rows_before = self._rows_before
        items = np.flatnonzero(np.diff(rows_before[begin : end + 1]) == 0) + begin
        for item, number in zip(items.tolist(), range(event, until), strict=True):
            row = int(rows_before[item])
            yield from self.transactions(first, row)
            yield self._events.make(number)
            first = row
        yield from self.transactions(first, last)

    def rows_of(self, begin: int, end: int) -> tuple[int, int]:
        """Return the index of the first row of the items, and that behind the last one."""
        first, last = self._rows_before[[begin, end]].tolist()
        return first, last

    def behind(self, begin: int, end: int, count: int) -> int:
        """Return the index behind the first `count` rows of the items; `end` for all of them."""
        first, last = self.rows_of(begin, end)
        return end if first + count >= last else int(self._row_items[first + count])

    def chosen(self, indices: Int64s) -> Iterator[NamedTransaction]:
        return self._objects.chosen(indices)

    def transactions(self, begin: int, end: int) -> Iterator[NamedTransaction]:
        return self._objects.some(begin, end)

    def run(self, begin: int, end: int) -> BlockRun:
        """Return the figures about items, all of them quiet rows and events."""
        event, until = self._events_before[[begin, end]].tolist()
        return BlockRun(
            self._polls,
            *self.rows_of(begin, end),
            self._quiet_connections(begin, end),
            self._opened_and_closed(event, until),
            self._events.last_ns(event, until),
        )

    def reads(self, begin: int, end: int) -> BlockReads:
        return BlockReads(self._polls, begin, end)

    def _without_findings(self, is_answered: Bools) -> Bools:
        """Return for each answered row True if it gives no finding. Without a profile, that depends
        on its function, its quantity, its exception code, and on its last address being possible.
        """
        rows, usual, places = self._rows, self._usual, np.flatnonzero(is_answered)
        is_beyond = usual.address + usual.quantity > ADDRESSES
        form = (
            usual.exception + 1 << 40
            | rows.code << 32
            | is_beyond.astype(np.int64) << 16
            | usual.quantity
        )
        _, first, kind = np.unique(form[places], return_index=True, return_inverse=True)
        is_clean = [not one.findings for one in self._objects.chosen(places[first])]
        is_quiet = np.zeros(len(form), np.bool_)
        is_quiet[places] = np.array(is_clean, np.bool_)[kind]
        return is_quiet

    def _quiet_connections(self, begin: int, end: int) -> list[QuietConnection]:
        """Return the connections of items, in the order of their last requests or openings."""
        rows, (first, last) = self._rows, self.rows_of(begin, end)
        number = self._connection[first:last]
        order = np.argsort(number, kind="stable")
        number = number[order]
        starts = np.flatnonzero(np.append(True, number[1:] != number[:-1]))
        ends = np.append(starts[1:], len(order))
        order += first
        numbers = self._connection[order[starts]].tolist()
        request_ns, response_ns = rows.request_ns[order], rows.response_ns[order]
        behind = np.repeat(ends, ends - starts) - np.arange(len(order))
        kept = order[behind <= MAX_RECENT]
        recent = [*zip(
            rows.transaction_id[kept].tolist(), rows.request_ns[kept].tolist(),
            rows.response_ns[kept].tolist(), strict=True,
        )]  # fmt: skip
        bounds = [0, *np.cumsum(np.minimum(ends - starts, MAX_RECENT)).tolist()]
        unit, of_unit = rows.unit[order], np.repeat(np.arange(len(starts)), ends - starts)
        units: list[set[int]] = [set() for _ in numbers]
        for both in distinct(of_unit << 8 | unit):
            units[both >> 8].add(both & 0xFF)
        opened = self._events.opened(*self._events_before[[begin, end]].tolist())
        found = []
        for one, item, some, first_ns, least_ns, request, response, (at, until) in zip(
            numbers,
            self._row_items[order[ends - 1]].tolist(),
            units,
            request_ns[starts].tolist(),
            np.minimum.reduceat(request_ns, starts).tolist(),
            np.maximum.reduceat(request_ns, starts).tolist(),
            np.maximum.reduceat(response_ns, starts).tolist(),
            pairwise(bounds),
            strict=True,
        ):
            link, master, slave = self._polls.ends[int(one)]
            _, opened_ns = opened.pop(one, (0, None))
            connection = QuietConnection(
                link, master, slave, frozenset(some), first_ns, least_ns, request, response,
                recent[at:until], opened_ns,
            )  # fmt: skip
            found.append((item, connection))
        for one, (number_, at_ns) in opened.items():  # The rows of these come later.
            item = int(np.searchsorted(self._events_before, number_, side="right")) - 1
            none = QuietConnection(
                *self._polls.ends[one], frozenset(), at_ns, at_ns, 0, 0, [], at_ns
            )
            found.append((item, none))
        return [one for _, one in sorted(found, key=_FIRST)]

    def _opened_and_closed(self, event: int, until: int) -> list[ConnectionCounts]:
        """Count the openings and closings with the numbers `event` to `until` (exclusive)."""
        events = self._events
        numbers = events.connection[event:until]
        pairs = self._polls.link_host[numbers]
        found = []
        for pair in distinct(pairs):
            places = np.flatnonzero(pairs == pair)
            steps = np.where(events.opens[event:until][places], 1, -1)
            opened = places[steps > 0] + event
            one = int(numbers[places[0]])
            found.append(ConnectionCounts(
                self._polls.ends[one][0], self._polls.hosts[one],
                len(opened), len(places) - len(opened),
                max(int(np.cumsum(steps).max()), 0),
                int(events.ts_ns[opened[0]]) if len(opened) else None,
            ))  # fmt: skip
        return found


@dataclass(slots=True)
class _ConnectionEvents:
    """The openings and closings of connections that were read from arrays as a whole, in order."""

    key: Int64s
    """The sort key among the results of the block (`result_sort_keys`)."""
    ts_ns: Int64s
    connection: Int64s
    """The number of the connection."""
    opens: Bools
    place: Int64s
    """The index of the connection in `passed`."""
    passed: PassedConnections | None

    def make(self, number: int) -> WireEvent:
        assert self.passed is not None
        place = int(self.place[number])
        return self.passed.opening(place) if self.opens[number] else self.passed.closing(place)

    def last_ns(self, begin: int, end: int) -> int:
        """Return the latest time of some events; 0 if there are none."""
        return int(self.ts_ns[begin:end].max(initial=0))

    def opened(self, begin: int, end: int) -> dict[int, tuple[int, int]]:
        """Return the connections that some events open: the number of the event, and its time."""
        opens = np.flatnonzero(self.opens[begin:end]) + begin
        return {
            one: (number, at_ns)
            for one, number, at_ns in zip(
                self.connection[opens].tolist(),
                opens.tolist(),
                self.ts_ns[opens].tolist(),
                strict=True,
            )
        }


def _no_events() -> _ConnectionEvents:
    none = np.zeros(0, np.int64)
    return _ConnectionEvents(none, none, none, np.zeros(0, np.bool_), none, None)


def _connection_events(
    passed: PassedConnections, numbers: Mapping[Connection, int]
) -> _ConnectionEvents:
    """Return the events of `passed`; `numbers` has the number of each connection."""
    number = np.array([numbers[one] for one in passed.connections], np.int64)
    key = result_sort_keys(np.concatenate([passed.opened, passed.closed]))
    order = np.argsort(key, kind="stable")
    half = len(number)
    return _ConnectionEvents(
        key=key[order],
        ts_ns=np.concatenate([passed.opened_ns, passed.closed_ns])[order],
        connection=np.concatenate([number, number])[order],
        opens=order < half,
        place=order % half,
        passed=passed,
    )


def _overlap(rows: PlainRows, connection: Numbers) -> Bools:
    """Return for each row True if another request was open on its connection meanwhile."""
    found = np.zeros(len(connection), np.bool_)
    order = np.lexsort((rows.request_ns, connection))
    is_same = connection[order[1:]] == connection[order[:-1]]
    both = is_same & (rows.request_ns[order[1:]] < rows.response_ns[order[:-1]])
    found[order[1:][both]] = found[order[:-1][both]] = True
    return found


def _counts_before(is_one: Bools) -> Int64s:
    """Return for each item how many items before it are of a kind; then how many are in all."""
    before: Int64s = np.concatenate([[0], np.cumsum(is_one)]).astype(np.int64)
    return before


class BlockRows:
    """A BlockRows: consecutive transactions of a block, all of them answered reads and writes
    without findings, with the openings and closings of connections among them. It has the methods
    of QuietRows (devices/checking/quiet_run.py).
    """

    def __init__(self, block: _QuietBlock, begin: int, end: int) -> None:
        """Take the items of a block with the indices `begin` to `end` (exclusive)."""
        self._block = block
        self._begin = begin
        self._end = end
        self._rows = block.rows_of(begin, end)

    def __len__(self) -> int:
        return self._rows[1] - self._rows[0]

    @property
    def row_count(self) -> int:
        """The number of transactions, for a progress bar."""
        return len(self)

    def behind(self, count: int) -> BlockRows:
        middle = self._block.behind(self._begin, self._end, count)
        return BlockRows(self._block, middle, self._end)

    def transactions(self, count: int) -> Iterator[NamedTransaction]:
        first, last = self._rows
        return self._block.transactions(first, min(first + count, last))

    def chosen(self, places: list[int]) -> Iterator[NamedTransaction]:
        """Yield the transactions at these indices."""
        return self._block.chosen(np.array(places, np.int64) + self._rows[0])

    def records(self, count: int) -> Iterator[Record]:
        return self._block.items(self._begin, self._block.behind(self._begin, self._end, count))

    @cached_property
    def run(self) -> BlockRun:
        """The figures about these transactions, for rules, account and troubles."""
        return self._block.run(self._begin, self._end)

    @cached_property
    def reads(self) -> BlockReads:
        """The values of the answered reads and writes, by poll."""
        return self._block.reads(*self._rows)
