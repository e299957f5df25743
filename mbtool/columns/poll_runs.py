"""Figures about answered reads and writes in arrays, for rules, account and troubles, without an
object of each.
"""

# Only the usual reads and writes (usual_rows.py) are in a run. Two transactions have the same form
# if they have the same link, master address (without port), slave and MAC addresses, and if their
# PDUs have the same unit, function and exception code. Only the first transaction of a form is made
# an object with names, as the Decoder makes it. Copies of this object with other addresses and
# quantities stand for the other transactions.
#
# Memory: about MAX_FORMS such objects are kept between blocks. If there are more, all are forgotten
# and made again when needed.

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from functools import cached_property, lru_cache
from itertools import chain, count, islice, repeat
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from msgspec import structs

from mbtool.columns.arrays import Bools, Groups, Int64s, Numbers
from mbtool.columns.column_decoder import result_sort_keys
from mbtool.columns.plain_transactions import RowObjects, origin_fields
from mbtool.devices import NamedTransaction
from mbtool.devices.checking.quiet_run import (
    AlikeRequests,
    QuietRun,
    RunRows,
    Stay,
    Stays,
)
from mbtool.devices.references import write_reference
from mbtool.modbus.functions import FUNCTIONS

if TYPE_CHECKING:
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.usual_values import UsualValues
    from mbtool.decode.decoder import Record
    from mbtool.devices.checking.quiet_run import (
        ConnectionCounts,
        PollName,
        QuietConnection,
    )

Part = TypeVar("Part")

MAX_FORMS = 65_536
"""The most forms (example transactions) that are kept between blocks."""
_Place = tuple[str, str, str, str | None, str | None, str | None]
"""Link name, IP address of the master, address and port of the slave, MAC address of the master,
MAC address of the slave (None if unknown)."""


Likes = dict[tuple[_Place, int], NamedTransaction]
"""An example of each form of transaction. Its slave has no profile, and it has no finding."""


class BlockPolls:
    """The polls and forms of a block's rows (transactions), and their fields."""

    def __init__(
        self, rows: PlainRows, usual: UsualValues, objects: RowObjects, likes: Likes
    ) -> None:
        self.rows = rows
        self.usual = usual
        self.objects = objects
        self._likes = likes
        known = {one: number for number, one in enumerate(dict.fromkeys(rows.connections))}
        self.known = known
        """The number of each connection: those with the same ends have the same."""
        numbers = np.array([known[one] for one in rows.connections], np.int64)
        self.connection: Int64s = numbers[rows.connection]
        self.ends = [(one.link, str(one.master), str(one.slave)) for one in known]
        self.hosts = [one.master.host for one in known]
        self.link = _numbers([link for link, _, _ in self.ends])
        self.link_host = _numbers([*zip(self.link.tolist(), self.hosts, strict=True)])
        self.unit: Int64s = self.link[self.connection] << 8 | rows.unit
        self.has_masters = self.link_host.max(initial=0) > self.link.max(initial=0)
        """True if a link has several masters."""
        self.asked: Int64s = (
            rows.unit << 40 | rows.code << 32 | usual.address << 16 | usual.quantity
        )
        """By row, its `asked_number`."""
        asked = self.link_host[self.connection] << 48 | self.asked
        _, first, poll = np.unique(asked, return_index=True, return_inverse=True)
        self._first = first
        self.poll: Int64s = poll
        """By row, the number of its poll, where equal requests of two masters are two polls."""

    @cached_property
    def names(self) -> list[PollName]:
        """The name of each poll."""
        rows, usual, first = self.rows, self.usual, self._first
        of = self.connection[first].tolist()
        return [*zip(
            [self.ends[one][0] for one in of], [self.hosts[one] for one in of],
            rows.unit[first].tolist(), rows.code[first].tolist(), repeat(None),
            usual.address[first].tolist(), usual.quantity[first].tolist(), repeat(None),
            repeat(None),
        )]  # fmt: skip

    @cached_property
    def forms(self) -> tuple[list[NamedTransaction], Int64s]:
        """An example of each form in the block, and for each row the index of its form; meaningless
        for a row that is no usual read or write.
        """
        rows, usual, likes = self.rows, self.usual, self._likes
        if len(likes) > MAX_FORMS:
            likes.clear()
        places = _places(rows)
        numbers: dict[_Place, int] = {}
        place_of = np.array([numbers.setdefault(place, len(numbers)) for place in places])
        asked = np.where(usual.is_usual, usual.asked >> 32, -1)
        groups = Groups(place_of[rows.connection] << 32 | asked + 1)
        ends, first = rows.connection[groups.first].tolist(), asked[groups.first].tolist()
        keys = [(places[end], one) for end, one in zip(ends, first, strict=True)]
        missing = [place for place, key in enumerate(keys) if key not in likes]
        made = self.objects.chosen(groups.first[missing])
        likes.update(zip([keys[place] for place in missing], made, strict=True))
        return [likes[key] for key in keys], groups.number


class BlockRun(QuietRun):
    """Consecutive rows (transactions) of a block as a QuietRun."""

    def __init__(
        self,
        polls: BlockPolls,
        begin: int,
        end: int,
        connections: list[QuietConnection],
        opened_and_closed: list[ConnectionCounts],
        last_event_ns: int,
    ) -> None:
        """Take the rows with the indices `begin` to `end` (exclusive)."""
        self._polls = polls
        self._begin = begin
        self._some = slice(begin, end)
        self.connections = connections
        self.opened_and_closed = opened_and_closed
        self.last_event_ns = last_event_ns

    def __len__(self) -> int:
        return self._some.stop - self._begin

    @property
    def file(self) -> str | None:
        return self._polls.rows.block.file

    @cached_property
    def rows(self) -> RunRows:
        polls, some = self._polls, self._some
        return RunRows(
            polls.asked[some].tolist(),
            polls.usual.exception[some].tolist(),
            polls.rows.request_ns[some].tolist(),
            self._latencies.tolist(),
            polls.rows.request_size[some].tolist(),
            polls.rows.response_size[some].tolist(),
        )

    @property
    def _latencies(self) -> Int64s:
        rows = self._polls.rows
        return rows.response_ns[self._some] - rows.request_ns[self._some]

    @cached_property
    def forms(self) -> list[AlikeRequests]:
        groups, rows = self._by_form, self._polls.rows
        request_ns = rows.request_ns[self._some][groups.order]
        response_ns = rows.response_ns[self._some][groups.order]
        likes, form = self._polls.forms
        found = [*map(AlikeRequests._make, zip(
            [likes[one] for one in form[self._some][groups.first].tolist()],
            _lists(groups, groups.order),
            np.minimum.reduceat(request_ns, groups.starts).tolist(),
            np.maximum.reduceat(response_ns, groups.starts).tolist(),
            strict=True,
        ))]  # fmt: skip
        return [found[one] for one in np.argsort(groups.first).tolist()]

    @cached_property
    def _by_form(self) -> Groups:
        return Groups(self._polls.forms[1][self._some])

    def stays(self, held: Collection[PollName], limit: int, few: int = 0) -> Stays:
        groups, names = self._by_poll, self._names
        known = [*map(held.__contains__, names)]
        before = [number for number, is_known in enumerate(known) if is_known]
        oldest: list[PollName] = []
        if len(held) + len(names) - len(before) > limit:
            # Of the polls without a request, only the oldest can be dropped: at most as many as
            # there are requests, while at most as many of the older ones get a request.
            oldest = [*islice(held, 2 * len(self))]
            numbers = {name: number for number, name in enumerate(names)}
            some = [numbers.get(name, -1 - place) for place, name in enumerate(oldest)]
            before = [*some, *{*before}.difference(some)]
        room = limit - len(held) + len(before)
        fresh = count().__next__
        # The cache gives each poll the number of its stay. They count from 0 in the order in which
        # stays begin; those of `before` are first.
        stay_of = lru_cache(room)(lambda _: fresh())
        uses = np.fromiter(map(stay_of, chain(before, groups.number.tolist())), np.int64)
        last = np.zeros(fresh(), np.int64)
        last[uses] = np.arange(len(uses))  # Of equal indices, the last one counts.
        is_left = np.zeros(len(last), np.bool_)
        is_left[np.argsort(last)[-room:]] = True
        number = uses[len(before) :]
        stays = Groups(number)
        first, places = number[stays.first], _lists(stays, stays.order)
        has_few = (first >= len(before)) & (stays.ends - stays.starts <= few)
        is_passing = ~is_left[first] & has_few
        polls = groups.number[stays.first].tolist()

        def of(are: Bools) -> list[Stay]:
            chosen = np.flatnonzero(are)
            return [
                Stay(names[polls[one]], int(first[one]) - len(before), places[one])
                for one in chosen[np.argsort(last[first[chosen]])].tolist()
            ]

        # The first use of each of `before` is its own place.
        unused = ~is_left[: len(before)] & (last[: len(before)] == np.arange(len(before)))
        passing = np.flatnonzero(is_passing[stays.number])
        exception = self._polls.usual.exception[self._some]
        _, ends = np.unique(number << 9 | exception + 1, return_index=True)
        return Stays(
            dropped=[
                names[one] if one >= 0 else oldest[-1 - one]
                for one, is_dropped in zip(before, unused.tolist(), strict=True)
                if is_dropped
            ],
            ended=of(~is_left[first] & ~is_passing),
            passing=passing[np.argsort(last[number[passing]], kind="stable")].tolist(),
            left=of(is_left[first]),
            begun=len(last) - len(before),
            fresh=np.sort(ends[number[ends] >= len(before)]).tolist(),
        )

    @cached_property
    def _by_poll(self) -> Groups:
        return Groups(self._polls.poll[self._some])

    @cached_property
    def _names(self) -> list[PollName]:
        """The name of each poll of the rows, in the order of their numbers."""
        names = self._polls.names
        return [names[one] for one in self._polls.poll[self._some][self._by_poll.first].tolist()]

    def slow(self, least_ns: int, most: int | None = None) -> list[tuple[int, int]]:
        latency = self._latencies
        places = _slowest(latency, least_ns, most, self._polls.poll[self._some])
        return [*zip(places.tolist(), latency[places].tolist(), strict=True)]

    def ends(self, place: int) -> tuple[str, str, str]:
        return self._polls.ends[self._polls.connection.item(self._begin + place)]

    def like(self, place: int) -> NamedTransaction:
        polls, row = self._polls, self._begin + place
        rows, usual, (likes, form) = polls.rows, polls.usual, polls.forms
        begin_ns, end_ns = rows.request_ns.item(row), rows.response_ns.item(row)
        asking, answering = self.packets(place)
        address, quantity = usual.address.item(row), usual.quantity.item(row)
        table = FUNCTIONS[rows.code.item(row)].table
        assert table is not None
        return structs.replace(
            likes[form.item(row)],
            file=rows.block.file,
            source=self.ends(place)[1],
            transaction_id=rows.transaction_id.item(row),
            request_ns=begin_ns,
            response_ns=end_ns,
            latency_ns=end_ns - begin_ns,
            request_packet=asking,
            response_packet=answering,
            address=address,
            quantity=quantity,
            reference=write_reference(None, table, address, quantity),
        )

    def packets(self, place: int) -> tuple[int, int]:
        rows, row = self._polls.rows, self._begin + place
        number = rows.block.first_number
        return number + rows.request.item(row), number + rows.response.item(row)

    def transactions(self) -> Iterator[NamedTransaction]:
        return self._polls.objects.some(self._begin, self._some.stop)


def _slowest(latency: Int64s, least_ns: int, most: int | None, group: Numbers) -> Int64s:
    """Return the indices of the latencies that are at least `least_ns`, sorted. Of those with equal
    numbers in `group`, at most `most`: the longest ones, and among equal ones the first.
    """
    places = np.flatnonzero(latency >= least_ns)
    if most is None or not len(places):
        return places
    places = places[np.argsort(-latency[places], kind="stable")]
    groups = Groups(group[places])
    rank = np.arange(len(places)) - np.repeat(groups.starts, groups.ends - groups.starts)
    return np.sort(places[groups.order[rank < most]])


def _lists(groups: Groups, values: Numbers | Bools) -> list[list[int]]:
    """Return the values of each group as a list; `values` are in the order of `groups.order`."""
    each: list[int] = values.tolist()
    bounds = zip(groups.starts.tolist(), groups.ends.tolist(), strict=True)
    return [each[start:stop] for start, stop in bounds]


def _numbers(values: Sequence[Hashable]) -> Int64s:
    """Return a number for each value: equal values get equal numbers. Numbers count from 0 in the
    order in which values first appear.
    """
    known = {value: number for number, value in enumerate(dict.fromkeys(values))}
    return np.array([known[value] for value in values], np.int64)


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
    places = np.searchsorted(
        result_sort_keys(rows.response), [place for place, _ in records]
    ).tolist()
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
