"""Counts and times everything that a capture or a live link shows."""

# Each transaction is counted at once, by its poll. Periods, poll cycles and hours need requests in
# the order of their times (request_order.py).
#
# Memory. MAX_POLLS polls; if there are more, the one that was not asked for longest is given up,
# and what it has counted goes to its group (link, unit, function). MAX_GROUPS groups, MAX_LINKS
# links with MAX_HOURS hours each, MAX_PAIRS pairs of hosts, and what request_order.py keeps.
# Everything beyond these limits is counted together, under no name. A poll takes 2 to 10 KB in
# practice, and 130 KB if all its latencies and periods differ.

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Outcome
from mbtool.overview.link_statistics import LinkStatistics
from mbtool.overview.poll_statistics import PollKey, PollStatistics, poll_key
from mbtool.overview.request_order import RequestOrder
from mbtool.overview.request_tally import RequestTally
from mbtool.overview.statistics_connections import ConnectionTally
from mbtool.serial_line.damaged_answers import DamagedAnswers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mbtool.core import SerialFormat
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.overview.answered_run import AlikeRequests, AnsweredRun
    from mbtool.overview.master_tape import MasterTape

MAX_POLLS = 2048
MAX_GROUPS = 4096
MAX_LINKS = 1024
MAX_PAIRS = 4096
_MAX_HOSTS = 65_536

_CONNECTIONS = frozenset((EventKind.OPENED, EventKind.CLOSED, EventKind.REFUSED))
_NO_FRAME = frozenset((EventKind.SKIPPED, EventKind.BAD_CHECK, EventKind.FOREIGN, EventKind.ECHO))

Group = tuple[str, int, int]
"""Link, unit and function."""
OTHER_LINKS = ""
"""The name under which the links beyond MAX_LINKS are counted."""


class Statistics:
    """Counts transactions and events; its attributes, the results, can be read at any time."""

    def __init__(self, format_of: Callable[[str], SerialFormat | None] = lambda _: None) -> None:
        """`format_of` gives the settings of a serial link; None if they are unknown."""
        self._format_of = format_of
        self.links: dict[str, LinkStatistics] = {}
        self.polls: OrderedDict[PollKey, PollStatistics] = OrderedDict()
        self.polls_seen = 0
        """The number of polls so far, including those that were given up."""
        self.groups: dict[Group, RequestTally] = {}
        """Transactions that belong to no poll: responses without request, and polls given up."""
        self.devices: dict[tuple[str, int], str] = {}
        self.function_names: dict[int, str] = {}
        self.connections: dict[tuple[str, str], ConnectionTally] = {}
        """The counts of connections, by link and the master's host."""
        self.transactions = 0
        self._order = RequestOrder(self.links)
        self._damaged = DamagedAnswers()
        self._hosts: dict[str, str] = {}

    @property
    def tapes(self) -> Mapping[tuple[str, str], MasterTape]:
        """The last requests of each master, by link and the master's host."""
        return self._order.tapes

    @property
    def late(self) -> int:
        """How many transactions came too late to be put in order."""
        return self._order.late

    def add(self, record: NamedTransaction | WireEvent) -> PollStatistics | None:
        """Count a record; return the poll of a transaction, None if it belongs to none."""
        if isinstance(record, WireEvent):
            self._add_event(record)
            return None
        return self._add_transaction(record)

    def add_run(self, run: AnsweredRun) -> None:
        """Add requests, with the same result as one by one."""
        if not self._has_room(run):
            for one in run.transactions():
                self._add_transaction(one)
            return
        self.transactions += len(run)
        polls = [self._count_alike(kind) for kind in run.kinds]
        for poll, latencies in run.latencies_of(polls).items():
            poll.tally.latency.add_all(latencies)
        self._touch(run, polls)
        self._order.add_run(run, polls)

    def begin_capture(self) -> None:
        """Note that the next record is of another capture, which may be of another day."""
        self._order.begin_capture()
        for link in self.links.values():
            link.end_span()
        for poll in self.polls.values():
            poll.cut()

    def settle(self, before_ns: int | None = None) -> None:
        """Put the waiting transactions in order: all, or those whose request came before a time."""
        self._order.settle(before_ns)

    def _add_transaction(self, one: NamedTransaction) -> PollStatistics | None:
        self.transactions += 1
        link = self._link(one.link)
        link.note(one)
        name = one.link if one.link in self.links else OTHER_LINKS
        if name != one.link or one.request_ns is None:
            self._group((name, one.unit, one.function)).add(one)
            return None
        poll = self._poll(one)
        poll.tally.add(one)
        is_damaged = self._damaged.has(one)
        poll.tally.damaged += is_damaged
        if link.has_times:
            self._order.add(
                one.request_ns,
                poll,
                max(one.response_ns or one.request_ns, one.request_ns),
                link.wire_ns(len(one.request_raw or b"")),
                is_missing=one.outcome is Outcome.NO_ANSWER,
                is_damaged=is_damaged,
            )
        return poll

    def _has_room(self, run: AnsweredRun) -> bool:
        """True if a run needs no limit of links and polls, and its links have times."""
        likes = [kind.like for kind in run.kinds]
        links = {like.link for like in likes}
        known = [self.links[link] for link in links if link in self.links]
        if len(self.links) + len(links) - len(known) > MAX_LINKS:
            return False
        polls = {poll_key(like, self._host(like.source)) for like in likes}
        if len(self.polls) + len(polls - self.polls.keys()) > MAX_POLLS:
            return False
        return all(link.has_times for link in known)

    def _count_alike(self, kind: AlikeRequests) -> PollStatistics:
        """Count requests, without their latencies; return their poll."""
        self._link(kind.like.link).note_span(kind.like, kind.begin_ns, kind.end_ns)
        poll = self._poll(kind.like)
        poll.tally.count_alike(kind.like, kind.count)
        return poll

    def _touch(self, run: AnsweredRun, polls: list[PollStatistics]) -> None:
        """Bring the polls of a run into the order of their last requests."""
        for kind in reversed(dict.fromkeys(reversed(run.kind))):
            self.polls.move_to_end(polls[kind].key)

    def _add_event(self, event: WireEvent) -> None:
        self._damaged.note(event)
        if event.kind in _CONNECTIONS:
            key = event.link, self._host(event.source)
            tally = self.connections.get(key)
            if tally is None and len(self.connections) < MAX_PAIRS:
                tally = self.connections[key] = ConnectionTally()
            if tally is not None:
                tally.add(event)
        elif event.kind in _NO_FRAME and event.link in self.links:
            self.links[event.link].other_bytes += len(event.raw)

    def _link(self, name: str) -> LinkStatistics:
        link = self.links.get(name)
        if link is None:
            if len(self.links) >= MAX_LINKS:
                name = OTHER_LINKS
            link = self.links.setdefault(name, LinkStatistics(self._format_of))
        return link

    def _poll(self, one: NamedTransaction) -> PollStatistics:
        key = poll_key(one, self._host(one.source))
        poll = self.polls.get(key)
        if poll is not None:
            self.polls.move_to_end(key)
            return poll
        if len(self.polls) >= MAX_POLLS:
            old, given_up = self.polls.popitem(last=False)
            self._group((old.link, old.unit, old.function)).merge(given_up.tally)
        poll = self.polls[key] = PollStatistics(self.polls_seen, key, one)
        self.polls_seen += 1
        if len(self.function_names) < 256 or one.function in self.function_names:
            self.function_names[one.function] = one.function_name
        if one.device is not None and len(self.devices) < MAX_GROUPS:
            self.devices[one.link, one.unit] = one.device
        return poll

    def _group(self, key: Group) -> RequestTally:
        tally = self.groups.get(key)
        if tally is None:
            if len(self.groups) >= MAX_GROUPS:
                self.links.setdefault(OTHER_LINKS, LinkStatistics(self._format_of))
                key = OTHER_LINKS, 0, 0
            tally = self.groups.setdefault(key, RequestTally())
        return tally

    def _host(self, address: str | None) -> str:
        """The host of an address with its port, `10.0.0.1` of `10.0.0.1:50211`."""
        if address is None:
            return ""
        host = self._hosts.get(address)
        if host is None:
            if len(self._hosts) >= _MAX_HOSTS:
                self._hosts.clear()
            host = self._hosts[address] = address.rpartition(":")[0].strip("[]")
        return host
