"""Finds, for `check` and `report`, transactions in arrays that break no rule, without making an
object of each.
"""

# A row of the arrays is one transaction. It is quiet if it is one of the usual reads and writes
# (usual_rows.py), has the outcome OK, has a function, address and quantity that give no finding,
# and does not read holding registers of a SunSpec slave (sunspec_rows.py). For `report`, writes are
# not quiet, as it shows their values over time. Every other row is made a transaction object.

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import narrow
from mbtool.columns.block_values import BlockValues
from mbtool.columns.plain_transactions import PlainObjects
from mbtool.columns.poll_runs import PollRuns, in_turn, run_of
from mbtool.columns.sunspec_rows import SunSpecRows
from mbtool.columns.usual_values import UsualValues
from mbtool.devices.checking.connections import MAX_RECENT
from mbtool.devices.checking.quiet_run import (
    QuietConnection,
    QuietPoll,
    QuietRun,
    QuietWrite,
)
from mbtool.ledger.answered_reads import AnsweredReads, SlowRead
from mbtool.modbus.functions import (
    READ_BITS,
    READ_REGISTERS,
    READ_WRITE_REGISTERS,
    WRITE_ONE,
    WRITE_SEVERAL,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Sequence

    from mbtool.columns.arrays import Bools, Int64s, Numbers
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.poll_runs import KindsOfRows
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction, Namer
    from mbtool.ledger.answered_run import AnsweredRun

_READS = [*READ_BITS, *READ_REGISTERS - {READ_WRITE_REGISTERS}]
_WRITES = [*WRITE_ONE - {0x16}, *WRITE_SEVERAL]
FEWEST = 24
"""The fewest rows (transactions) of a QuietRows. A shorter series of quiet rows is given as
transaction objects, which is faster."""


class QuietParts:
    """Splits the transactions of each block of packets: FEWEST or more consecutive answered reads
    and writes without findings, of slaves without a profile, become a group, every other
    transaction an object.
    """

    def __init__(self, namer: Namer, *, reads_only: bool = False) -> None:
        """With `reads_only`, each write becomes an object, too."""
        self._quiet = [*_READS] if reads_only else [*_READS, *_WRITES]
        self._objects = PlainObjects(namer)
        self._sunspec = SunSpecRows()
        self._runs = PollRuns(self._objects)

    def parts(self, decoded: DecodedBlock) -> Iterator[Record | BlockRows]:
        """Yield the transactions and events of a block in the order in which packets completed
        them.

        Consecutive reads and writes without findings come together as one BlockRows, if they are at
        least FEWEST.
        """
        records = decoded.sorted_records(with_passed=True)
        self._sunspec.note(records)
        rows = decoded.plain
        if rows is None:
            yield from (record for _, record in records)
            return
        block = _QuietBlock(rows, self._objects, self._sunspec, self._runs, self._quiet)
        yield from in_turn(rows, block.is_quiet, records, block.some, block.transactions)


class _QuietBlock:
    """The transactions of a block that were read from arrays. Each has two numbers: transactions
    with equal first numbers belong to the same poll, with equal second numbers to the same
    connection.
    """

    def __init__(
        self,
        rows: PlainRows,
        objects: PlainObjects,
        sunspec: SunSpecRows,
        runs: PollRuns,
        functions: list[int],
    ) -> None:
        self._rows = rows
        self._runs = runs
        self._usual = usual = UsualValues(rows)
        self._objects = objects.of(rows, usual)
        asked = rows.code << 32 | usual.address << 16 | usual.quantity
        usual.is_usual &= ~(sunspec.find(rows, usual) | self._objects.have_profile())
        is_answered = usual.is_usual & (usual.exception < 0) & np.isin(rows.code, functions)
        self.is_quiet = self._without_findings(asked, is_answered)
        self._writes = np.flatnonzero(np.isin(rows.code, _WRITES) & self.is_quiet)
        ends = [(one.link, str(one.master), str(one.slave)) for one in rows.connections]
        self._ends = [*dict.fromkeys(ends)]
        self._connection = narrow(_numbers(ends)[rows.connection])
        link = _numbers([link for link, _, _ in ends])[rows.connection]
        self._unit = link << 8 | rows.unit
        _, kind = np.unique(asked, return_inverse=True)
        _, poll = np.unique(kind << 32 | self._unit, return_inverse=True)
        self._poll = narrow(poll)

    def transaction(self, index: int) -> NamedTransaction:
        return self._objects.one(index)

    def transactions(self, begin: int, end: int) -> Iterator[NamedTransaction]:
        return self._objects.some(begin, end)

    def some(self, begin: int, end: int) -> Iterator[BlockRows | NamedTransaction]:
        """Yield the rows (transactions) with the indices `begin` to `end` (exclusive), all of them
        quiet: as one BlockRows, or single if they are fewer than FEWEST.
        """
        if end - begin < FEWEST:
            yield from self.transactions(begin, end)
        else:
            yield BlockRows(self, begin, end)

    def run(self, begin: int, end: int) -> QuietRun:
        return QuietRun(
            [self._quiet_connection(places) for places in _alike(self._connection, begin, end)],
            lambda: [self._quiet_poll(places) for places in _alike(self._poll, begin, end)],
            lambda: self._quiet_writes(begin, end),
            self.transaction,
        )

    def answered(self, begin: int, end: int) -> AnsweredRun:
        return run_of(self._rows, self._kinds, begin, end)

    def reads(self, begin: int, end: int) -> list[AnsweredReads]:
        groups = sorted(_alike(self._poll, begin, end), key=lambda places: int(places[0]))
        return [self._answered_reads(places) for places in groups]

    def slow(self, begin: int, end: int, least_ns: int, most: int) -> Iterator[SlowRead]:
        rows = self._rows
        latency = rows.response_ns[begin:end] - rows.request_ns[begin:end]
        places = np.flatnonzero(latency >= least_ns)
        # Of equal latencies the first ones count as the longest.
        order = places[np.lexsort((places, -latency[places]))]
        groups = _alike(self._unit[begin:end][order], 0, len(order)) if len(order) else []
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

    def _answered_reads(self, places: Int64s) -> AnsweredReads:
        rows, usual, first = self._rows, self._usual, int(places[0])
        return AnsweredReads(
            rows.connections[rows.connection[first]].link,
            int(rows.unit[first]),
            int(rows.code[first]),
            int(usual.address[first]),
            int(usual.quantity[first]),
            rows.request_ns[places].tolist(),
            BlockValues(rows, usual, places),
        )

    def _without_findings(self, asked: Int64s, is_answered: Bools) -> Bools:
        places = np.flatnonzero(is_answered)
        _, first, kind = np.unique(asked[places], return_index=True, return_inverse=True)
        is_clean = [not one.findings for one in self._objects.chosen(places[first])]
        is_quiet = np.zeros(len(asked), np.bool_)
        is_quiet[places] = np.array(is_clean, np.bool_)[kind]
        return is_quiet

    def _quiet_poll(self, places: Int64s) -> QuietPoll:
        rows, usual, first = self._rows, self._usual, int(places[0])
        return QuietPoll(
            rows.connections[rows.connection[first]].link,
            int(rows.unit[first]),
            int(rows.code[first]),
            int(usual.address[first]),
            int(usual.quantity[first]),
            first,
            rows.request_ns[places].tolist(),
        )

    def _quiet_writes(self, begin: int, end: int) -> list[QuietWrite]:
        first, last = np.searchsorted(self._writes, (begin, end)).tolist()
        chosen, rows = self._writes[first:last], self._rows
        if not len(chosen):
            return []
        ends = [self._ends[one] for one in self._connection[chosen].tolist()]
        number = rows.block.first_number
        requests, responses = rows.request[chosen] + number, rows.response[chosen] + number
        packets = zip(requests.tolist(), responses.tolist(), strict=True)
        return [
            QuietWrite(source, destination, at_ns, place, both)
            for (_, source, destination), at_ns, place, both in zip(
                ends, rows.request_ns[chosen].tolist(), chosen.tolist(), packets, strict=True
            )
        ]

    def _quiet_connection(self, places: Int64s) -> QuietConnection:
        rows, last = self._rows, places[-MAX_RECENT:]
        request_ns = rows.request_ns[places]
        ids, begins, ends = (
            values[last].tolist()
            for values in (rows.transaction_id, rows.request_ns, rows.response_ns)
        )
        return QuietConnection(
            *self._ends[int(self._connection[places[0]])],
            frozenset(np.unique(rows.unit[places]).tolist()),
            int(request_ns[0]),
            int(request_ns.min()),
            int(request_ns.max()),
            int(rows.response_ns[places].max()),
            list(zip(ids, begins, ends, strict=True)),
        )


class BlockRows:
    """A BlockRows: consecutive transactions of a block, all of them answered reads and writes
    without findings. It has the methods of QuietRows (devices/checking/quiet_run.py).
    """

    def __init__(self, block: _QuietBlock, begin: int, end: int) -> None:
        self._block = block
        self._begin = begin
        self._end = end

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def row_count(self) -> int:
        """The number of transactions, for a progress bar."""
        return len(self)

    def behind(self, count: int) -> BlockRows:
        return BlockRows(self._block, min(self._begin + count, self._end), self._end)

    def transactions(self, count: int) -> Iterator[NamedTransaction]:
        return self._block.transactions(self._begin, min(self._begin + count, self._end))

    def run(self) -> QuietRun:
        """The figures about these transactions that the rules of `check` need."""
        return self._block.run(self._begin, self._end)

    def answered(self) -> AnsweredRun:
        """The transactions grouped by poll, for statistics and the inventory."""
        return self._block.answered(self._begin, self._end)

    def reads(self) -> list[AnsweredReads]:
        """The reads by poll, for charts over time. The polls are sorted by their first rows."""
        return self._block.reads(self._begin, self._end)

    def slow(self, least_ns: int, most: int) -> Iterator[SlowRead]:
        """Yield the reads that took `least_ns` or longer, in order: of each unit at most `most`,
        the longest ones.
        """
        return self._block.slow(self._begin, self._end, least_ns, most)


def _numbers(values: Sequence[Hashable]) -> Int64s:
    """Return a number for each value: equal values get equal numbers. Numbers count from 0 in the
    order in which values first appear.
    """
    known = {value: number for number, value in enumerate(dict.fromkeys(values))}
    return np.array([known[value] for value in values], np.int64)


def _alike(group: Numbers, begin: int, end: int) -> list[Int64s]:
    """Group the rows with the indices `begin` to `end` (exclusive) that have equal numbers in
    `group`.

    Returns the indices of the rows of each group. The groups are sorted by their last rows.
    """
    some = group[begin:end]
    order = np.argsort(some, kind="stable")
    cuts = np.flatnonzero(np.diff(some[order])) + 1
    groups = np.split(order + begin, cuts)
    return sorted(groups, key=lambda one: int(one[-1]))
