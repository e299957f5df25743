"""LINE-LATE: answers that come after the master has given the request up."""

# A master sends its next request when its time-out is over. The answer to the request before then
# finds the master waiting for another one, or for nobody. So a response without a pending request
# is late if the last unanswered request to its unit has its function and asks for as many bytes,
# and was sent at most LONGEST_NS before. Its latency counts from that request, and the time-out is
# the time from the request to the next one.
#
# A unit that is asked again answers in order: the master takes its late answer to the first request
# for the answer to the second one, and the last answer comes when nobody waits. So when a response
# without a pending request comes, the answers since the first unanswered request are moved back,
# each to the request before it.
#
# A unit some of whose answers come just before the time-out (NEAR), and others not at all, is late,
# too, though its late answers may collide with the next request, so that nobody can read them.
#
# False alarms: a response without request at the beginning of a recording has no unanswered request
# before it. The request of a response right behind damaged bytes was probably damaged.
#
# Memory: the last OPEN unanswered requests of each unit, MAX_EVIDENCE cases and TIMES times for
# each of at most MAX_UNITS units.

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.modbus import Outcome
from mbtool.modbus.pdu import whole_pdu
from mbtool.troubles.sense import SortedSense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Sureness, Trouble

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.core import WireEvent
    from mbtool.ledger.statistics_report import LinkReport

LONGEST_NS = 5_000_000_000
ENOUGH = 3
"""Fewer late answers of a unit than this are no trouble."""
FEW = 0.01
"""Late answers to a smaller share (0 to 1) of the requests than this are a note."""
MAX_UNITS = 500
OPEN = 4
TIMES = 200
NEAR = 0.85
"""Answers come near the time-out if 5 % of them take at least this share (0 to 1) of it."""
_FRAME = 6
_DAMAGE = frozenset((EventKind.SKIPPED, EventKind.BAD_CHECK))


@dataclass(slots=True)
class _LateUnit:
    """The unanswered requests of a unit, and its late answers; times in ns."""

    open: deque[NamedTransaction] = field(default_factory=lambda: deque(maxlen=OPEN))
    """Requests whose response is still to come, if the unit answers in order."""
    moved: list[tuple[NamedTransaction, int]] = field(default_factory=list)
    """Requests, each with the latency of the response that belongs to it if the unit answers in
    order; the decoder gave that response to the next request."""
    count: int = 0
    missing: int = 0
    latencies: deque[int] = field(default_factory=lambda: deque(maxlen=TIMES))
    waits: deque[int] = field(default_factory=lambda: deque(maxlen=TIMES))
    """How long the master waited for answers that did not come in time."""
    cases: list[Evidence] = field(default_factory=list)
    missing_cases: list[Evidence] = field(default_factory=list)

    def note(self, request: NamedTransaction, latency_ns: int) -> None:
        self.count += 1
        self.latencies.append(latency_ns)
        if len(self.cases) < MAX_EVIDENCE:
            self.cases.append(Evidence.of(request, f"answered after {_s(latency_ns)}"))

    def forget(self) -> None:
        self.open.clear()
        self.moved.clear()


class LateOnLine(SortedSense):
    """Finds LINE-LATE."""

    def __init__(self) -> None:
        super().__init__()
        self._units: dict[tuple[str, int], _LateUnit] = {}
        self._waits_from: dict[str, NamedTransaction] = {}
        """By link, the request without an answer whose next request is not known yet."""
        self._damage_ns: dict[str, int] = {}
        """By link, the time of the last damaged bytes."""
        self._asked_ns: dict[str, int] = {}
        """By link, the time of the last request."""

    def begin_capture(self) -> None:
        super().begin_capture()
        for unit in self._units.values():
            unit.forget()
        self._waits_from.clear()

    def take_event(self, event: WireEvent) -> None:
        if event.kind in _DAMAGE and len(event.raw) >= _FRAME:
            self._damage_ns[event.link] = event.ts_ns
            waiting = self._waits_from.get(event.link)
            if waiting is not None:  # The answer to it was damaged, so none comes late.
                unit = self._units[waiting.link, waiting.unit]
                if waiting in unit.open:
                    unit.open.remove(waiting)

    def take_transaction(self, one: NamedTransaction) -> None:
        key = one.link, one.unit
        unit = self._units.get(key)
        if unit is None:
            if len(self._units) >= MAX_UNITS:
                return
            unit = self._units[key] = _LateUnit()
        if one.request_ns is not None:
            self._note_wait(one)
            self._asked_ns[one.link] = one.request_ns
        _forget_old(unit, one.start_ns)
        if one.outcome is Outcome.NO_ANSWER:
            unit.open.append(one)
            unit.missing += 1
            if len(unit.missing_cases) < MAX_EVIDENCE:
                unit.missing_cases.append(Evidence.of(one))
            self._waits_from[one.link] = one
        elif one.outcome is Outcome.UNSOLICITED:
            self._note_alone(unit, one)
        elif unit.open and one.response_ns is not None:
            _move(unit, one)

    def _note_wait(self, one: NamedTransaction) -> None:
        before = self._waits_from.pop(one.link, None)
        if before is not None and before.request_ns is not None and one.request_ns is not None:
            unit = self._units[before.link, before.unit]
            unit.waits.append(one.request_ns - before.request_ns)

    def _note_alone(self, unit: _LateUnit, one: NamedTransaction) -> None:
        """Give a response without a request to the oldest open request that it fits."""
        damage_ns = self._damage_ns.get(one.link, 0)
        if damage_ns > self._asked_ns.get(one.link, 0) or one.response_ns is None:
            return
        if not unit.open or not _fits(unit.open[0], one):
            return
        for request, latency_ns in unit.moved:
            unit.note(request, latency_ns)
        unit.moved.clear()
        request = unit.open.popleft()
        unit.note(request, one.response_ns - request.start_ns)

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


def _forget_old(unit: _LateUnit, now_ns: int) -> None:
    """Forget open requests whose response does not come any more."""
    if (unit.open and now_ns - unit.open[0].start_ns > LONGEST_NS) or len(unit.moved) > OPEN:
        unit.forget()


def _move(unit: _LateUnit, one: NamedTransaction) -> None:
    """Note that a response belongs to an earlier request if the unit answers in order."""
    request = unit.open[0]
    if one.response_ns is None or not _fits(request, one):
        unit.forget()
        return
    unit.open.popleft()
    unit.moved.append((request, one.response_ns - request.start_ns))
    unit.open.append(one)


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


def _fits(request: NamedTransaction, response: NamedTransaction) -> bool:
    """True if a response has the number of bytes that a request asks for, or is an exception."""
    pdu = whole_pdu(response.transport, response.response_raw)
    asked = request.quantity
    if request.function != response.function:
        return False
    if pdu is None or response.exception is not None or asked is None:
        return True
    if request.function in (1, 2):
        return pdu[1:2] == bytes([(asked + 7) // 8 & 0xFF])
    if request.function in (3, 4):
        return pdu[1:2] == bytes([2 * asked & 0xFF])
    return True


def _s(ns: float) -> str:
    return f"{ns / 1e9:.2f} s"
