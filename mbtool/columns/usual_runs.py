"""Joins consecutive usual reads and writes that were read as arrays, for the table of `decode`."""

# A row of the arrays is one transaction. If several usual reads and writes (usual_rows.py) of a
# block have the same unit, function, address, quantity and exception code, only the first is made
# an object with names: the example. The caller makes a "form" from the example, such as the text
# that the table rows of all these transactions share.
#
# Memory: lists with the times, ids and packet numbers of one portion of a block (portions.py), and
# with the values of MOST rows.

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from mbtool.columns.plain_transactions import PlainObjects
from mbtool.columns.poll_runs import items_in_packet_order
from mbtool.columns.sunspec_rows import SunSpecRows
from mbtool.columns.usual_values import UsualValues, ValueLists
from mbtool.decode.usual_run import UsualRun
from mbtool.devices import NamedTransaction, Namer

if TYPE_CHECKING:
    from mbtool.columns.arrays import Int64s
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.decode.decoder import Record

F = TypeVar("F")

MOST = 4096
"""The largest number of transactions in a UsualRun."""


class UsualRuns(Generic[F]):
    """Joins the consecutive usual reads and writes of each block of packets, from and to slaves
    without a profile, to UsualRuns.
    """

    def __init__(
        self, form_of: Callable[[NamedTransaction], F], singly: int, namer: Namer | None = None
    ) -> None:
        """`form_of` gets one transaction and makes what all equal transactions share, such as the
        text of their lines. The first `singly` transactions of the capture are given as single
        transactions.
        """
        self._form_of = form_of
        self._singly = singly
        self._objects = PlainObjects(namer or Namer())
        self._sunspec = SunSpecRows()

    def parts(self, decoded: DecodedBlock) -> Iterator[Record | UsualRun[F]]:
        """Yield the transactions and events of a block in the order in which packets completed
        them.

        Consecutive usual reads and writes come together as UsualRuns. OPENED and CLOSED events of
        connections that the Decoder did not follow are left out.
        """
        records = decoded.sorted_records()
        self._sunspec.note(records)
        rows = decoded.plain
        if rows is None:
            yield from (record for _, record in records)
            return
        usual = UsualValues(rows)
        made = self._objects.of(rows, usual)
        usual.is_usual &= ~(self._sunspec.find(rows, usual) | made.have_profile())
        usual.is_usual[: self._singly] = False
        self._singly = max(self._singly - len(usual.is_usual), 0)
        block = _BlockForms(
            rows, usual, lambda some: [self._form_of(one) for one in made.chosen(some)]
        )
        yield from items_in_packet_order(rows, usual.is_usual, records, block.some, made.some)


class _BlockForms(Generic[F]):
    """The usual reads and writes of a block: their forms, ends, numbers and values as lists."""

    def __init__(
        self, rows: PlainRows, usual: UsualValues, forms_of: Callable[[Int64s], list[F]]
    ) -> None:
        chosen = np.flatnonzero(usual.is_usual)
        self._index: Int64s = np.cumsum(usual.is_usual) - usual.is_usual
        """For each row (transaction), the number of usual reads and writes before it."""
        _, first, kind = np.unique(usual.asked[chosen], return_index=True, return_inverse=True)
        forms = forms_of(chosen[first])
        ends = [(one.link, str(one.master), str(one.slave)) for one in rows.connections]
        connection = rows.connection[chosen].tolist()
        number = rows.block.first_number
        request_ns, response_ns = rows.request_ns[chosen], rows.response_ns[chosen]
        self._refused = usual.exception[chosen] >= 0
        self._forms = [forms[one] for one in kind.tolist()]
        self._ends = [ends[one] for one in connection]
        self._numbers = tuple(
            numbers.tolist()
            for numbers in (
                rows.transaction_id[chosen],
                request_ns,
                response_ns - request_ns,
                number + rows.request[chosen],
                number + rows.response[chosen],
            )
        )
        self._written, self._read = usual.request_values(chosen), usual.response_values(chosen)

    def some(self, begin: int, end: int) -> Iterator[UsualRun[F]]:
        """Yield the rows (transactions) with the indices `begin` to `end` (exclusive), all of them
        usual reads and writes, as UsualRuns of at most MOST.
        """
        first = int(self._index[begin])
        stop = first + end - begin
        for at in range(first, stop, MOST):
            yield self._run(slice(at, min(at + MOST, stop)))

    def _run(self, some: slice) -> UsualRun[F]:
        ids, request_ns, latency_ns, requests, responses = (one[some] for one in self._numbers)
        links, sources, destinations = zip(*self._ends[some], strict=True)
        written, read = _lists(self._written, some), _lists(self._read, some)
        return UsualRun(
            forms=self._forms[some],
            refused=int(np.count_nonzero(self._refused[some])),
            links=links,
            sources=sources,
            destinations=destinations,
            transaction_ids=ids,
            request_ns=request_ns,
            latency_ns=latency_ns,
            request_packets=requests,
            response_packets=responses,
            values=[one or other for one, other in zip(written, read, strict=True)],
        )


def _lists(lists: ValueLists, some: slice) -> list[list[int]]:
    """Return the values of each row (transaction) in the slice `some`; an empty list for one
    without.
    """
    offsets = lists.offsets[some.start : some.stop + 1]
    numbers = lists.numbers[offsets[0] : offsets[-1]].tolist()
    ends = (offsets - offsets[0]).tolist()
    return [numbers[begin:end] for begin, end in pairwise(ends)]
