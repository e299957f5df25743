"""Finds NET-BLOCKED, NET-SHARED and NET-LATE: requests that wait for another request, and late
answers.
"""

# NET-BLOCKED  One address has several units: a gateway with a serial line behind it, which handles
#              one request at a time. While one unit is slow or silent, the requests to the other
#              units wait, and are slow or fail, too. Slow (SLOW_NS) and unanswered requests are
#              sorted by time: the turn of each begins when the previous one ends. A request is
#              blocked if it waited mostly for a request to another unit. A unit is the cause if
#              others wait for it much more often than it waits for others in the same time.
# NET-SHARED   Several masters ask one slave at the same time, and it handles one request at a time,
#              in their order: a gateway with one line. A request waits if a request of another
#              master was sent before it and is answered WAIT_NS or more after it was sent; this
#              time is its wait. The slave is shared if the latency of the requests of each poll
#              rises with the wait, by as much (SLOPE), and if hardly a request (MIN_IN_ORDER) is
#              answered before the one that it waited for. A server that handles requests in
#              parallel shows no such rise.
# NET-LATE     An answer comes after the master has sent its next request on the same connection,
#              and this request came SHORTEST_TIMEOUT_NS or more after the first one: the master
#              had given the first one up. Nearly always it waited equally long. Masters that
#              pipeline send requests at any time, so they are left out.
#
# False alarms: two units of a gateway that are both slow by themselves wait for each other equally
# often, so none is the cause. A request that is answered before a slow one did not wait for it. A
# slow network makes all units equally slow. Masters of a PLC that answers all requests at the end
# of its cycle do not wait for each other (SERVED_NS). Waits for a unit that is much slower than the
# others (SLOWER) are that unit's fault, and do not count.
#
# Memory: KEPT_REQUESTS slow requests, and KEPT_REQUESTS requests that may wait, for each of at most
# MAX_LINKS links; the last RECENT requests and a few numbers for each of at most MAX_LINKS
# connections; MAX_EVIDENCE cases for each unit.

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from statistics import median, median_low
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.moments import DAY_NS, duration, host_of
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus import Outcome
from mbtool.modbus.functions import GATEWAY_EXCEPTIONS
from mbtool.troubles.failed_shares import time_of_failures
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Sureness, Trouble

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.ledger.statistics_report import LinkReport

SLOW_NS = 300_000_000
"""Requests that take at least this long (ns), or get no answer, are kept for NET-BLOCKED."""
SHORTEST_TIMEOUT_NS = 300_000_000
"""If the next request comes at least this long (ns) after one without an answer so far, the master
may have given that one up: a sign of NET-LATE."""
LONGEST_NS = 10_000_000_000
"""A request that ends later than this (ns) after it was sent does not block the requests after
it."""
UNANSWERED_NS = 1_000_000_000
"""A gateway's line is taken as blocked for at least this long (ns) by a request without an answer,
as the capture does not show when the gateway gave it up."""
MIN_CASES = 3
"""The least number of blocked requests of NET-BLOCKED, or of late answers of NET-LATE."""
MIN_BLOCKED_RATIO = 2
"""A unit is the cause of NET-BLOCKED only if requests to others waited for it at least this many
times as often as its requests waited for others."""
MIN_BLOCKED_WAIT = 0.5
"""A request was blocked if one request to another unit took at least this share (0 to 1) of its
wait for its turn."""
MIN_BLOCKED_REQUESTS = 0.5
"""A unit is a victim if at least this share (0 to 1) of its slow requests was blocked, both over
the whole recording and while the other unit blocked requests."""
WAIT_TOLERANCE = 0.15
"""Waits of a master count as its time-out if they differ from their median by at most this share
(0 to 1)."""
WAIT_NS = 40_000_000
"""A request waits for another master's request if that one is answered at least this long (ns)
after it was sent."""
MIN_WAITS = 20
"""NET-SHARED is reported from this many waiting requests on."""
MIN_WAITING_SHARE = 0.1
"""NET-SHARED is reported only if at least this share (0 to 1) of the link's requests waits for
another master's request."""
SLOPE = (0.6, 1.5)
"""NET-SHARED is reported only if the rise of the latency with the wait (ns of latency for each ns
of wait, from a linear fit) is in this range; 1 means that the wait is all of the delay."""
MIN_IN_ORDER = 0.9
"""NET-SHARED is reported only if at least this share (0 to 1) of the waiting requests is answered
after the request that they waited for."""
SERVED_NS = 5_000_000
"""NET-SHARED is reported only if the median time from a request's turn (the end of the one it
waited for) to its answer is at least this long (ns)."""
SLOWER = 2.5
"""A unit whose median time from turn to answer is at least this many times that of the other units
is slow by itself: requests that wait for it do not count for NET-SHARED."""
KEPT_REQUESTS = 5000
"""At most this many slow requests, and this many requests that may wait, are kept for each link;
beyond it, the oldest is forgotten."""
RECENT = 8
"""The last transactions of a connection, or requests of a line, that a new one is compared with."""
MIN_TIMEOUT_SHARE = 0.8
"""NET-LATE is reported only if at least this share (0 to 1) of the times at which a master had two
requests open follows the same wait, its time-out. A master that pipelines sends at other times,
too."""


class _Slow(NamedTuple):
    """A request that was slow or not answered; times in ns."""

    begin_ns: int
    end_ns: int | None
    """The time at which the answer was complete; None if the request was not answered."""
    unit: int
    evidence: Evidence


class _BlockedRequest(NamedTuple):
    """A request that waited for one to another unit, `by`; times in ns."""

    of: _Slow
    by: int
    turn_ns: int
    """The time (ns since 1970) at which the gateway began to serve the request to `by`."""
    held_ns: int
    """The time in ns for which the request to `by` held up the line."""


class _SlowRequest(NamedTuple):
    """A request that was answered after WAIT_NS or more; times in ns."""

    begin_ns: int
    end_ns: int
    master: str
    unit: int
    address: int | None


class _SharedWait(NamedTuple):
    """A request that waited for the one of another master before it."""

    of: _SlowRequest
    before: _SlowRequest

    @property
    def wait_ns(self) -> int:
        return self.before.end_ns - self.of.begin_ns

    @property
    def served_ns(self) -> int:
        """The time (ns) from its turn, when the request before it ended, to its answer."""
        return self.of.end_ns - self.before.end_ns


@dataclass(slots=True)
class _SharedLink:
    """The requests of several masters to one link."""

    first: str
    """The master that was heard first."""
    masters: set[str] = field(default_factory=set)
    """All masters, once there are two."""
    waiting: deque[_SlowRequest] = field(default_factory=lambda: deque(maxlen=KEPT_REQUESTS))


@dataclass(slots=True)
class _MasterTalk:
    recent: deque[tuple[int, NamedTransaction]] = field(
        default_factory=lambda: deque(maxlen=RECENT)
    )
    """The last transactions, and when each began."""
    overlaps: int = 0
    """The number of requests that came while an earlier one had no answer yet, counted until `late`
    is full."""
    late: list[tuple[NamedTransaction, int]] = field(default_factory=list)
    """Pairs of a transaction whose answer came after the next request, and the time (ns) from the
    first request to the next."""


class Gateways(Sense):
    """Finds NET-BLOCKED, NET-SHARED and NET-LATE."""

    def __init__(self) -> None:
        self._slow: dict[str, deque[_Slow]] = {}
        self._shared: dict[str, _SharedLink] = {}
        self._connections: OrderedDict[tuple[str, str | None], _MasterTalk] = OrderedDict()
        self._late: dict[tuple[str, int], list[tuple[Evidence, int, int]]] = {}
        """By link and unit: cases, with the latency and how long the master waited (ns)."""

    def begin_capture(self) -> None:
        self._connections.clear()

    def transaction(self, one: NamedTransaction) -> None:
        if one.transport.is_serial or one.request_ns is None:
            return
        latency_ns = one.latency_ns
        is_failed = one.outcome is Outcome.NO_ANSWER or one.exception in GATEWAY_EXCEPTIONS
        if is_failed or (latency_ns is not None and latency_ns >= SLOW_NS):
            slow = _Slow(one.request_ns, one.response_ns, one.unit, Evidence.of(one))
            self._keep(one.link, slow)
        shared = self._shared_by(one)
        if shared is not None and latency_ns is not None and latency_ns >= WAIT_NS:
            end_ns = one.request_ns + latency_ns
            shared.waiting.append(
                _SlowRequest(one.request_ns, end_ns, host_of(one.source), one.unit, one.address)
            )
        self._note_overlap(one)

    def run(self, run: QuietRun) -> None:
        for form in run.forms:
            self._shared_by(form.like)
        for place, latency_ns in run.slow(min(WAIT_NS, SLOW_NS)):
            like, at_ns = run.forms[run.form[place]].like, run.rows.request_ns[place]
            shared = self._shared_by(like)
            if shared is not None and latency_ns >= WAIT_NS:
                master, address = host_of(like.source), run.like(place).address
                end_ns = at_ns + latency_ns
                shared.waiting.append(_SlowRequest(at_ns, end_ns, master, like.unit, address))
            if latency_ns >= SLOW_NS:
                evidence = Evidence(ts_ns=at_ns, file=run.file, packets=run.packets(place))
                self._keep(like.link, _Slow(at_ns, at_ns + latency_ns, like.unit, evidence))

    def _shared_by(self, one: NamedTransaction) -> _SharedLink | None:
        """Return the requests of the link of a transaction if it has several masters."""
        shared = self._shared.get(one.link)
        if shared is None:
            if len(self._shared) < MAX_LINKS:
                self._shared[one.link] = _SharedLink(host_of(one.source))
            return None
        host = host_of(one.source)
        if not shared.masters and host == shared.first:
            return None
        if len(shared.masters) < RECENT:
            shared.masters |= {shared.first, host}
        return shared

    def _keep(self, link: str, slow: _Slow) -> None:
        kept = self._slow.get(link)
        if kept is None:
            if len(self._slow) >= MAX_LINKS:
                return
            kept = self._slow[link] = deque(maxlen=KEPT_REQUESTS)
        kept.append(slow)

    def _note_overlap(self, one: NamedTransaction) -> None:
        key = one.link, one.source
        connection = self._connections.get(key)
        if connection is None:
            if len(self._connections) >= MAX_LINKS:
                self._connections.popitem(last=False)
            connection = self._connections[key] = _MasterTalk()
        self._connections.move_to_end(key)
        begin_ns = one.start_ns
        for other_ns, other in connection.recent:
            if (begin_ns >= other_ns and (other.response_ns or 0) <= begin_ns) or (
                begin_ns < other_ns and (one.response_ns or 0) <= other_ns
            ):
                continue  # The usual case: no two requests were open at once.
            first, second = sorted((one, other), key=lambda each: each.start_ns)
            end_ns = first.response_ns
            if end_ns is not None and first.start_ns < second.start_ns < end_ns:
                waited_ns = second.start_ns - first.start_ns
                if len(connection.late) < MAX_EVIDENCE:
                    connection.overlaps += 1
                    if waited_ns >= SHORTEST_TIMEOUT_NS:
                        connection.late.append((first, waited_ns))
        connection.recent.append((begin_ns, one))

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        asked = {
            (link.name, one.unit): one.tally.requests for link in links for one in link.functions
        }
        whole = {link.name for link in links if link.is_whole}
        for of_link in links:
            slow, shared = self._slow.get(of_link.name), self._shared.get(of_link.name)
            if of_link.is_whole and slow is not None:
                yield from _blocked_troubles(of_link, slow)
            if of_link.is_whole and shared is not None and shared.waiting:
                yield from _masters_wait_trouble(of_link, shared)
        late: dict[tuple[str, int], list[tuple[NamedTransaction, int]]] = {}
        for connection in self._connections.values():
            cases = _cases_with_equal_wait(connection.late)
            if len(cases) >= MIN_TIMEOUT_SHARE * connection.overlaps:
                for case in cases:
                    late.setdefault((case[0].link, case[0].unit), []).append(case)
        for (link, unit), cases in late.items():
            distinct = _cases_with_equal_wait(
                [*{case[0].start_ns: case for case in cases}.values()]
            )
            if link in whole and len(distinct) >= MIN_CASES:
                yield _late_answers_trouble(link, unit, distinct, asked.get((link, unit), 0))


def _cases_with_equal_wait(
    cases: list[tuple[NamedTransaction, int]],
) -> list[tuple[NamedTransaction, int]]:
    """Return the cases in which the master waited about equally long, as for a time-out."""
    if not cases:
        return []
    usual_ns = median(waited_ns for _, waited_ns in cases)
    return [case for case in cases if abs(case[1] - usual_ns) <= WAIT_TOLERANCE * usual_ns]


def _late_answers_trouble(
    link: str, unit: int, cases: Sequence[tuple[NamedTransaction, int]], asked: int
) -> Trouble:
    latencies = [one.latency_ns or 0 for one, _ in cases]
    return Trouble(
        code="NET-LATE", link=link, unit=unit, count=len(cases), of=max(asked, len(cases)),
        weight=len(cases),
        figures={
            "latency": duration(median(latencies)),
            "timeout": duration(median(waited for _, waited in cases)),
            "longest": duration(max(latencies)),
        },
        sureness=Sureness.LIKELY,
        evidence=tuple(Evidence.of(one) for one, _ in cases),
    )  # fmt: skip


def _masters_wait_trouble(link: LinkReport, shared: _SharedLink) -> Iterator[Trouble]:
    """Yield the trouble that masters wait for each other, if they do."""
    waits, overtakes = _waits_of(shared.waiting)
    holders = _slower_units(shared.waiting, waits)
    waits = [one for one in waits if one.before.unit not in holders]
    number, asked = len(waits), link.tally.requests
    if (
        number < max(MIN_WAITS, MIN_WAITING_SHARE * asked)
        or overtakes > (1 - MIN_IN_ORDER) * number
    ):
        return
    groups: dict[tuple[str, int, int | None], list[_SharedWait]] = {}
    for one in waits:
        groups.setdefault((one.of.master, one.of.unit, one.of.address), []).append(one)
    if median(one.served_ns for one in waits) < SERVED_NS:
        return
    if not SLOPE[0] <= _slope([*groups.values()]) <= SLOPE[1]:
        return
    masters = sorted(shared.masters)
    yield Trouble(
        code="NET-SHARED", link=link.name, count=number, of=max(asked, number), weight=number,
        figures={
            "masters": " and ".join(masters) if len(masters) == 2 else f"{len(masters)} masters",
            "wait": duration(median(one.wait_ns for one in waits)),
        },
        sureness=Sureness.LIKELY,
        evidence=tuple(
            Evidence(ts_ns=one.of.begin_ns, text=f"waited for {duration(one.wait_ns)}")
            for one in waits[:MAX_EVIDENCE]
        ),
    )  # fmt: skip


def _waits_of(requests: Iterable[_SlowRequest]) -> tuple[list[_SharedWait], int]:
    """Return the requests that wait for one of another master, and how many of them overtake it."""
    waits, overtakes = [], 0
    open_: list[_SlowRequest] = []
    for one in sorted(requests, key=lambda each: (each.begin_ns, each.end_ns)):
        open_ = [each for each in open_ if each.end_ns > one.begin_ns + WAIT_NS]
        before = max(
            (each for each in open_ if each.master != one.master),
            key=lambda each: each.end_ns, default=None,
        )  # fmt: skip
        if before is not None:
            overtakes += one.end_ns < before.end_ns
            waits.append(_SharedWait(one, before))
        open_.append(one)
    return waits, overtakes


def _slower_units(requests: Iterable[_SlowRequest], waits: Sequence[_SharedWait]) -> set[int]:
    """Return the units that take SLOWER times as long as others when they have their turn."""
    served: dict[int, list[int]] = {}
    for one in waits:
        served.setdefault(one.of.unit, []).append(one.served_ns)
    waiting = {one.of for one in waits}
    for each in requests:
        if each not in waiting:
            served.setdefault(each.unit, []).append(each.end_ns - each.begin_ns)
    usual = {unit: median(times) for unit, times in served.items()}
    return {
        unit
        for unit, time in usual.items()
        if (others := [other for number, other in usual.items() if number != unit])
        and time >= SLOWER * median_low(others)
    }


def _slope(groups: Sequence[Sequence[_SharedWait]]) -> float:
    """Return by how much the latency rises with the wait within groups; 0 if no wait differs from
    the others of its group.
    """
    squares = products = 0.0
    for some in groups:
        mean = sum(one.wait_ns for one in some) / len(some)
        squares += sum((one.wait_ns - mean) ** 2 for one in some)
        products += sum((one.wait_ns - mean) * (one.wait_ns + one.served_ns) for one in some)
    return products / squares if squares else 0.0


def _blocked_troubles(link: LinkReport, slow: Sequence[_Slow]) -> Iterator[Trouble]:
    """Yield the units of a gateway that the requests to its other units wait for."""
    waits: dict[int, list[_BlockedRequest]] = {}
    """By unit, the requests to other units that waited for it."""
    of_unit: dict[int, list[int]] = {}
    """By unit, the times of its requests that waited for other units."""
    for one in _blocked_requests(slow):
        waits.setdefault(one.by, []).append(one)
        of_unit.setdefault(one.of.unit, []).append(one.of.begin_ns)
    own = Counter(one.unit for one in slow)
    for unit, blocked in waits.items():
        first_ns, last_ns = blocked[0].of.begin_ns, blocked[-1].of.begin_ns
        then = Counter(one.unit for one in slow if first_ns <= one.begin_ns <= last_ns)
        back = sum(first_ns <= at_ns <= last_ns for at_ns in of_unit.get(unit, ()))
        if len(blocked) < MIN_CASES or len(blocked) < MIN_BLOCKED_RATIO * back:
            continue
        victims = Counter(one.of.unit for one in blocked)
        told = sorted(
            number
            for number, count in victims.items()
            if count >= MIN_BLOCKED_REQUESTS * then[number]
            and len(of_unit[number]) >= MIN_BLOCKED_REQUESTS * own[number]
        )
        if not told:
            continue
        begin_ns, end_ns = link.begin_ns, link.end_ns
        is_late, is_over = time_of_failures(begin_ns, first_ns, last_ns, end_ns)
        held = {one.turn_ns: one.held_ns for one in blocked}
        yield Trouble(
            code="NET-BLOCKED", link=link.name, unit=unit, count=len(blocked),
            of=sum(then[number] for number in victims), weight=len(blocked), victims=tuple(told),
            since_ns=first_ns if is_late else None, until_ns=last_ns if is_over else None,
            is_long=end_ns - begin_ns >= DAY_NS,
            figures={
                "held": duration(median(held.values())),
                "units": " and ".join(f"unit {number}" for number in sorted(victims)[:3]),
            },
            sureness=Sureness.LIKELY,
            evidence=tuple(one.of.evidence for one in blocked[:MAX_EVIDENCE]),
        )  # fmt: skip


def _blocked_requests(slow: Iterable[_Slow]) -> Iterator[_BlockedRequest]:
    """Yield the requests that waited most of all for one to another unit, in the order of time.

    A gateway serves one request at a time, in their order: each has its turn when the one before it
    has ended.
    """
    in_order = sorted(slow, key=lambda one: (one.begin_ns, one.unit))
    recent: deque[tuple[int, int, int]] = deque(maxlen=RECENT)
    """The last requests: when each had its turn, when it ended (UTC ns), and its unit."""
    free_ns = 0
    for at, one in enumerate(in_order):
        turn_ns = max(one.begin_ns, free_ns)
        end_ns = _answered_ns(in_order, at) if one.end_ns is None else one.end_ns
        waited = [
            (end - max(turn, one.begin_ns), turn, end, unit)
            for turn, end, unit in recent
            if one.begin_ns < end <= end_ns and end - turn >= SLOW_NS
        ]
        longest_ns, turn, end, unit = max(waited, default=(0, 0, 0, one.unit))
        if unit != one.unit and longest_ns >= MIN_BLOCKED_WAIT * (turn_ns - one.begin_ns):
            yield _BlockedRequest(one, unit, turn, end - turn)
        if turn_ns < end_ns <= one.begin_ns + LONGEST_NS:
            recent.append((turn_ns, end_ns, one.unit))
            free_ns = end_ns


def _answered_ns(in_order: Sequence[_Slow], at: int) -> int:
    """Return when a request without an answer ended (UTC ns): the line answers the next request
    then.
    """
    least_ns = in_order[at].begin_ns + UNANSWERED_NS
    after = takewhile(lambda one: one.begin_ns <= least_ns, in_order[at + 1 :])
    return max(least_ns, min((one.end_ns for one in after if one.end_ns), default=0))
