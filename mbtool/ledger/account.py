"""The account: the statistics of a capture or of live links, by link, unit, master and poll."""

# This is the only place where requests are counted by poll and by unit (docs/stats.md defines each
# count). A poll is all equal requests of one master to one unit. Each transaction is counted at
# once in its poll. The counts of a unit, a function, a master or a link are the sums of the counts
# of their polls; a UseAccount has the counts of requests that belong to no poll. time_bins.py has
# the counts over time. Periods, retries and poll cycles need the requests sorted by time:
# request_order.py sorts them.
#
# Memory. At most MAX_POLLS polls: at the limit, the poll whose last request is oldest is removed,
# and its counts are added to those of its function. At most MAX_UNITS units, MAX_USES functions of
# units, MAX_MASTERS masters, MAX_LINKS links and MAX_PAIRS pairs of link and master. Further links,
# units and functions are counted together. A poll takes 2 to 10 KB in practice, and 130 KB if all
# its latencies and periods differ. time_bins.py, request_order.py and observation.py (only on
# request) state their own memory.

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from operator import add
from typing import TYPE_CHECKING

from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.ledger.link_statistics import LinkStatistics
from mbtool.ledger.master_tape import Lacks, MasterTape
from mbtool.ledger.observation import Observation
from mbtool.ledger.poll_statistics import PollKey, PollStatistics, poll_key
from mbtool.ledger.request_order import RequestOrder
from mbtool.ledger.statistics_connections import ConnectionTally
from mbtool.ledger.time_bins import LinkSum, TimeBins, UnitSum
from mbtool.ledger.unit_account import MasterAccount, UnitAccount, UnitKey, UseAccount, UseKey
from mbtool.modbus import Outcome
from mbtool.modbus.functions import FUNCTIONS, READ_WRITE_REGISTERS
from mbtool.modbus.response import DamagedAnswers

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import (
        AlikeRequests,
        ConnectionCounts,
        QuietRun,
        Stay,
    )
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.master_tape import TapedPoll
    from mbtool.ledger.request_tally import RequestTally

MAX_POLLS = 2048
"""The most polls with counts of their own; beyond it, the one asked least recently ends, and its
counts stay in those of its function."""
MAX_UNITS = 65_536
"""The most units of all links together; further ones are counted under OTHER_UNITS."""
MAX_USES = 131_072
"""The most pairs of unit and function; further ones are counted under OTHER_UNITS."""
MAX_MASTERS = 65_536
"""The most masters with counts of their own."""
MAX_LINKS = 65_536
"""The most links with counts of their own; further ones are counted under OTHER_LINKS."""
MAX_PAIRS = 4096
"""The most pairs of link and master whose connections are counted."""
_MAX_HOSTS = 65_536
"""The most addresses whose host is kept; if there are more, all are forgotten."""
_FEW = 2
"""A poll that is removed after at most so many requests belongs to no poll cycle."""

_CONNECTIONS = frozenset((EventKind.OPENED, EventKind.CLOSED, EventKind.REFUSED))
_SUMS_OF_EVENTS = {
    EventKind.BAD_CHECK: LinkSum.BAD_CHECK,
    EventKind.SKIPPED: LinkSum.NO_FRAME,
    EventKind.FOREIGN: LinkSum.NO_FRAME,
    EventKind.ECHO: LinkSum.NO_FRAME,
    EventKind.REPEATED: LinkSum.NO_FRAME,
    EventKind.GAP: LinkSum.LACKING,
    EventKind.DISCARDED: LinkSum.LACKING,
    EventKind.CUT: LinkSum.LACKING,
}
_SUMS_OF_OUTCOMES = {
    Outcome.OK: UnitSum.OK,
    Outcome.EXCEPTION: UnitSum.EXCEPTION,
    Outcome.NO_ANSWER: UnitSum.NO_ANSWER,
    Outcome.LATE: UnitSum.LATE,
}

OTHER_UNITS = -1
"""The unit under which all units and functions of a link that are beyond MAX_UNITS or MAX_USES are
counted together."""
OTHER_LINKS = ""
"""The link name under which all links beyond MAX_LINKS are counted together."""


class Account:
    """Counts transactions and events. Its attributes hold the results, and can be read at any
    time.
    """

    def __init__(
        self,
        format_of: Callable[[str], SerialFormat | None] = lambda _: None,
        on_retry: Callable[[PollStatistics, int, int], None] | None = None,
        *,
        is_part: bool = False,
        observes: bool = False,
    ) -> None:
        """Make an empty account.

        `format_of` is called with the name of a link. It returns the baud rate and character format
        of a serial line, None if they are unknown. `on_retry` is called for each retry after
        it was counted, with the arguments of `count_retry`. `is_part` is True if the account gets
        only some of the requests of another account: then it does not look for retries, and the
        caller adds them with `count_retry`. With `observes`, it notes what identifies a device.
        """
        self._format_of = format_of
        self._on_retry = on_retry
        self.bins = TimeBins()
        self.links: dict[str, LinkStatistics] = {}
        """The links that had a transaction or an event."""
        self.polls: OrderedDict[PollKey, PollStatistics] = OrderedDict()
        """The polls in the order of their last requests."""
        self.polls_seen = 0
        """The number of polls seen so far, including those removed because there were more than
        MAX_POLLS."""
        self.uses: dict[UseKey, UseAccount] = {}
        self.units: dict[UnitKey, UnitAccount] = {}
        self.masters: dict[str, MasterAccount] = {}
        """The masters by their hosts."""
        self.connections: dict[tuple[str, str], ConnectionTally] = {}
        """The counts of TCP connections; the key is the link and the master's host."""
        self.events: Counter[EventKind] = Counter()
        self.left_out = 0
        """The number of transactions that the caller did not add because of the user's filter. It
        adds all events, so these cannot be compared with the transactions then."""
        self.transactions = 0
        self.observation = Observation() if observes else None
        self._order = RequestOrder(None if is_part else self.count_retry)
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
        """The number of requests that were added too late to be sorted by time, so that periods
        and poll cycles lack them.
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

    def add_run(self, run: QuietRun) -> None:
        """Add many answered requests at once. The counts are the same as if `add` was called for
        each.
        """
        for counts in run.opened_and_closed:
            self._add_connections(counts)
        if not self._has_links(run):
            for one in run.transactions():
                self._add_transaction(one)
            return
        self.transactions += len(run)
        uses = [self._count_form(form, run) for form in run.forms]
        self._count_units(run, uses)
        rows = run.rows
        ends_ns = [*map(add, rows.request_ns, rows.latencies_ns)]
        self._order.add_answered(rows.request_ns, self._count_polls(run, uses), ends_ns)

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
        """Take the requests that still wait, in order of time, and count them in the periods,
        retries and poll cycles: those before `before_ns` (UTC ns), or all if it is None.
        """
        self._order.settle(before_ns)

    def count_retry(self, poll: PollStatistics, at_ns: int, number: int) -> None:
        """Count a request of the poll, sent at `at_ns` (UTC ns), as a retry, too; with `number` -1,
        as none after all.
        """
        poll.repetitions += number
        poll.use.repetitions += number
        poll.use.unit.bins.cell(at_ns)[UnitSum.RETRIES] += number
        if self._on_retry is not None:
            self._on_retry(poll, at_ns, number)

    def _add_transaction(self, one: NamedTransaction) -> PollStatistics | None:
        self.transactions += 1
        is_missing = one.outcome is Outcome.NO_ANSWER
        self.damaged_ns = self._damaged.frame_of(one) if is_missing else None
        is_damaged = self.damaged_ns is not None
        link = self.links.get(one.link) or self._link(one.link)
        at_ns, end_ns = one.request_ns, one.response_ns
        is_lone = at_ns is None
        if at_ns is None:
            at_ns = end_ns or 0
        if end_ns is None or end_ns < at_ns:
            end_ns = at_ns
        link.note_span(one, at_ns, end_ns)
        poll = None
        if is_lone or one.link not in self.links:
            use = self._use(one, self._host(one.source))
            tally = use.tally
        else:
            poll = self._poll(poll_key(one, self._host(one.source)), one)
            use, tally = poll.use, poll.tally
        if self.observation is not None and (poll is None or _is_new_kind(tally, one)):
            self._note_kind(use, one)
        tally.add(one)
        tally.damaged += is_damaged
        use.unit.note(one, at_ns, end_ns)
        cell = link.bins.cell(at_ns)
        cell[LinkSum.BYTES] += _size(one)
        if is_lone:
            if use.master is not None:
                use.master.note(one, at_ns, end_ns)
            return None
        cell[LinkSum.REQUESTS] += 1
        cell[LinkSum.NO_ANSWER] += is_missing
        self._count_request(use, one, at_ns, end_ns)
        if poll is not None and link.has_times:
            lacks = Lacks.RESPONSE if is_missing else Lacks.NOTHING
            if is_damaged:
                lacks = Lacks.CHECK
            elif one.outcome is Outcome.LATE:
                lacks, end_ns = Lacks.RESPONSE, at_ns
            wire_ns = link.wire_ns(len(one.request_raw or b""))
            self._order.add((at_ns, poll, end_ns, wire_ns, lacks))
        return poll

    def _count_request(
        self, use: UseAccount, one: NamedTransaction, at_ns: int, end_ns: int
    ) -> None:
        """Count a request in the bins of its unit; note with its unit and its master that it was
        sent at `at_ns`, and ended at `end_ns` (UTC ns).
        """
        outcome, latency_ns, unit = one.outcome, one.latency_ns, use.unit
        cell = unit.bins.cell(at_ns)
        cell[UnitSum.REQUESTS] += 1
        if latency_ns is not None:
            cell[UnitSum.LATENCIES] += 1
            cell[UnitSum.LATENCY_NS] += latency_ns
            if latency_ns > cell[UnitSum.GREATEST_NS]:
                cell[UnitSum.GREATEST_NS] = latency_ns
        elif self.damaged_ns is not None:
            cell[UnitSum.BAD_CHECK] += 1
        if one.response_ns is not None and end_ns > unit.answered_ns:
            unit.answered_ns = end_ns
        if outcome is Outcome.OK:
            cell[UnitSum.OK] += 1
        else:
            place = _SUMS_OF_OUTCOMES.get(outcome)
            if place is not None:
                cell[place] += 1
            unit.note_failure(outcome, at_ns)
        if use.master is not None:
            use.master.note(one, at_ns, end_ns)

    def _has_links(self, run: QuietRun) -> bool:
        """True if all links of `run` fit below MAX_LINKS, and none of them is a serial line whose
        bytes have no times.
        """
        links = {form.like.link for form in run.forms}
        known = [self.links[link] for link in links if link in self.links]
        if len(self.links) + len(links) - len(known) > MAX_LINKS:
            return False
        return all(link.has_times for link in known)

    def _count_polls(self, run: QuietRun, uses: Sequence[UseAccount]) -> list[TapedPoll]:
        """Count the requests of `run` with their polls, and return for each its poll. `uses` has
        the use of each form of its requests.

        Where there is no room for all polls, those that come and go within `run` get no entry:
        their requests are counted with the use of their function at once, which is returned in
        place of the poll.
        """
        held = self.polls
        stays = run.stays(held, MAX_POLLS, _FEW)
        asked: list[TapedPoll] = [uses[form] for form in run.form]
        polls = []
        for stay in (*stays.ended, *stays.left):
            key, place = PollKey._make(stay.name), stay.places[0]
            poll = held.get(key) if stay.number < 0 else None
            if poll is None:
                number = self.polls_seen + stay.number
                poll = PollStatistics(number, key, run.like(place), uses[run.form[place]])
            polls.append(poll)
            for place in stay.places:
                asked[place] = poll
        self.polls_seen += stays.begun
        if self.observation is not None:
            known = zip(polls, (*stays.ended, *stays.left), strict=True)
            old = ((poll, stay) for poll, stay in known if stay.number < 0)
            self._note_kinds_of(run, self.observation, uses, stays.fresh, old)
        for name in stays.dropped:
            held.pop(PollKey._make(name)).give_up()
        for stay, poll in zip(stays.ended, polls, strict=False):
            held.pop(poll.key, None)
            _count(run, stay.places, poll.tally)
            poll.give_up()
        of_uses: dict[UseAccount, list[int]] = {}
        for place in stays.passing:
            of_uses.setdefault(uses[run.form[place]], []).append(place)
        for use, places in of_uses.items():
            _count(run, places, use.tally)
        for stay, poll in zip(stays.left, polls[len(stays.ended) :], strict=True):
            _count(run, stay.places, poll.tally)
            held[poll.key] = poll
            held.move_to_end(poll.key)
        return asked

    def _note_kinds_of(
        self,
        run: QuietRun,
        observation: Observation,
        uses: Sequence[UseAccount],
        fresh: Sequence[int],
        held: Iterable[tuple[PollStatistics, Stay]],
    ) -> None:
        """Note what the requests of `run` ask for, before they are counted: those at the places
        `fresh`, which are the first ones of new polls, and those of the polls `held` before that
        end in a new way.
        """
        for poll, stay in held:
            for place in {
                run.rows.exceptions[place]: place for place in reversed(stay.places)
            }.values():
                like = run.forms[run.form[place]].like
                if _is_new_kind(poll.tally, like):
                    fresh = [*fresh, place]
        for place in sorted(fresh):
            like, use, asked = (
                run.forms[run.form[place]].like,
                uses[run.form[place]],
                run.rows.asked[place],
            )
            address, quantity = asked >> 16 & 0xFFFF, asked & 0xFFFF
            use.unit.transports.add(like.transport.value)
            is_refused, writes = like.exception is not None, FUNCTIONS[like.function].writes
            use.widen(address, quantity, writes=writes, is_refused=is_refused)
            observation.note_usual(use.unit, like, address, quantity)

    def _count_form(self, form: AlikeRequests, run: QuietRun) -> UseAccount:
        """Count a group of requests with their link, unit and master; return their use."""
        like = form.like
        link = self._link(like.link)
        link.note_span(like, form.begin_ns, form.end_ns)
        use = self._use(like, self._host(like.source))
        unit = use.unit
        unit.note(like, form.begin_ns, form.end_ns)
        unit.answered_ns = max(unit.answered_ns, form.end_ns)
        if use.master is not None:
            use.master.note(like, form.begin_ns, form.end_ns)
        if like.outcome is not Outcome.OK:
            times_ns = [run.rows.request_ns[place] for place in form.places]
            unit.note_failure(like.outcome, min(times_ns))
            unit.note_failure(like.outcome, max(times_ns))
        return use

    def _count_units(self, run: QuietRun, uses: Sequence[UseAccount]) -> None:
        """Count the requests of `run` over time with their units and links; `uses` has the use of
        each of its forms.
        """
        rows, by_time = run.rows, run.rows.request_ns.__getitem__
        of_units: dict[UnitAccount, list[int]] = {}
        of_links: dict[str, list[list[int]]] = {}
        for form, use in zip(run.forms, uses, strict=True):
            if use.unit not in of_units:
                of_links.setdefault(form.like.link, []).append(of_units.setdefault(use.unit, []))
            of_units[use.unit].extend(form.places)
        for unit, places in of_units.items():
            places.sort(key=by_time)
            latencies_ns = [*map(rows.latencies_ns.__getitem__, places)]
            refused = [rows.exceptions[place] >= 0 for place in places] if run.refused else []
            for cell, begin, end in unit.bins.cells_of([*map(by_time, places)]):
                some, exceptions = latencies_ns[begin:end], sum(refused[begin:end])
                cell[UnitSum.REQUESTS] += end - begin
                cell[UnitSum.LATENCIES] += end - begin
                cell[UnitSum.OK] += end - begin - exceptions
                cell[UnitSum.EXCEPTION] += exceptions
                cell[UnitSum.LATENCY_NS] += sum(some)
                cell[UnitSum.GREATEST_NS] = max(cell[UnitSum.GREATEST_NS], max(some))
        for link, several in of_links.items():
            places = several[0]
            if len(several) > 1:
                places = sorted(chain.from_iterable(several), key=by_time)
            asking = map(rows.request_bytes.__getitem__, places)
            sizes = [*map(add, asking, map(rows.response_bytes.__getitem__, places))]
            for cell, begin, end in self.links[link].bins.cells_of([*map(by_time, places)]):
                cell[LinkSum.REQUESTS] += end - begin
                cell[LinkSum.BYTES] += sum(sizes[begin:end])

    def _add_event(self, event: WireEvent) -> None:
        self.events[event.kind] += 1
        self._damaged.note(event)
        if event.kind in _CONNECTIONS:
            tally = self._connection_tally(event.link, self._host(event.source))
            if tally is not None:
                tally.add(event)
        place = _SUMS_OF_EVENTS.get(event.kind)
        if place is None:
            return
        link = self._link(event.link)
        cell = link.bins.cell(event.ts_ns)
        cell[place] += 1
        if place is not LinkSum.LACKING:
            cell[LinkSum.BYTES] += len(event.raw)
            if link.transport is not None:  # Count only after its first request.
                link.other_bytes += len(event.raw)
        link.bad_checks += place is LinkSum.BAD_CHECK

    def _add_connections(self, counts: ConnectionCounts) -> None:
        """Count the openings and closings of connections in a run."""
        for kind, number in ((EventKind.OPENED, counts.opened), (EventKind.CLOSED, counts.closed)):
            if number:
                self.events[kind] += number
        tally = self._connection_tally(counts.link, counts.host)
        if tally is not None:
            tally.add_whole(counts.opened, counts.closed, counts.most)

    def _connection_tally(self, link: str, host: str) -> ConnectionTally | None:
        tally = self.connections.get((link, host))
        if tally is None and len(self.connections) < MAX_PAIRS:
            tally = self.connections[link, host] = ConnectionTally()
        return tally

    def _link(self, name: str) -> LinkStatistics:
        link = self.links.get(name)
        if link is None:
            if len(self.links) >= MAX_LINKS:
                name = OTHER_LINKS
            link = self.links.get(name)
            if link is None:
                link = self.links[name] = LinkStatistics(self._format_of, self.bins.row())
        return link

    def _poll(self, key: PollKey, one: NamedTransaction) -> PollStatistics:
        """Return the poll with this key; `one` is one of its transactions."""
        poll = self.polls.get(key)
        if poll is not None:
            self.polls.move_to_end(key)
            return poll
        use = self._use(one, key.master)
        if len(self.polls) >= MAX_POLLS:
            _, given_up = self.polls.popitem(last=False)
            given_up.give_up()
        poll = self.polls[key] = PollStatistics(self.polls_seen, key, one, use)
        self.polls_seen += 1
        return poll

    def _use(self, one: NamedTransaction, host: str) -> UseAccount:
        """Return the use of a transaction's function by its master, at `host`."""
        name = one.link if one.link in self.links else OTHER_LINKS
        key = UseKey(name, one.unit, one.function, host)
        use = self.uses.get(key)
        return self._new_use(key, one) if use is None else use

    def _new_use(self, key: UseKey, one: NamedTransaction) -> UseAccount:
        name = key.link
        unit = self.units.get(UnitKey(name, one.unit))
        if unit is None and len(self.units) < MAX_UNITS:
            unit = UnitAccount(UnitKey(name, one.unit), one, self.bins.row())
            self.units[unit.key] = unit
        if unit is None or len(self.uses) >= MAX_USES:
            key = UseKey(name, OTHER_UNITS, 0, "")
            use = self.uses.get(key)
            if use is not None:
                return use
            unit = UnitAccount(UnitKey(name, OTHER_UNITS), one, self.bins.row())
        use = UseAccount(key, one.function_name, unit, self._master(one, key.master))
        self.uses[key] = use
        return use

    def _master(self, one: NamedTransaction, host: str) -> MasterAccount | None:
        master = self.masters.get(host)
        if master is None and host:
            if len(self.masters) >= MAX_MASTERS:
                return None
            master = self.masters[host] = MasterAccount(one.start_ns)
        return master

    def _note_kind(self, use: UseAccount, one: NamedTransaction) -> None:
        """Note what a request asks for. Of equal requests that end alike one is enough, unless they
        have no address: the response may then hold other texts each time.
        """
        use.unit.transports.add(one.transport.value)
        is_refused = one.exception is not None
        if one.function == READ_WRITE_REGISTERS:
            use.widen(one.address, one.quantity, writes=False, is_refused=is_refused)
            use.widen(one.write_address, one.written_quantity, writes=True, is_refused=is_refused)
        else:
            known = FUNCTIONS.get(one.function)
            writes = known is not None and known.writes
            use.widen(one.address, one.quantity, writes=writes, is_refused=is_refused)
        if self.observation is not None:
            self.observation.note(use.unit, one)

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


def _count(run: QuietRun, places: list[int], tally: RequestTally) -> None:
    """Count requests of `run`."""
    rows, forms = run.rows, dict.fromkeys(map(run.form.__getitem__, places))
    for form in forms:
        some = places if len(forms) == 1 else [one for one in places if run.form[one] == form]
        request_bytes = sum(map(rows.request_bytes.__getitem__, some))
        response_bytes = sum(map(rows.response_bytes.__getitem__, some))
        tally.count_alike(run.forms[form].like, len(some), request_bytes, response_bytes)
    tally.latency.add_all([*map(rows.latencies_ns.__getitem__, places)])


def _size(one: NamedTransaction) -> int:
    return len(one.request_raw or b"") + len(one.response_raw or b"")


def _is_new_kind(tally: RequestTally, one: NamedTransaction) -> bool:
    """True if no request of a poll, whose counts are `tally`, ended as this one so far, or if it
    has no address.
    """
    if one.outcome not in tally.outcomes or one.address is None:
        return True
    return one.exception is not None and one.exception not in tally.exceptions
