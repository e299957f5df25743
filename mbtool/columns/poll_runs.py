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

from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from mbtool.columns.arrays import narrow
from mbtool.columns.column_decoder import order_of
from mbtool.columns.plain_transactions import PlainObjects, origin_fields
from mbtool.ledger.answered_run import AlikeRequests, AnsweredRun

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mbtool.columns.arrays import Bools, Int64s
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.usual_values import UsualValues
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction

Part = TypeVar("Part")

MAX_KINDS = 65_536
_Place = tuple[str, str, str, str | None, str | None, str | None]
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
    """Groups the usual reads and writes of each block, for counts of equal polls together."""

    def __init__(self, objects: PlainObjects) -> None:
        self._objects = objects
        self._kinds: dict[tuple[_Place, int], NamedTransaction] = {}

    def kinds_of(self, rows: PlainRows, usual: UsualValues) -> KindsOfRows:
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
        keys = [
            (places[end], one)
            for end, one in zip(rows.connection[first].tolist(), asked[first].tolist(), strict=True)
        ]
        missing = [place for place, key in enumerate(keys) if key not in self._kinds]
        made = self._objects.of(rows, usual).chosen(first[missing])
        self._kinds.update(zip([keys[place] for place in missing], made, strict=True))
        return KindsOfRows([self._kinds[key] for key in keys], kind)


def _places(rows: PlainRows) -> list[_Place]:
    """Return for each item of `rows.connections` its link, IP and MAC addresses (_Place)."""
    return [
        (one.link, one.master.host, str(one.slave), *origin_fields(*addresses)[:3])
        for one, addresses in zip(rows.connections, rows.addresses, strict=True)
    ]


def in_turn(
    rows: PlainRows,
    is_usual: Bools,
    records: list[tuple[int, Record]],
    make_run: Callable[[int, int], Iterable[Part]],
    make_singles: Callable[[int, int], Iterable[Record]],
) -> Iterator[Record | Part]:
    """Yield the transactions and events of a block in the order in which packets completed them.

    `records` are those that the Decoder made. A row is a transaction that was read from arrays.
    `make_run(begin, end)` makes the items for the rows with the indices `begin` to `end`
    (exclusive), for all of which `is_usual` is True; `make_singles` does so for other rows.
    """
    places = np.searchsorted(order_of(rows.response), [place for place, _ in records]).tolist()
    changes = np.flatnonzero(is_usual[1:] != is_usual[:-1]) + 1
    cuts = sorted({*places, *changes.tolist(), len(is_usual)})
    begin = number = 0
    for end in cuts:
        if begin < end:
            make = make_run if is_usual[begin] else make_singles
            yield from make(begin, end)
        begin = end
        while number < len(places) and places[number] == end:
            yield records[number][1]
            number += 1


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
            partial(_packets_of, rows, order[start:stop] + begin),
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


def _packets_of(rows: PlainRows, places: Int64s, index: int) -> tuple[int, int]:
    """Return the packets of request and response of one of the rows with the indices `places`."""
    row, first = int(places[index]), rows.block.first_number
    return first + int(rows.request[row]), first + int(rows.response[row])
