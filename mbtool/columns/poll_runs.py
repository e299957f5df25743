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

from functools import cached_property, lru_cache
from itertools import chain, count, islice, repeat
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from msgspec import structs

from mbtool.columns.arrays import Groups
from mbtool.columns.column_decoder import order_of
from mbtool.columns.plain_transactions import origin_fields
from mbtool.devices.checking.quiet_run import (
    AlikeRequests,
    LinkRequests,
    QuietRequest,
    Stay,
    Stays,
    UnitRequests,
    asked_number,
)
from mbtool.devices.references import write_reference
from mbtool.modbus.functions import FUNCTIONS, WRITE_ONE, WRITE_SEVERAL

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence

    from mbtool.columns.arrays import Bools, Int64s, Numbers
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.plain_transactions import RowObjects
    from mbtool.columns.usual_values import UsualValues
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction
    from mbtool.devices.checking.quiet_run import (
        ConnectionCounts,
        PollName,
        QuietConnection,
    )

Part = TypeVar("Part")

MAX_FORMS = 65_536
WRITES = [*WRITE_ONE - {0x16}, *WRITE_SEVERAL]
_Place = tuple[str, str, str, str | None, str | None, str | None]
"""Link name, IP address of the master, address and port of the slave, MAC address of the master,
MAC address of the slave (None if unknown)."""


class PollForms:
    """Keeps an example of each form of transaction between the blocks of a capture. Their slaves
    have no profile, and they have no finding.
    """

    def __init__(self) -> None:
        self._likes: dict[tuple[_Place, int], NamedTransaction] = {}

    def of(
        self, rows: PlainRows, usual: UsualValues, objects: RowObjects
    ) -> tuple[list[NamedTransaction], Int64s]:
        """Return an example of each form in a block, and for each row (transaction) the index of
        its form; meaningless for a row that is no usual read or write.
        """
        if len(self._likes) > MAX_FORMS:
            self._likes.clear()
        places = _places(rows)
        numbers: dict[_Place, int] = {}
        place_of = np.array([numbers.setdefault(place, len(numbers)) for place in places])
        asked = np.where(usual.is_usual, usual.asked >> 32, -1)
        groups = Groups(place_of[rows.connection] << 32 | asked + 1)
        ends, first = rows.connection[groups.first].tolist(), asked[groups.first].tolist()
        keys = [(places[end], one) for end, one in zip(ends, first, strict=True)]
        missing = {
            key: row
            for key, row in zip(keys, groups.first.tolist(), strict=True)
            if key not in self._likes
        }
        made = objects.chosen(np.array([*missing.values()], np.int64))
        self._likes.update(zip(missing, made, strict=True))
        return [self._likes[key] for key in keys], groups.number


class BlockPolls:
    """The polls and forms of a block's rows (transactions), and their fields."""

    def __init__(
        self, rows: PlainRows, usual: UsualValues, objects: RowObjects, forms: PollForms
    ) -> None:
        self.rows = rows
        self.usual = usual
        self.objects = objects
        self._forms = forms
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
    def writes(self) -> Int64s:
        """The rows that write."""
        return np.flatnonzero(np.isin(self.rows.code, WRITES))

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
        return self._forms.of(self.rows, self.usual, self.objects)

    def like(self, row: int) -> NamedTransaction:
        """Return the transaction of a row with the values and bytes of one of the same form."""
        rows, usual, number = self.rows, self.usual, self.rows.block.first_number
        begin_ns, end_ns = rows.request_ns.item(row), rows.response_ns.item(row)
        likes, form = self.forms
        address, quantity = usual.address.item(row), usual.quantity.item(row)
        table = FUNCTIONS[rows.code.item(row)].table
        assert table is not None
        return structs.replace(
            likes[form.item(row)],
            file=rows.block.file,
            source=self.ends[self.connection.item(row)][1],
            transaction_id=rows.transaction_id.item(row),
            request_ns=begin_ns,
            response_ns=end_ns,
            latency_ns=end_ns - begin_ns,
            request_packet=number + rows.request.item(row),
            response_packet=number + rows.response.item(row),
            address=address,
            quantity=quantity,
            reference=write_reference(None, table, address, quantity),
        )


class BlockRun:
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

    @cached_property
    def request_ns(self) -> list[int]:
        times: list[int] = self._polls.rows.request_ns[self._some].tolist()
        return times

    @cached_property
    def response_ns(self) -> list[int]:
        times: list[int] = self._polls.rows.response_ns[self._some].tolist()
        return times

    @cached_property
    def asked(self) -> list[int]:
        asked: list[int] = self._polls.asked[self._some].tolist()
        return asked

    @cached_property
    def exceptions(self) -> list[int]:
        codes: list[int] = self._polls.usual.exception[self._some].tolist()
        return codes

    @property
    def last_request_ns(self) -> int:
        return int(self._polls.rows.request_ns[self._some].max())

    @property
    def last_response_ns(self) -> int:
        return int(self._polls.rows.response_ns[self._some].max())

    @property
    def longest_ns(self) -> int:
        return int(self._latencies.max())

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
    def form(self) -> list[int]:
        form: list[int] = _by_first(self._by_form).tolist()
        return form

    @cached_property
    def _by_form(self) -> Groups:
        return Groups(self._polls.forms[1][self._some])

    @cached_property
    def sizes(self) -> tuple[list[int], list[int]]:
        rows = self._polls.rows
        return rows.request_size[self._some].tolist(), rows.response_size[self._some].tolist()

    @cached_property
    def links(self) -> list[LinkRequests]:
        polls, rows, some = self._polls, self._polls.rows, self._some
        sizes = rows.request_size[some] + rows.response_size[some]
        groups, found = Groups(polls.unit[some] >> 8), []
        for start, stop in zip(groups.starts.tolist(), groups.ends.tolist(), strict=True):
            places = groups.order[start:stop]
            times = rows.request_ns[some][places]
            by_time = np.argsort(times, kind="stable")
            before = np.concatenate([[0], np.cumsum(sizes[places][by_time])])
            link = polls.ends[polls.connection.item(self._begin + places.item(0))][0]
            found.append(LinkRequests(link, times[by_time].tolist(), before.tolist()))
        return found

    @cached_property
    def units(self) -> list[tuple[str, int]]:
        polls, groups = self._polls, Groups(self._polls.unit[self._some])
        last = np.sort(groups.last) + self._begin
        ends = [polls.ends[one][0] for one in polls.connection[last].tolist()]
        return [*zip(ends, polls.rows.unit[last].tolist(), strict=True)]

    @cached_property
    def by_unit(self) -> list[UnitRequests]:
        polls, some = self._polls, self._some
        groups = Groups(polls.connection[some] << 8 | polls.rows.unit[some])
        first = groups.first + self._begin
        ends = [polls.ends[one] for one in polls.connection[first].tolist()]
        found = [*map(UnitRequests._make, zip(
            [source for _, source, _ in ends],
            [destination for _, _, destination in ends],
            polls.rows.unit[first].tolist(),
            _lists(groups, groups.order),
            strict=True,
        ))]  # fmt: skip
        return [found[one] for one in np.argsort(groups.first).tolist()]

    @cached_property
    def refused(self) -> list[QuietRequest]:
        return self._requests(np.flatnonzero(self._polls.usual.exception[self._some] >= 0))

    @cached_property
    def writes(self) -> list[QuietRequest]:
        writes = self._polls.writes
        first, last = np.searchsorted(writes, (self._begin, self._some.stop)).tolist()
        return self._requests(writes[first:last] - self._begin)

    def asks(self, link: str, unit: int, function: int, address: int) -> bool:
        polls, some = self._polls, self._some
        asked = asked_number(unit, function, address, 0) >> 16
        places = np.flatnonzero(polls.asked[some] >> 16 == asked) + self._begin
        return any(polls.ends[one][0] == link for one in polls.connection[places].tolist())

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

    def polls(self) -> tuple[list[PollName], list[int]]:
        order = np.argsort(self._by_poll.first).tolist()
        return [self._names[one] for one in order], _by_first(self._by_poll).tolist()

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
        places = slowest(latency, least_ns, most, self._polls.poll[self._some])
        return [*zip(places.tolist(), latency[places].tolist(), strict=True)]

    def like(self, place: int) -> NamedTransaction:
        return self._polls.like(self._begin + place)

    def packets(self, place: int) -> tuple[int, int]:
        rows, row = self._polls.rows, self._begin + place
        number = rows.block.first_number
        return number + rows.request.item(row), number + rows.response.item(row)

    def transactions(self) -> Iterator[NamedTransaction]:
        return self._polls.objects.some(self._begin, self._some.stop)

    def _requests(self, places: Int64s) -> list[QuietRequest]:
        """Return the requests at these places."""
        polls, rows, chosen = self._polls, self._polls.rows, places + self._begin
        number = rows.block.first_number
        ends = [polls.ends[one] for one in polls.connection[chosen].tolist()]
        packets = rows.request[chosen] + number, rows.response[chosen] + number
        return [*map(QuietRequest._make, zip(  # Faster than calling QuietRequest.
            [source for _, source, _ in ends],
            [destination for _, _, destination in ends],
            rows.unit[chosen].tolist(),
            rows.code[chosen].tolist(),
            polls.usual.address[chosen].tolist(),
            polls.usual.quantity[chosen].tolist(),
            rows.request_ns[chosen].tolist(),
            places.tolist(),
            zip(*(each.tolist() for each in packets), strict=True),
            polls.usual.exception[chosen].tolist(),
            strict=True,
        ))]  # fmt: skip


def slowest(latency: Int64s, least_ns: int, most: int | None, group: Numbers) -> Int64s:
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


def _by_first(groups: Groups) -> Int64s:
    """Return the number of each index's group, where the groups are numbered in the order in which
    they first appear.
    """
    number = np.empty(len(groups.first), np.int64)
    number[np.argsort(groups.first)] = np.arange(len(number))
    return number[groups.number]


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
