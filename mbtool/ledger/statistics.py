"""Collects the statistics of a capture or a live link: counts, latencies, periods, connections."""

# A poll is all equal requests of one master to one unit. Each transaction is counted with its poll
# at once. Periods, poll cycles and counts by hour need the requests sorted by time, which
# request_order.py does.
#
# Memory. At most MAX_POLLS polls: at the limit, the poll whose last request is oldest is removed,
# and its counts are added to those of its group (link, unit, function). At most MAX_GROUPS groups,
# as many units, MAX_LINKS links with MAX_HOURS hours each, MAX_PAIRS pairs of link and master, and
# the requests that request_order.py keeps. Links and groups beyond their limits are counted
# together, under an empty name. A poll takes 2 to 10 KB in practice, and 130 KB if all its
# latencies and periods differ.

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.ledger.link_statistics import LinkStatistics
from mbtool.ledger.poll_statistics import PollKey, PollStatistics, poll_key
from mbtool.ledger.request_order import RequestOrder
from mbtool.ledger.request_tally import RequestTally
from mbtool.ledger.statistics_connections import ConnectionTally
from mbtool.ledger.unit_times import UnitTimes
from mbtool.modbus import Outcome
from mbtool.modbus.damaged_answers import DamagedAnswers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mbtool.core import SerialFormat
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.answered_run import AlikeRequests, AnsweredRun
    from mbtool.ledger.master_tape import MasterTape

MAX_POLLS = 2048
MAX_GROUPS = 16_384
MAX_LINKS = 1024
MAX_PAIRS = 4096
_MAX_HOSTS = 65_536

_CONNECTIONS = frozenset((EventKind.OPENED, EventKind.CLOSED, EventKind.REFUSED))
_NO_FRAME = frozenset((
    EventKind.SKIPPED, EventKind.BAD_CHECK, EventKind.FOREIGN, EventKind.ECHO, EventKind.REPEATED,
))  # fmt: skip

Group = tuple[str, int, int]
"""The key of a group of transactions: link name, unit and function code."""
OTHER_UNITS = -1
"""The unit under which all pairs of unit and function of a link that are beyond MAX_GROUPS are
counted together."""
OTHER_LINKS = ""
"""The link name under which all links beyond MAX_LINKS are counted together."""


class Statistics:
    """Collects the statistics of transactions and events. Its attributes hold the results, and can
    be read at any time.
    """

    def __init__(
        self,
        format_of: Callable[[str], SerialFormat | None] = lambda _: None,
        on_retry: Callable[[PollStatistics, int, int], None] = lambda *_: None,
    ) -> None:
        """Collect the statistics of links.

        `format_of` is called with the name of a link. It returns the baud rate and character format
        of a serial line, None if they are unknown. `on_retry` is that of RequestOrder.
        """
        self._format_of = format_of
        self.links: dict[str, LinkStatistics] = {}
        self.polls: OrderedDict[PollKey, PollStatistics] = OrderedDict()
        self.polls_seen = 0
        """The number of polls seen so far, including those removed because there were more than
        MAX_POLLS."""
        self.groups: dict[Group, RequestTally] = {}
        """The counts of transactions that have no poll: responses without a request, and all
        transactions of polls that were removed because there were more than MAX_POLLS. The key is
        link name, unit and function code."""
        self.units: dict[tuple[str, int], UnitTimes] = {}
        """The times of the requests to each unit; the key is link and unit. Units beyond
        MAX_GROUPS are left out."""
        self.devices: dict[tuple[str, int], str] = {}
        self.function_names: dict[int, str] = {}
        self.connections: dict[tuple[str, str], ConnectionTally] = {}
        """The counts of TCP connections; the key is the link and the master's host."""
        self.bad_checks: dict[str, int] = {}
        """The number of frames with a wrong CRC or LRC of each link; of at most MAX_LINKS."""
        self.left_out = 0
        """The number of transactions that the caller did not add because of the user's filter. It
        adds all events, so these cannot be compared with the transactions then."""
        self.transactions = 0
        self._order = RequestOrder(self.links, on_retry)
        self._damaged = DamagedAnswers()
        self.damaged_ns: int | None = None
        """The time (UTC ns) of the damaged response to the last request that was added; None if it
        had none."""
        self._hosts: dict[str, str] = {}
        self._spans: list[tuple[int, int]] = []
        """The first request and the last response (UTC ns) of each capture before the present one;
        captures that overlap are joined."""

    @property
    def watched_ns(self) -> int:
        """The time in ns from the first request to the last response of each capture, on whatever
        link, summed over all captures. Where captures overlap, it counts once.
        """
        return sum(end_ns - begin_ns for begin_ns, end_ns in self._joined_spans())

    def _joined_spans(self) -> list[tuple[int, int]]:
        """Return the spans of all captures, sorted; those that overlap are joined."""
        present = [link.span for link in self.links.values() if link.span is not None]
        spans = list(self._spans)
        if present:
            spans.append((min(begin for begin, _ in present), max(end for _, end in present)))
        joined: list[tuple[int, int]] = []
        for begin_ns, end_ns in sorted(spans):
            if joined and begin_ns <= joined[-1][1]:
                joined[-1] = joined[-1][0], max(end_ns, joined[-1][1])
            else:
                joined.append((begin_ns, end_ns))
        return joined

    @property
    def tapes(self) -> Mapping[tuple[str, str], MasterTape]:
        """The last requests of each master; the key is the link and the master's host."""
        return self._order.tapes

    @property
    def late(self) -> int:
        """The number of requests that were added too late to be sorted by time, so that periods,
        poll cycles and counts by hour lack them.
        """
        return self._order.late

    def add(self, record: NamedTransaction | WireEvent) -> PollStatistics | None:
        """Count a transaction or an event.

        Returns the poll of the transaction; None for an event, and for a transaction without a
        poll.
        """
        if isinstance(record, WireEvent):
            self._add_event(record)
            return None
        return self._add_transaction(record)

    def add_run(self, run: AnsweredRun) -> None:
        """Add a batch of answered requests at once. The counts are the same as if `add` was called
        for each.
        """
        if not self._has_room(run):
            for one in run.transactions():
                self._add_transaction(one)
            return
        self.transactions += len(run)
        polls = [self._count_alike(kind) for kind in run.kinds]
        for poll, latencies in run.latencies_of(polls).items():
            poll.tally.latency.add_all(latencies)
        _count_asked(run, polls)
        self._touch(run, polls)
        self._order.add_run(run, polls)

    def begin_capture(self) -> None:
        """Note that the next transaction or event belongs to another capture, perhaps of another
        day.

        The time between two captures is no period of a poll, and no time during which a link was
        watched.
        """
        self._order.begin_capture()
        self._spans = self._joined_spans()
        for link in self.links.values():
            link.end_span()
        for poll in self.polls.values():
            poll.cut()

    def settle(self, before_ns: int | None = None) -> None:
        """Take the requests that still wait, in order of time, and count them in the periods, poll
        cycles and hours: those before `before_ns` (UTC ns), or all if it is None.
        """
        self._order.settle(before_ns)

    def _add_transaction(self, one: NamedTransaction) -> PollStatistics | None:
        self.transactions += 1
        self.damaged_ns = self._damaged.frame_of(one)
        link = self._link(one.link)
        link.note(one)
        name = one.link if one.link in self.links else OTHER_LINKS
        if name != one.link or one.request_ns is None:
            self._group((name, one.unit, one.function)).add(one)
            return None
        poll = self._poll(one)
        poll.tally.add(one)
        end_ns = max(one.response_ns or one.request_ns, one.request_ns)
        times = poll.times
        times.bins.add(one.request_ns, one.latency_ns)
        if one.request_ns < times.first_ns:
            times.first_ns = one.request_ns
        if end_ns > times.last_ns:
            times.last_ns = end_ns
        if one.response_ns is not None and end_ns > times.answered_ns:
            times.answered_ns = end_ns
        if one.outcome is not Outcome.OK:
            times.note_failure(one.outcome, one.request_ns)
        is_damaged, is_late = self.damaged_ns is not None, one.outcome is Outcome.LATE
        poll.tally.damaged += is_damaged
        if link.has_times:
            self._order.add(
                one.request_ns,
                poll,
                one.request_ns if is_late else end_ns,
                link.wire_ns(len(one.request_raw or b"")),
                is_missing=is_late or one.outcome is Outcome.NO_ANSWER,
                is_damaged=is_damaged,
                is_late=is_late,
            )
        return poll

    def _has_room(self, run: AnsweredRun) -> bool:
        """True if all links and polls of the batch `run` fit below MAX_LINKS and MAX_POLLS, and
        none of its links is a serial line whose bytes have no times.
        """
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
        """Count a group of equal requests, but not their latencies, and return the poll that they
        belong to.
        """
        self._link(kind.like.link).note_span(kind.like, kind.begin_ns, kind.end_ns)
        poll = self._poll(kind.like)
        poll.tally.count_alike(kind.like, kind.count)
        poll.times.note_answers(kind.begin_ns, kind.end_ns)
        return poll

    def _touch(self, run: AnsweredRun, polls: list[PollStatistics]) -> None:
        """Move the polls of a batch to the end of `self.polls`, in the order of their last
        requests.

        `self.polls` is kept in this order, because the first poll is removed at the limit.
        `polls[i]` is the poll of the group `run.kinds[i]`.
        """
        for kind in reversed(dict.fromkeys(reversed(run.kind))):
            self.polls.move_to_end(polls[kind].key)

    def _add_event(self, event: WireEvent) -> None:
        self._damaged.note(event)
        if event.kind is EventKind.BAD_CHECK:
            counts = self.bad_checks
            if event.link in counts or len(counts) < MAX_LINKS:
                counts[event.link] = counts.get(event.link, 0) + 1
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
        poll = self.polls[key] = PollStatistics(self.polls_seen, key, one, self._times(one))
        self.polls_seen += 1
        if len(self.function_names) < 256 or one.function in self.function_names:
            self.function_names[one.function] = one.function_name
        if one.device is not None and len(self.devices) < MAX_GROUPS:
            self.devices[one.link, one.unit] = one.device
        return poll

    def _times(self, one: NamedTransaction) -> UnitTimes:
        key = one.link, one.unit
        times = self.units.get(key)
        if times is None:
            times = UnitTimes(one.start_ns)
            if len(self.units) < MAX_GROUPS:
                self.units[key] = times
        return times

    def _group(self, key: Group) -> RequestTally:
        tally = self.groups.get(key)
        if tally is None:
            if len(self.groups) >= MAX_GROUPS:
                key = key[0], OTHER_UNITS, 0
            tally = self.groups.setdefault(key, RequestTally())
        return tally

    def _host(self, address: str | None) -> str:
        """The host in an address with a port (`10.0.0.1` in `10.0.0.1:50211`); empty for None."""
        if address is None:
            return ""
        host = self._hosts.get(address)
        if host is None:
            if len(self._hosts) >= _MAX_HOSTS:
                self._hosts.clear()
            host = self._hosts[address] = address.rpartition(":")[0].strip("[]")
        return host


def _count_asked(run: AnsweredRun, polls: list[PollStatistics]) -> None:
    """Count the requests of a batch with their units; `polls[i]` is the poll of `run.kinds[i]`."""
    for kind, poll in zip(run.kinds, polls, strict=True):
        poll.times.bins.add_answered(kind.request_ns, kind.latencies)
        if kind.like.outcome is not Outcome.OK:
            poll.times.note_failure(kind.like.outcome, min(kind.request_ns))
            poll.times.note_failure(kind.like.outcome, max(kind.request_ns))
