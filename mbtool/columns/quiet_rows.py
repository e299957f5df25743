"""Finds, for `check` and `report`, transactions in arrays that break no rule, without making an
object of each.
"""

# A row of the arrays is one transaction. It is quiet if it is one of the usual reads and writes
# (usual_rows.py), has a function, address, quantity and exception code that give no finding, has no
# exception of a gateway, does not read holding registers of a SunSpec slave (sunspec_rows.py), and
# if no other request was open on its connection meanwhile. Every other row is made a transaction
# object.

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import pairwise
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from mbtool.columns.arrays import Bools, Groups, Int64s, distinct, narrow
from mbtool.columns.column_decoder import order_of
from mbtool.columns.passed_connections import PassedConnections
from mbtool.columns.plain_transactions import PlainObjects
from mbtool.columns.poll_runs import PollRuns, run_of
from mbtool.columns.sunspec_rows import SunSpecRows
from mbtool.columns.usual_values import UsualValues
from mbtool.devices.checking.connections import MAX_RECENT
from mbtool.devices.checking.quiet_run import (
    QuietConnection,
    QuietPoll,
    QuietRequest,
    QuietRun,
)
from mbtool.ledger.answered_reads import AnsweredReads, SlowRead, ValueChanges
from mbtool.ledger.answered_run import ConnectionCounts
from mbtool.modbus.functions import (
    GATEWAY_EXCEPTIONS,
    WRITE_ONE,
    WRITE_SEVERAL,
)
from mbtool.modbus.tables import ADDRESSES

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping, Sequence

    from mbtool.columns.arrays import Numbers
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.poll_runs import KindsOfRows
    from mbtool.core import Connection, WireEvent
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction, Namer
    from mbtool.ledger.answered_run import AnsweredRun

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

    def changes(self, before: Sequence[int] | None, place: int) -> ValueChanges:
        values = self._usual.value_of(self._places, place)
        has_changed = np.ones(len(values), np.bool_)
        has_changed[1:] = values[1:] != values[:-1]
        has_changed[0] = before is None or values[0] != before[place]
        rows = self._places[has_changed]
        return ValueChanges(
            rows.tolist(), self._rows.response_ns[rows].tolist(), values[has_changed].tolist()
        )


_WRITES = [*WRITE_ONE - {0x16}, *WRITE_SEVERAL]
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

    def __init__(self, namer: Namer, *, exceptions: bool = True) -> None:
        """Without `exceptions`, a transaction whose response is an exception is an object."""
        self._exceptions = exceptions
        self._objects = PlainObjects(namer)
        self._sunspec = SunSpecRows()
        self._runs = PollRuns(self._objects)

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
        block = _QuietBlock(
            rows, self._objects, self._sunspec, self._runs, exceptions=self._exceptions
        )
        yield from block.parts(records, passed)


class _QuietBlock:
    """The transactions of a block that were read from arrays. Each has two numbers: transactions
    with equal first numbers belong to the same poll, with equal second numbers to the same
    connection.

    An item is a transaction (a row), an event of a connection that was read as a whole, or a record
    of the Decoder; items are in the order in which packets completed them.
    """

    def __init__(
        self,
        rows: PlainRows,
        objects: PlainObjects,
        sunspec: SunSpecRows,
        runs: PollRuns,
        *,
        exceptions: bool,
    ) -> None:
        self._rows = rows
        self._runs = runs
        self._usual = usual = UsualValues(rows)
        self._objects = objects.of(rows, usual)
        asked = rows.code << 32 | usual.address << 16 | usual.quantity
        usual.is_usual &= ~(sunspec.find(rows, usual) | self._objects.have_profile())
        is_apart = np.isin(usual.exception, [*GATEWAY_EXCEPTIONS]) if exceptions else (
            usual.exception >= 0
        )  # fmt: skip
        self._is_quiet = self._without_findings(usual.is_usual & ~is_apart)
        known = {one: number for number, one in enumerate(dict.fromkeys(rows.connections))}
        self._ends = [(one.link, str(one.master), str(one.slave)) for one in known]
        self._hosts = [one.master.host for one in known]
        numbers = np.array([known[one] for one in rows.connections], np.int64)
        self._connection = narrow(numbers[rows.connection])
        self._is_quiet &= ~_overlap(rows, self._connection)
        self._writes = np.flatnonzero(np.isin(rows.code, _WRITES) & self._is_quiet)
        link = _numbers([link for link, _, _ in self._ends])
        self._link_host = _numbers([*zip(link.tolist(), self._hosts, strict=True)])
        self._unit = link[self._connection] << 8 | rows.unit
        _, kind = np.unique(asked, return_inverse=True)
        _, poll = np.unique(kind << 32 | self._unit, return_inverse=True)
        self._poll = narrow(poll)
        self._master_poll = self._poll
        """By row, the number of its poll, where equal requests of two masters are two polls."""
        if self._link_host.max(initial=0) > link.max(initial=0):
            of_masters = self._link_host[self._connection] << 8 | rows.unit
            _, poll = np.unique(kind << 32 | of_masters, return_inverse=True)
            self._master_poll = narrow(poll)
        self._known = known
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
            self._events = _connection_events(passed, self._known)
        events, rows = self._events, self._rows
        keys = np.concatenate([
            events.key, np.array([key for key, _ in records], np.int64), order_of(rows.response),
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

    def transaction(self, index: int) -> NamedTransaction:
        return self._objects.transaction_of_row(index)

    def chosen(self, indices: Int64s) -> Iterator[NamedTransaction]:
        return self._objects.chosen(indices)

    def transactions(self, begin: int, end: int) -> Iterator[NamedTransaction]:
        return self._objects.some(begin, end)

    def run(self, begin: int, end: int) -> QuietRun:
        """Return the figures about items, all of them quiet rows and events."""
        first, last = self.rows_of(begin, end)
        polls = cache(partial(self._quiet_polls, first, last))
        return QuietRun(
            self._quiet_connections(begin, end),
            lambda: polls()[0],
            lambda: self._quiet_requests(self._writes_of(first, last), first, polls()[1]),
            lambda: self._quiet_requests(np.arange(first, last), first, polls()[1]),
            self._head,
            self._events.last_ns(*self._events_before[[begin, end]].tolist()),
            has_exceptions=bool((self._usual.exception[first:last] >= 0).any()),
        )

    def answered(self, begin: int, end: int) -> AnsweredRun:
        """Return items, all of them quiet rows and events, grouped by poll."""
        found = run_of(self._rows, self._kinds, *self.rows_of(begin, end))
        event, until = self._events_before[[begin, end]].tolist()
        if event < until:
            found.connections = self._opened_and_closed(event, until)
        return found

    def reads(self, begin: int, end: int) -> list[AnsweredReads]:
        rows, usual, groups = self._rows, self._usual, Groups(self._poll[begin:end])
        by_first = np.argsort(groups.first)
        order = groups.order + begin
        first = order[groups.starts[by_first]]
        times = rows.request_ns[order].tolist()
        links = [rows.connections[one].link for one in rows.connection[first].tolist()]
        fields = (rows.unit, rows.code, usual.address, usual.quantity)
        return [
            AnsweredReads(
                link,
                unit,
                code,
                address,
                quantity,
                times[at:until],
                BlockValues(rows, usual, order[at:until]),
            )
            for link, unit, code, address, quantity, at, until in zip(
                links,
                *(each[first].tolist() for each in fields),
                groups.starts[by_first].tolist(),
                groups.ends[by_first].tolist(),
                strict=True,
            )
        ]

    def slow(self, begin: int, end: int, least_ns: int, most: int) -> Iterator[SlowRead]:
        rows = self._rows
        latency = rows.response_ns[begin:end] - rows.request_ns[begin:end]
        places = np.flatnonzero(latency >= least_ns)
        # Among equal latencies, the earlier ones count as longer.
        order = places[np.lexsort((places, -latency[places]))]
        groups = _rows_by_number(self._unit[begin:end][order], 0, len(order)) if len(order) else []
        longest = [order[np.sort(group)[:most]] for group in groups]
        for place in sorted(one for group in longest for one in group.tolist()):
            index = begin + place
            yield SlowRead(
                place,
                rows.connections[rows.connection[index]].link,
                int(rows.unit[index]),
                int(latency[place]),
                partial(self.transaction, index),
            )

    @cached_property
    def _kinds(self) -> KindsOfRows:
        return self._runs.kinds_of(self._rows, self._usual)

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

    def _head(self, index: int) -> NamedTransaction:
        """Return the transaction of a row with the values and bytes of an equal request."""
        rows, kinds, number = self._rows, self._kinds, self._rows.block.first_number
        begin_ns, end_ns = rows.request_ns.item(index), rows.response_ns.item(index)
        return structs.replace(
            kinds.likes[kinds.kind.item(index)],
            file=rows.block.file,
            source=self._ends[self._connection.item(index)][1],
            transaction_id=rows.transaction_id.item(index),
            request_ns=begin_ns,
            response_ns=end_ns,
            latency_ns=end_ns - begin_ns,
            request_packet=number + rows.request.item(index),
            response_packet=number + rows.response.item(index),
        )

    def _quiet_polls(self, begin: int, end: int) -> tuple[list[QuietPoll], Int64s]:
        """Return the polls of rows, sorted by their last rows; and the index of each row's poll."""
        rows, usual = self._rows, self._usual
        groups = Groups(self._master_poll[begin:end])
        by_last = np.argsort(groups.last)
        first = (groups.first + begin)[by_last]
        times = rows.request_ns[begin:end][groups.order].tolist()
        bounds = zip(groups.starts[by_last].tolist(), groups.ends[by_last].tolist(), strict=True)
        fields = zip(
            [self._ends[one][0] for one in self._connection[first].tolist()],
            [self._hosts[one] for one in self._connection[first].tolist()],
            rows.unit[first].tolist(),
            rows.code[first].tolist(),
            usual.address[first].tolist(),
            usual.quantity[first].tolist(),
            first.tolist(),
            [times[start:stop] for start, stop in bounds],
            strict=True,
        )
        polls = [*map(QuietPoll._make, fields)]  # Faster than calling QuietPoll.
        number = np.empty(len(first), np.int64)
        number[by_last] = np.arange(len(first))
        return polls, number[groups.number]

    def _writes_of(self, begin: int, end: int) -> Int64s:
        first, last = np.searchsorted(self._writes, (begin, end)).tolist()
        return self._writes[first:last]

    def _quiet_requests(self, chosen: Int64s, begin: int, polls: Int64s) -> list[QuietRequest]:
        """Return the requests of the chosen rows; `polls` has the index of the poll of each row
        from `begin` on.
        """
        rows, number = self._rows, self._rows.block.first_number
        ends = [self._ends[one] for one in self._connection[chosen].tolist()]
        requests, responses = rows.request[chosen] + number, rows.response[chosen] + number
        fields = zip(
            polls[chosen - begin].tolist(),
            [source for _, source, _ in ends],
            [destination for _, _, destination in ends],
            rows.request_ns[chosen].tolist(),
            chosen.tolist(),
            zip(requests.tolist(), responses.tolist(), strict=True),
            self._usual.exception[chosen].tolist(),
            strict=True,
        )
        return [*map(QuietRequest._make, fields)]

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
            link, master, slave = self._ends[int(one)]
            _, opened_ns = opened.pop(one, (0, None))
            connection = QuietConnection(
                link, master, slave, frozenset(some), first_ns, least_ns, request, response,
                recent[at:until], opened_ns,
            )  # fmt: skip
            found.append((item, connection))
        for one, (number_, at_ns) in opened.items():  # The rows of these come later.
            item = int(np.searchsorted(self._events_before, number_, side="right")) - 1
            none = QuietConnection(*self._ends[one], frozenset(), at_ns, at_ns, 0, 0, [], at_ns)
            found.append((item, none))
        return [one for _, one in sorted(found, key=_FIRST)]

    def _opened_and_closed(self, event: int, until: int) -> list[ConnectionCounts]:
        """Count the openings and closings with the numbers `event` to `until` (exclusive)."""
        events = self._events
        numbers = events.connection[event:until]
        pairs = self._link_host[numbers]
        found = []
        for pair in distinct(pairs):
            places = np.flatnonzero(pairs == pair)
            steps = np.where(events.opens[event:until][places], 1, -1)
            opened = places[steps > 0] + event
            one = int(numbers[places[0]])
            found.append(ConnectionCounts(
                self._ends[one][0], self._hosts[one], len(opened), len(places) - len(opened),
                max(int(np.cumsum(steps).max()), 0),
                int(events.ts_ns[opened[0]]) if len(opened) else None,
            ))  # fmt: skip
        return found


@dataclass(slots=True)
class _ConnectionEvents:
    """The openings and closings of connections that were read from arrays as a whole, in order."""

    key: Int64s
    """The sort key among the results of the block (`order_of`)."""
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
    key = order_of(np.concatenate([passed.opened, passed.closed]))
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

    def run(self) -> QuietRun:
        """The figures about these transactions that the rules of `check` need."""
        return self._block.run(self._begin, self._end)

    def answered(self) -> AnsweredRun:
        """The transactions grouped by poll, for statistics and the inventory."""
        return self._block.answered(self._begin, self._end)

    def reads(self) -> list[AnsweredReads]:
        """The reads by poll, for charts over time. The polls are sorted by their first rows."""
        return self._block.reads(*self._rows)

    def slow(self, least_ns: int, most: int) -> Iterator[SlowRead]:
        """Yield the reads that took `least_ns` or longer, in order: of each unit at most `most`,
        the longest ones.
        """
        return self._block.slow(*self._rows, least_ns, most)


def _numbers(values: Sequence[Hashable]) -> Int64s:
    """Return a number for each value: equal values get equal numbers. Numbers count from 0 in the
    order in which values first appear.
    """
    known = {value: number for number, value in enumerate(dict.fromkeys(values))}
    return np.array([known[value] for value in values], np.int64)


def _rows_by_number(group: Numbers, begin: int, end: int) -> list[Int64s]:
    """Group the rows with the indices `begin` to `end` (exclusive) that have equal numbers in
    `group`.

    Returns the indices of the rows of each group. The groups are sorted by their last rows.
    """
    groups = Groups(group[begin:end])
    found = np.split(groups.order + begin, groups.starts[1:])
    return [found[one] for one in np.argsort(groups.last).tolist()]
