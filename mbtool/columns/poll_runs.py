"""Groups equal polls among the transactions in arrays, for the statistics and the inventory,
without making an object of each.
"""

# Only the usual reads and writes (usual_rows.py) are grouped. Two transactions are of one kind if
# they have the same link, master address (without port), slave and MAC addresses, and if their PDUs
# have the same unit, function, address, quantity and exception code. Only the first transaction of
# each kind is made an object with names, as the Decoder makes it. It stands for all of its kind.
#
# Memory: about MAX_KINDS such objects are kept between blocks. If there are more, all are forgotten
# and made again when needed.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from mbtool.columns.arrays import narrow
from mbtool.columns.column_decoder import order_of
from mbtool.columns.plain_transactions import origin_fields, plain_transaction
from mbtool.columns.sunspec_rows import SunSpecRows
from mbtool.columns.usual_rows import UsualRows
from mbtool.devices import Namer
from mbtool.ledger.answered_run import AlikeRequests, AnsweredRun

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mbtool.columns.arrays import Bools, Int64s
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction

Part = TypeVar("Part")

MAX_KINDS = 65_536
_SHORT = 24
"""If fewer usual reads and writes than this follow one another, they are given as single
transactions, which is faster than as an AnsweredRun."""

_Place = tuple[str, str, str, str | None, str | None]
"""Link name, IP address of the master, address and port of the slave, MAC address of the master,
MAC address of the slave (None if unknown)."""


class KindsOfRows(NamedTuple):
    """Tells which rows (transactions) of a block are requests of the same poll."""

    likes: list[NamedTransaction]
    """An example transaction of each kind of poll, from this block or an earlier one."""
    kind: Int64s
    """For each row, the index of its kind; meaningless for a row that is no usual read or write.
    """


class PollRuns:
    """Groups the usual reads and writes of each block: consecutive ones become an AnsweredRun,
    which counts equal polls together.

    For a capture that is decoded without device profiles.
    """

    def __init__(self) -> None:
        self._namer = Namer()
        self._sunspec = SunSpecRows()
        self._kinds: dict[tuple[_Place, int], NamedTransaction] = {}

    def parts(self, decoded: DecodedBlock) -> Iterator[Record | AnsweredRun]:
        """Yield the transactions and events of a block in the order in which packets completed
        them.

        Consecutive usual reads and writes come together as one AnsweredRun, if they are at least
        _SHORT.
        """
        records = decoded.sorted_records(with_passed=True)
        self._sunspec.note(records)
        rows = decoded.plain
        if rows is None:
            yield from (record for _, record in records)
            return
        usual = UsualRows(rows)
        usual.is_usual &= ~self._sunspec.find(rows, usual)
        kinds = self.kinds_of(rows, usual)
        yield from in_turn(
            rows,
            usual.is_usual,
            records,
            lambda begin, end: self._run(rows, kinds, begin, end),
            lambda index: self._named(rows, index),
        )

    def _named(self, rows: PlainRows, index: int) -> NamedTransaction:
        return self._namer.name(plain_transaction(rows, index))

    def kinds_of(self, rows: PlainRows, usual: UsualRows) -> KindsOfRows:
        """Return an example transaction of each kind of poll in the block, and for each row the
        index of its kind among these examples.

        The index of a row that is no usual read or write is meaningless.
        """
        if len(self._kinds) > MAX_KINDS:
            self._kinds.clear()
        places = _places(rows)
        numbers: dict[_Place, int] = {}
        place_of = np.array([numbers.setdefault(place, len(numbers)) for place in places])
        asked = usual.asked
        asked[~usual.is_usual] = -1
        distinct, like = np.unique(asked, return_inverse=True)
        _, first, kind = np.unique(
            narrow(place_of[rows.connection] * len(distinct) + like),
            return_index=True,
            return_inverse=True,
        )
        likes = []
        for index in first.tolist():
            key = places[int(rows.connection[index])], int(asked[index])
            if key not in self._kinds:
                self._kinds[key] = self._named(rows, index)
            likes.append(self._kinds[key])
        return KindsOfRows(likes, kind)

    def _run(
        self, rows: PlainRows, kinds: KindsOfRows, begin: int, end: int
    ) -> Iterator[AnsweredRun | NamedTransaction]:
        """Yield the rows with the indices `begin` to `end` (exclusive), all of them usual reads
        and writes, as one AnsweredRun; as single transactions if they are fewer than _SHORT.
        """
        run = run_of(rows, kinds, begin, end)
        if end - begin < _SHORT:
            yield from run.transactions()
        else:
            yield run


def _places(rows: PlainRows) -> list[_Place]:
    """Return for each item of `rows.connections` its link, IP and MAC addresses (_Place)."""
    return [
        (one.link, one.master.host, str(one.slave), *origin_fields(*addresses)[:2])
        for one, addresses in zip(rows.connections, rows.addresses, strict=True)
    ]


def in_turn(
    rows: PlainRows,
    is_usual: Bools,
    records: list[tuple[int, Record]],
    make_run: Callable[[int, int], Iterable[Part]],
    make_single: Callable[[int], Record],
) -> Iterator[Record | Part]:
    """Yield the transactions and events of a block in the order in which packets completed them.

    `records` are those that the Decoder made. A row is a transaction that was read from arrays.
    `make_run(begin, end)` makes the items for the rows with the indices `begin` to `end`
    (exclusive), for all of which `is_usual` is True; `make_single(index)` makes the item for any
    other row.
    """
    begin = 0
    for end, record in _between(rows, is_usual, records):
        if begin < end:
            yield from make_run(begin, end)
        begin = end
        if record is None:
            yield make_single(end)
            begin += 1
        else:
            yield record
    if begin < len(is_usual):
        yield from make_run(begin, len(is_usual))


def _between(
    rows: PlainRows, is_usual: Bools, records: list[tuple[int, Record]]
) -> list[tuple[int, Record | None]]:
    """Return, in order, what stands between the rows for which `is_usual` is True: the Decoder's
    `records`, and the other rows.

    An item is one of two pairs: a record, after the index of the row before which it was completed;
    or None, after the index of a row for which `is_usual` is False.
    """
    places = np.searchsorted(order_of(rows.response), [place for place, _ in records]).tolist()
    found: list[tuple[int, Record | None]] = [
        (place, record) for place, (_, record) in zip(places, records, strict=True)
    ]
    found += [(index, None) for index in np.flatnonzero(~is_usual).tolist()]
    return sorted(found, key=lambda one: (one[0], one[1] is None))


def run_of(rows: PlainRows, kinds: KindsOfRows, begin: int, end: int) -> AnsweredRun:
    """Return the rows with the indices `begin` to `end` (exclusive), all of them usual reads and
    writes, as one AnsweredRun.
    """
    some = slice(begin, end)
    request_ns, response_ns = rows.request_ns[some], rows.response_ns[some]
    found, first, local = np.unique(
        narrow(kinds.kind[some]), return_index=True, return_inverse=True
    )
    by_first = np.argsort(first)
    number = np.empty(len(found), np.int64)
    number[by_first] = np.arange(len(found))
    local = number[local]
    order = np.argsort(narrow(local), kind="stable")
    counts = np.bincount(local)
    ends = np.cumsum(counts)
    starts = ends - counts
    latencies = (response_ns - request_ns)[order].tolist()
    times = request_ns[order].tolist()
    first_ns = np.minimum.reduceat(request_ns[order], starts)
    last_ns = np.maximum.reduceat(response_ns[order], starts)
    alike = [
        AlikeRequests(
            kinds.likes[which],
            stop - start,
            begin_ns,
            end_ns,
            times[start:stop],
            latencies[start:stop],
        )
        for which, start, stop, begin_ns, end_ns in zip(
            found[by_first].tolist(),
            starts.tolist(),
            ends.tolist(),
            first_ns.tolist(),
            last_ns.tolist(),
            strict=True,
        )
    ]
    return AnsweredRun(alike, local.tolist(), request_ns.tolist(), response_ns.tolist())
