"""Groups equal polls among the transactions in arrays, for the statistics and the inventory,
without making an object of each.
"""

# Only the usual reads and writes (usual_rows.py) are grouped. Two transactions are of one kind if
# they have the same link, master address (without port), slave and MAC addresses, and if their PDUs
# have the same unit, function, address, quantity and exception code. Among the kinds that differ
# only in address, only the first transaction is made an object with names, as the Decoder makes it.
# Copies of this object with other addresses stand for the other kinds.
#
# Memory: about MAX_KINDS such objects are kept between blocks. If there are more, all are forgotten
# and made again when needed.

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from msgspec import structs

from mbtool.columns.arrays import Groups
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
"""If there are more examples than this, all are forgotten before the next block."""
_ADDRESS = 0xFFFF << 16
"""The bits of the address in `UsualRows.asked`."""
_Place = tuple[str, str, str, str | None, str | None, str | None]
"""Link name, IP address of the master, address and port of the slave, MAC address of the master,
MAC address of the slave (None if unknown)."""


class KindsOfRows(NamedTuple):
    """Tells which rows (transactions) of a block are requests of the same poll."""

    likes: list[NamedTransaction]
    """An example transaction of each kind of poll, from this block or an earlier one."""
    form: list[int]
    """For each kind a number, equal for those that differ in address only."""
    kind: Int64s
    """For each row, the index of its kind; meaningless for a row that is no usual read or write.
    """


class PollRuns:
    """Groups the usual reads and writes of each block, for counts of equal polls together."""

    def __init__(self, objects: PlainObjects) -> None:
        self._objects = objects
        self._kinds: dict[tuple[_Place, int], NamedTransaction] = {}
        """An example transaction of each kind of poll. The key is the link with its hosts (_Place),
        and the request as a number (`UsualRows.asked`)."""
        self._forms: dict[tuple[_Place, int], NamedTransaction] = {}
        """Example transactions by the same key with the bits of the address cleared: the examples
        for other addresses are copies of them."""

    def kinds_of(self, rows: PlainRows, usual: UsualValues) -> KindsOfRows:
        """Return an example transaction of each kind of poll in the block, and for each row the
        index of its kind among these examples.

        The index of a row that is no usual read or write is meaningless.
        """
        if len(self._kinds) > MAX_KINDS:
            self._kinds.clear()
            self._forms.clear()
        places = _places(rows)
        numbers: dict[_Place, int] = {}
        place_of = np.array([numbers.setdefault(place, len(numbers)) for place in places])
        asked = usual.asked
        asked[~usual.is_usual] = -1
        like = Groups(asked)
        groups = Groups(place_of[rows.connection] * len(like.first) + like.number)
        keys = [
            (places[end], one)
            for end, one in zip(
                rows.connection[groups.first].tolist(), asked[groups.first].tolist(), strict=True
            )
        ]
        missing = [place for place, key in enumerate(keys) if key not in self._kinds]
        forms = [(keys[place][0], keys[place][1] & ~_ADDRESS) for place in missing]
        unknown = {
            form: int(groups.first[place])
            for form, place in zip(forms, missing, strict=True)
            if form not in self._forms
        }
        made = self._objects.of(rows, usual).chosen(np.array([*unknown.values()], np.int64))
        self._forms.update(zip(unknown, made, strict=True))
        namer = self._objects.namer
        for place, form in zip(missing, forms, strict=True):
            key, one = keys[place], self._forms[form]
            address = key[1] >> 16 & 0xFFFF
            if one.address != address and key[1] >= 0:
                one = namer.as_kind(structs.replace(one, address=address))
            self._kinds[key] = one
        known: dict[tuple[_Place, int], int] = {}
        form_of = [known.setdefault((end, one & ~_ADDRESS), len(known)) for end, one in keys]
        return KindsOfRows([self._kinds[key] for key in keys], form_of, groups.number)


def _places(rows: PlainRows) -> list[_Place]:
    """Return for each item of `rows.connections` its link, IP and MAC addresses (_Place)."""
    return [
        (one.link, one.master.host, str(one.slave), *origin_fields(*addresses)[:3])
        for one, addresses in zip(rows.connections, rows.addresses, strict=True)
    ]


def items_in_packet_order(
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
    groups = Groups(kinds.kind[some])
    order, starts = groups.order, groups.starts
    by_first = np.argsort(groups.first)
    number = np.empty(len(starts), np.int64)
    number[by_first] = np.arange(len(starts))
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
            partial(_packets_of, rows, order[start:stop], begin),
            kinds.form[which],
        )
        for which, start, stop, begin_ns, end_ns in zip(
            kinds.kind[some][groups.first[by_first]].tolist(),
            starts[by_first].tolist(),
            groups.ends[by_first].tolist(),
            first_ns[by_first].tolist(),
            last_ns[by_first].tolist(),
            strict=True,
        )
    ]
    kind = number[groups.number].tolist()
    return AnsweredRun(alike, kind, request_ns.tolist(), response_ns.tolist())


def _packets_of(rows: PlainRows, places: Int64s, begin: int, index: int) -> tuple[int, int]:
    """Return the packets of request and response of one of the rows that are `places` behind the
    row `begin`.
    """
    row, first = begin + int(places[index]), rows.block.first_number
    return first + int(rows.request[row]), first + int(rows.response[row])
