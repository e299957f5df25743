"""Keeps single transactions and events as evidence for the figures of the account."""

# The account (ledger/account.py) has the statistics of a capture, but no single transactions.
#
# Memory: MAX_EVIDENCE cases for each kind of failure of at most MAX_UNITS units; the SLOWEST
# answers of each of at most MAX_POLLS polls; MAX_EVIDENCE damaged frames for each of at most
# MAX_LINKS links; one opened connection for each of at most MAX_LINKS pairs of link and master.

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from heapq import heappush, heapreplace
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import CONNECTION_OPENED, EventKind, WireEvent
from mbtool.core.moments import duration, host_of
from mbtool.ledger.account import MAX_POLLS
from mbtool.ledger.poll_statistics import PollKey, PollStatistics, poll_key
from mbtool.modbus import Outcome
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Trouble

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.named_transaction import NamedTransaction

MAX_UNITS = 500
"""Cases are kept for at most this many units; further ones are ignored."""
SLOW_NS = 10_000_000
"""Answers that took less than this (ns) are not kept as cases."""
SLOWEST = 20
"""The number of slowest answers that are kept of each poll."""
_OUTCOMES = {
    "UNIT-SILENT": Outcome.NO_ANSWER,
    "UNIT-BAD-CRC": Outcome.NO_ANSWER,
    "UNIT-MISSING": Outcome.NO_ANSWER,
    "UNIT-MALFORMED": Outcome.MALFORMED,
    "UNIT-REFUSES": Outcome.EXCEPTION,
    "NET-SCANNED": Outcome.EXCEPTION,
    "NET-ONE-SIDE": Outcome.NOT_CAPTURED,
}
_FAILED = frozenset(_OUTCOMES.values())


class _SlowAnswer(NamedTuple):
    latency_ns: int
    negative_ns: int
    """The time of the request (UTC ns) with a minus."""
    number: int
    """The number of the slow answer, different for each, so that a heap never compares two by their
    evidence."""
    evidence: Evidence


class Cases(Sense):
    """Collects failed requests, slow answers, damaged frames and opened connections; finds no
    trouble by itself.
    """

    def __init__(self) -> None:
        self._failed: dict[tuple[str, int, Outcome], list[Evidence]] = {}
        self._slow: dict[PollKey, list[_SlowAnswer]] = {}
        """By poll, a heap of its slowest answers. If several answers are equally slow, the first
        are kept."""
        self._number = 0
        """The number of slow answers that were kept so far."""
        self._damaged: dict[str, list[Evidence]] = {}
        self._opened: dict[tuple[str, str], Evidence] = {}
        """By link and the master's host, the first connection that was opened."""

    def transaction(self, one: NamedTransaction) -> None:
        latency_ns = one.latency_ns
        if latency_ns is not None and latency_ns >= SLOW_NS and one.request_ns is not None:
            heap = self._heap(one)
            if _has_place(heap, latency_ns, one.request_ns):
                self._keep_slow(heap, latency_ns, Evidence.of(one, _took(latency_ns)))
        if one.outcome in _FAILED:
            cases = self._cases_of(one)
            if cases is not None:
                cases.append(Evidence.of(one))

    def _note_failed(self, run: QuietRun) -> None:
        """Note the first failed requests of each unit in a run, in the order of the responses."""
        failed = [form for form in run.forms if form.like.outcome in _FAILED]
        for place in sorted(each for form in failed for each in form.places[:MAX_EVIDENCE]):
            cases = self._cases_of(run.forms[run.form[place]].like)
            if cases is not None:
                cases.append(_evidence(run, place))

    def _cases_of(self, one: NamedTransaction) -> list[Evidence] | None:
        """Return the cases like this transaction; None if there is no room for one more."""
        key = one.link, one.unit, one.outcome
        cases = self._failed.get(key)
        if cases is None:
            if len(self._failed) >= MAX_UNITS:
                return None
            cases = self._failed[key] = []
        return cases if len(cases) < MAX_EVIDENCE else None

    def run(self, run: QuietRun) -> None:
        self._note_failed(run)
        for counts in run.opened_and_closed:
            if counts.first_opened_ns is not None:
                self._note_opened((counts.link, counts.host), counts.first_opened_ns)
        for place, latency_ns in run.slow(SLOW_NS, SLOWEST):
            heap = self._heap(run.like(place))
            if _has_place(heap, latency_ns, run.rows.request_ns[place]):
                self._keep_slow(heap, latency_ns, _evidence(run, place, _took(latency_ns)))

    def event(self, event: WireEvent) -> None:
        if event.kind is EventKind.OPENED and event.message == CONNECTION_OPENED:
            self._note_opened((event.link, host_of(event.source)), event.ts_ns)
        elif event.kind is EventKind.BAD_CHECK:
            cases = self._damaged.get(event.link)
            if cases is None:
                if len(self._damaged) >= MAX_LINKS:
                    return
                cases = self._damaged[event.link] = []
            if len(cases) < MAX_EVIDENCE:
                cases.append(Evidence.of_event(event))

    def _note_opened(self, key: tuple[str, str], at_ns: int) -> None:
        if key not in self._opened and len(self._opened) < MAX_LINKS:
            self._opened[key] = Evidence(
                ts_ns=at_ns, text=f"{CONNECTION_OPENED}, the first of them"
            )

    def _heap(self, one: NamedTransaction) -> list[_SlowAnswer]:
        """Return the slowest answers of a transaction's poll."""
        key = poll_key(one, host_of(one.source))
        heap = self._slow.get(key)
        if heap is None:
            heap = []
            if len(self._slow) < MAX_POLLS:
                self._slow[key] = heap
        return heap

    def _keep_slow(self, heap: list[_SlowAnswer], latency_ns: int, evidence: Evidence) -> None:
        self._number += 1
        case = _SlowAnswer(latency_ns, -evidence.ts_ns, self._number, evidence)
        if len(heap) < SLOWEST:
            heappush(heap, case)
        else:
            heapreplace(heap, case)

    def slowest(
        self, polls: Iterable[PollStatistics], least_ns: int = 0, since_ns: int = 0
    ) -> tuple[Evidence, ...]:
        """Return the slowest answers of some polls that took at least `least_ns`, of requests since
        `since_ns` (UTC ns), in the order of time.
        """
        found = [
            one.evidence
            for poll in polls
            for one in self._slow.get(poll.key, ())
            if one.latency_ns >= least_ns and one.evidence.ts_ns >= since_ns
        ]
        return _earliest_cases(found)

    def with_evidence(self, troubles: Iterable[Trouble]) -> Iterator[Trouble]:
        """Yield the troubles; those that only figures show get their cases as evidence."""
        for one in troubles:
            found: Iterable[Evidence] = one.evidence
            outcome = _OUTCOMES.get(one.code)
            if outcome is not None:
                found = (
                    case
                    for (link, unit, kind), cases in self._failed.items()
                    if kind is outcome and link == one.link and one.unit in (None, unit)
                    for case in cases
                )
            elif one.code == "LINE-STRAY":
                found = self._damaged.get(one.link, ())
            elif one.code == "NET-SHORT":
                found = (
                    case
                    for (link, host), case in self._opened.items()
                    if link == one.link and (one.master == host or one.master == "masters")
                )
            yield one if found is one.evidence else replace(one, evidence=_earliest_cases(found))


def _evidence(run: QuietRun, place: int, text: str = "") -> Evidence:
    """Return a transaction of a run as evidence."""
    at_ns = run.rows.request_ns[place]
    return Evidence(ts_ns=at_ns, text=text, file=run.file, packets=run.packets(place))


def _earliest_cases(cases: Iterable[Evidence]) -> tuple[Evidence, ...]:
    return tuple(sorted(cases, key=lambda one: one.ts_ns)[:MAX_EVIDENCE])


def _took(latency_ns: int) -> str:
    return f"answered after {duration(latency_ns)}"


def _has_place(heap: list[_SlowAnswer], latency_ns: int, at_ns: int) -> bool:
    return len(heap) < SLOWEST or (latency_ns, -at_ns) > heap[0][:2]
