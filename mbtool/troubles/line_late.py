"""LINE-LATE: answers that come after the master has given the request up."""

# The decoder says which responses are late. The time-out is the time from a request without a
# response in time to the next request on the line.
#
# A unit some of whose answers come just before the time-out (NEAR), and others not at all, is late,
# too, though its late answers may collide with the next request, so that nobody can read them.
#
# Memory: MAX_EVIDENCE cases and TIMES times for each of at most MAX_UNITS units.

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.modbus import Outcome
from mbtool.troubles.sense import SortedSense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Sureness, Trouble

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.statistics_report import LinkReport

ENOUGH = 3
"""Fewer late answers of a unit than this are no trouble."""
FEW = 0.01
"""Late answers to a smaller share (0 to 1) of the requests than this are a note."""
MAX_UNITS = 500
TIMES = 200
NEAR = 0.85
"""Answers come near the time-out if 5 % of them take at least this share (0 to 1) of it."""


@dataclass(slots=True)
class _LateUnit:
    """The late and the missing answers of a unit; times in ns."""

    count: int = 0
    missing: int = 0
    latencies: deque[int] = field(default_factory=lambda: deque(maxlen=TIMES))
    waits: deque[int] = field(default_factory=lambda: deque(maxlen=TIMES))
    """How long the master waited for answers that did not come in time."""
    cases: list[Evidence] = field(default_factory=list)
    missing_cases: list[Evidence] = field(default_factory=list)


class LateOnLine(SortedSense):
    """Finds LINE-LATE."""

    def __init__(self) -> None:
        super().__init__()
        self._units: dict[tuple[str, int], _LateUnit] = {}
        self._waits_from: dict[str, NamedTransaction] = {}
        """By link, the request without an answer in time whose next request is not known yet."""

    def begin_capture(self) -> None:
        super().begin_capture()
        self._waits_from.clear()

    def take_transaction(self, one: NamedTransaction) -> None:
        if one.request_ns is None:
            return
        self._note_wait(one)
        if one.outcome not in (Outcome.LATE, Outcome.NO_ANSWER):
            return
        unit = self._units.get((one.link, one.unit))
        if unit is None:
            if len(self._units) >= MAX_UNITS:
                return
            unit = self._units[one.link, one.unit] = _LateUnit()
        self._waits_from[one.link] = one
        if one.outcome is Outcome.NO_ANSWER:
            unit.missing += 1
            _keep(unit.missing_cases, Evidence.of(one))
        else:
            unit.count += 1
            latency_ns = one.latency_ns or 0
            unit.latencies.append(latency_ns)
            _keep(unit.cases, Evidence.of(one, f"answered after {_s(latency_ns)}"))

    def _note_wait(self, one: NamedTransaction) -> None:
        before = self._waits_from.pop(one.link, None)
        if before is not None and before.request_ns is not None and one.request_ns is not None:
            unit = self._units[before.link, before.unit]
            unit.waits.append(one.request_ns - before.request_ns)

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
                    yield from _of_unit(link.name, number, unit, merged(some))


def _of_unit(link: str, number: int, unit: _LateUnit, tally: RequestTally) -> Iterator[Trouble]:
    if unit.count >= ENOUGH:
        yield _trouble(link, number, unit, tally.requests)
        return
    if unit.missing < ENOUGH or not unit.waits or tally.latency.count < ENOUGH:
        return
    wait_ns = min(unit.waits)
    slowest_ns = tally.latency.percentile(95)
    if NEAR * wait_ns <= slowest_ns <= wait_ns / NEAR and unit.missing >= FEW * tally.requests:
        yield Trouble(
            code="LINE-LATE",
            link=link,
            unit=number,
            count=unit.missing,
            of=tally.requests,
            weight=unit.missing,
            figures={
                "latency": f"up to {_s(slowest_ns)}",
                "timeout": _s(wait_ns),
                "longest": _s(2 * wait_ns),
            },
            sureness=Sureness.LIKELY,
            evidence=tuple(unit.missing_cases),
        )


def _trouble(link: str, number: int, late: _LateUnit, requests: int) -> Trouble:
    latency_ns, longest_ns = median(late.latencies), max(late.latencies)
    count = max(late.count, late.missing)
    waits = _s(median(late.waits)) if late.waits else "less"
    return Trouble(
        code="LINE-LATE",
        link=link,
        unit=number,
        count=count,
        of=max(requests, count),
        weight=count,
        is_small=count < FEW * requests,
        figures={"latency": _s(latency_ns), "timeout": waits, "longest": _s(longest_ns)},
        evidence=tuple(late.cases),
    )


def _keep(cases: list[Evidence], one: Evidence) -> None:
    if len(cases) < MAX_EVIDENCE:
        cases.append(one)


def _s(ns: float) -> str:
    return f"{ns / 1e9:.2f} s"
