"""Finds LINE-LATE: answers that come after the master has given up their request."""

# The decoder marks late responses. The time-out is the time from a request without a response in
# time to the next request on the line.
#
# A late answer may collide with the next request, so that nobody can read it. A disturbed window is
# the time in which this can happen: it begins with the next request and lasts as long as the master
# waited for the answer. So two kinds of units count as late without readable late answers:
#
# - units some of whose answers come just before the time-out (NEAR_TIMEOUT), while others are
#   missing;
# - units that answer some requests in time, if damaged frames come in the windows of their missing
#   answers and hardly at other times. A unit that never answers in time may be dead, so it counts
#   as late only if another unit's request fails in most of these windows.
#
# False alarms: an answer to a damaged request may be taken for a late answer to the request before.
# So a response directly after damaged bytes does not count as late. If many frames are damaged, a
# master that sends its next request as soon as after an answer (MIN_WAIT_TO_PACE) did not wait for
# a time-out: it got the answer, and the recording lacks it.
#
# Memory: MAX_EVIDENCE cases and KEPT_TIMES times for each of at most MAX_UNITS units; the last
# requests and damaged frames (KEPT_FRAMES of each) and the open windows for each of at most
# MAX_LINKS links.

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.modbus import Outcome
from mbtool.troubles.sense import DAMAGE, MAX_LINKS, SortedSense
from mbtool.troubles.trouble import Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from mbtool.ledger.statistics_report import LinkReport

MIN_CASES = 3
"""LINE-LATE is a note if a unit has fewer late answers than this. Missing answers, damaged windows
and measured times count only if there are at least this many."""
MIN_LATE_SHARE = 0.01
"""LINE-LATE is a note if late answers are a smaller share (0 to 1) of a unit's requests than this.
Missing answers with latencies near the time-out count only if they are at least this share."""
SHORTEST_TIMEOUT_NS = 100_000_000
"""A request that comes less than this (ns) after one without an answer did not follow a time-out:
another master sent it, or the recording lacks the answer."""
MAX_UNITS = 500
"""Late answers are kept for at most this many units, of all links together."""
KEPT_TIMES = 200
"""The number of last times (ns) of each kind that are kept of a unit."""
KEPT_FRAMES = 64
"""The times (ns) of this many last requests, and of as many damaged frames, are kept of each
line."""
MIN_WAIT_TO_PACE = 1.1
"""A master has waited for its time-out if its wait (ns) is at least this many times its median time
from an answered request to the next one."""
DAMAGE_PER_LATE_ANSWER = 0.5
"""If a line has at least this many damaged frames for each late or missing answer of a unit, damage
explains these answers, unless the master has waited for its time-out."""
MIN_DAMAGED_WINDOWS = 0.5
"""A unit that answers some requests in time is blamed for damage only if at least this share (0 to
1) of its disturbed windows (_DisturbedWindow) has damage."""
MIN_FAILED_WINDOWS = 0.8
"""A unit that never answers in time is blamed for damage only if at least this share (0 to 1) of
its disturbed windows has damage and a failed request to another unit."""
MAX_WINDOWS_SHARE = 0.5
"""A unit is blamed for damage only if its disturbed windows take at most this share (0 to 1) of the
recording. If they took more, damage would come in them by chance."""
MIN_OWN_DAMAGE = 0.7
"""Damage on a line is blamed on a unit's late answers only if at least this share (0 to 1) of it
follows requests to this unit that were not answered in time."""
NEAR_TIMEOUT = 0.85
"""Missing answers of a unit are called late if the 95th percentile of its latencies is at least
this share (0 to 1) of the master's time-out."""


@dataclass(slots=True)
class _LateUnit:
    """The late and the missing answers of a unit; times in ns."""

    count: int = 0
    missing: int = 0
    latencies: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT_TIMES))
    waits: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT_TIMES))
    """The times (ns) from requests without an answer in time to the master's next request."""
    paces: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=KEPT_TIMES))
    """Pairs of times (ns) of answered requests: the latency, and the time from request to next
    request."""
    cases: list[Evidence] = field(default_factory=list)
    missing_cases: list[Evidence] = field(default_factory=list)
    windows: int = 0
    """The number of disturbed windows after requests to this unit."""
    windows_ns: int = 0
    """The sum of the lengths of the disturbed windows, in ns."""
    damaged_windows: int = 0
    failed_windows: int = 0
    """The number of damaged windows in which another unit's request failed."""
    damage: int = 0
    """The number of damaged frames in disturbed windows."""


@dataclass(slots=True)
class _DisturbedWindow:
    """The time in which a late answer to a request of a unit may disturb other requests."""

    unit: _LateUnit
    end_ns: int
    is_damaged: bool = False
    has_failed: bool = False
    """True if a request to another unit got no answer in this window."""


@dataclass(slots=True)
class _LateLine:
    last: NamedTransaction | None = None
    """The last transaction. It is judged once the time of the master's next request is known."""
    pending: list[NamedTransaction] = field(default_factory=list)
    """Late transactions whose response is not reached yet."""
    requests: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT_FRAMES))
    """The times (ns) of the last requests."""
    damage: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT_FRAMES))
    """The times (ns) of the last damaged frames."""
    damaged: int = 0
    units: set[int] = field(default_factory=set)
    windows: list[_DisturbedWindow] = field(default_factory=list)
    begin_ns: int | None = None
    end_ns: int = 0

    def is_answer_to_damaged(self, one: NamedTransaction) -> bool:
        """True if the last frame before a late response is a damaged one: its request."""
        asked_ns, come_ns = one.request_ns or 0, one.response_ns or 0
        damage = max((at for at in self.damage if asked_ns < at < come_ns), default=0)
        return damage > max((at for at in self.requests if at < come_ns), default=0)


class LateOnLine(SortedSense):
    """Finds LINE-LATE."""

    def __init__(self) -> None:
        super().__init__()
        self._units: dict[tuple[str, int], _LateUnit] = {}
        self._lines: dict[str, _LateLine] = {}

    def begin_capture(self) -> None:
        super().begin_capture()
        for name, line in self._lines.items():
            self._resolve(name, line, None)
            line.last = None
            line.windows.clear()

    def flush(self) -> None:
        super().flush()
        for name, line in self._lines.items():
            self._resolve(name, line, None)

    def take_event(self, event: WireEvent) -> None:
        if event.kind not in DAMAGE or len(set(event.raw)) < 2:  # One repeated byte: an idle line.
            return
        if (line := self._line(event.link)) is None:
            return
        self._resolve(event.link, line, event.ts_ns)
        line.damage.append(event.ts_ns)
        line.damaged += 1
        for window in line.windows:
            window.unit.damage += 1
            window.unit.damaged_windows += not window.is_damaged
            window.unit.failed_windows += not window.is_damaged and window.has_failed
            window.is_damaged = True

    def take_transaction(self, one: NamedTransaction) -> None:
        if one.request_ns is None or (line := self._line(one.link)) is None:
            return
        self._resolve(one.link, line, one.request_ns)
        line.begin_ns = one.request_ns if line.begin_ns is None else line.begin_ns
        line.end_ns = one.request_ns
        self._note_wait(line, one)
        if one.outcome is Outcome.NO_ANSWER:
            for window in line.windows:
                window.has_failed |= window.unit is not self._unit(one)
        line.requests.append(one.request_ns)
        line.units.add(one.unit)
        if one.outcome is Outcome.LATE:
            line.pending.append(one)
        if (unit := self._unit(one)) is not None:
            line.last = one
            if one.outcome is Outcome.NO_ANSWER:
                unit.missing += 1
                keep(unit.missing_cases, Evidence.of(one))

    def _line(self, link: str) -> _LateLine | None:
        line = self._lines.get(link)
        if line is None and len(self._lines) < MAX_LINKS:
            line = self._lines[link] = _LateLine()
        return line

    def _unit(self, one: NamedTransaction) -> _LateUnit | None:
        unit = self._units.get((one.link, one.unit))
        if unit is None and len(self._units) < MAX_UNITS:
            unit = self._units[one.link, one.unit] = _LateUnit()
        return unit

    def _resolve(self, link: str, line: _LateLine, now_ns: int | None) -> None:
        """Close windows and take late answers that end before `now_ns`; all of them if None."""
        line.windows = [
            window for window in line.windows if now_ns is not None and window.end_ns >= now_ns
        ]
        for one in line.pending:
            response_ns = one.response_ns or 0
            if now_ns is not None and response_ns >= now_ns:
                continue
            if (unit := self._unit(one)) is not None:
                _note_late(unit, one, is_other=line.is_answer_to_damaged(one))
        line.pending = [
            one for one in line.pending if now_ns is not None and (one.response_ns or 0) >= now_ns
        ]

    def _note_wait(self, line: _LateLine, one: NamedTransaction) -> None:
        before, line.last = line.last, None
        if before is None or before.request_ns is None or one.request_ns is None:
            return
        unit = self._units[before.link, before.unit]
        waited_ns = one.request_ns - before.request_ns
        if before.outcome not in (Outcome.LATE, Outcome.NO_ANSWER):
            if before.latency_ns is not None:
                unit.paces.append((before.latency_ns, waited_ns))
            return
        unit.waits.append(waited_ns)
        is_damaged = bool(line.damage) and line.damage[-1] >= before.request_ns
        if before.outcome is Outcome.NO_ANSWER and not is_damaged:
            unit.windows += 1
            unit.windows_ns += waited_ns
            line.windows.append(_DisturbedWindow(unit, one.request_ns + waited_ns))

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        self.flush()
        for link in links:
            if not link.is_whole:
                continue
            tallies: dict[int, list[RequestTally]] = {}
            for one in link.functions:
                tallies.setdefault(one.unit, []).append(one.tally)
            for number, some in tallies.items():
                unit = self._units.get((link.name, number))
                if unit is not None:
                    line = self._lines[link.name]
                    yield from _unit_troubles(link.name, number, unit, line, merged(some))


def _unit_troubles(
    link: str, number: int, unit: _LateUnit, line: _LateLine, tally: RequestTally
) -> Iterator[Trouble]:
    is_noisy = line.damaged >= DAMAGE_PER_LATE_ANSWER * (unit.count + unit.missing)
    if is_noisy and not _is_waited_for(unit):
        return
    if unit.waits and median(unit.waits) < SHORTEST_TIMEOUT_NS:
        return
    if unit.count >= MIN_CASES:
        yield _trouble(link, number, unit, tally.requests)
        return
    is_dead = tally.latency.count < MIN_CASES
    if _is_cause_of_damage(unit, line, is_dead=is_dead):
        wait = _seconds_text(median(unit.waits))
        yield Trouble(
            code="LINE-LATE",
            link=link,
            unit=number,
            count=unit.missing,
            of=max(tally.requests, unit.missing),
            weight=unit.missing,
            figures={"latency": f"more than {wait}", "timeout": wait,
                     "longest": "its longest answer"},
            sureness=Sureness.POSSIBLE if is_dead else Sureness.LIKELY,
            evidence=tuple(unit.missing_cases),
        )  # fmt: skip
        return
    wait_ns, slowest_ns = min(unit.waits, default=0), tally.latency.percentile(95)
    is_missed = unit.missing >= MIN_CASES and tally.latency.count >= MIN_CASES
    if not is_missed or wait_ns < SHORTEST_TIMEOUT_NS:
        if unit.count:
            yield _trouble(link, number, unit, tally.requests)
    elif (
        NEAR_TIMEOUT * wait_ns <= slowest_ns <= wait_ns / NEAR_TIMEOUT
        and unit.missing >= MIN_LATE_SHARE * tally.requests
    ):
        yield Trouble(
            code="LINE-LATE",
            link=link,
            unit=number,
            count=unit.missing,
            of=tally.requests,
            weight=unit.missing,
            figures={
                "latency": f"up to {_seconds_text(slowest_ns)}",
                "timeout": _seconds_text(wait_ns),
                "longest": _seconds_text(2 * wait_ns),
            },
            sureness=Sureness.LIKELY,
            evidence=tuple(unit.missing_cases),
        )


def _is_waited_for(unit: _LateUnit) -> bool:
    """True if the master waits longer for late and missing answers than for others."""
    if not unit.waits:
        return True
    wait_ns = median(unit.waits)
    paces = [pace_ns for latency_ns, pace_ns in unit.paces if latency_ns < NEAR_TIMEOUT * wait_ns]
    return len(paces) < MIN_CASES or wait_ns >= MIN_WAIT_TO_PACE * median(paces)


def _note_late(unit: _LateUnit, one: NamedTransaction, *, is_other: bool) -> None:
    """Note a late answer; if it `is_other`, it answers a request that was damaged."""
    if is_other:
        unit.missing += 1
        keep(unit.missing_cases, Evidence.of(one))
        return
    unit.count += 1
    latency_ns = one.latency_ns or 0
    unit.latencies.append(latency_ns)
    keep(unit.cases, Evidence.of(one, f"answered after {_seconds_text(latency_ns)}"))


def _is_cause_of_damage(unit: _LateUnit, line: _LateLine, *, is_dead: bool) -> bool:
    """True if damage comes in the disturbed windows of a unit and hardly elsewhere. For a unit that
    never answers in time (`is_dead`), requests to other units must fail in most of these windows.
    """
    windows, share = unit.damaged_windows, MIN_DAMAGED_WINDOWS
    if is_dead:
        windows, share = unit.failed_windows, MIN_FAILED_WINDOWS
    watched_ns = line.end_ns - (line.begin_ns or 0)
    return (
        windows >= max(MIN_CASES, share * unit.windows)
        and unit.damage >= MIN_OWN_DAMAGE * line.damaged
        and unit.windows_ns <= MAX_WINDOWS_SHARE * watched_ns
    )


def _trouble(link: str, number: int, late: _LateUnit, requests: int) -> Trouble:
    latency_ns, longest_ns = median(late.latencies), max(late.latencies)
    is_rare = late.count < MIN_CASES
    count = late.count if is_rare else max(late.count, late.missing)
    waits = _seconds_text(median(late.waits)) if late.waits else "less"
    return Trouble(
        code="LINE-LATE",
        link=link,
        unit=number,
        count=count,
        of=max(requests, count),
        weight=count,
        is_small=is_rare or count < MIN_LATE_SHARE * requests,
        figures={
            "latency": _seconds_text(latency_ns),
            "timeout": waits,
            "longest": _seconds_text(longest_ns),
        },
        evidence=tuple(late.cases),
    )


def _seconds_text(ns: float) -> str:
    return f"{ns / 1e9:.2f} s"
