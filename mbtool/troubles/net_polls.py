"""Finds NET-ONE-SIDE and NET-DELAYED-ACK from the statistics of a network link."""

# NET-ONE-SIDE     No request is answered, and of most transactions the capture lacks one half,
#                  always the same one: only one direction of the packets was recorded. A mirror
#                  port that drops packets loses requests as often as responses.
# NET-DELAYED-ACK  A sender holds the second part of a message back until the first part is
#                  acknowledged, and the receiver delays this acknowledgement (40 ms on Linux, 200
#                  ms on Windows). Either the two parts are seen, nearly always this time apart. Or
#                  a poll nearly always takes this time, while other polls of the same slave are
#                  quick. If all polls of a slave take this time, the slave may need it, and no
#                  trouble is reported.
#
# Memory: a few numbers, MAX_EVIDENCE cases and KEPT_TIMES times for each of at most MAX_LINKS
# senders of messages in two parts. The account (ledger/account.py) has the other figures.

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import counted, host_of, in_ms
from mbtool.framing.mbap import PARTS_NS
from mbtool.modbus import RESPONDED, Outcome, Transport
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.troubles.cases import Cases

MIN_CASES = 10
"""The least number of cases (transactions with a missing half, delayed messages, or answers of a
poll). With fewer, no trouble is reported."""
MIN_CASES_SHARE = 0.8
"""The least share (0 to 1) of the cases among all transactions or messages. With a smaller one, no
trouble is reported."""
MIN_SIDE_SHARE = 0.8
"""NET-ONE-SIDE is reported only if at least this share (0 to 1) of the transactions has the same
half, the request or the response."""
MIN_TIMER_SHARE = 0.8
"""A poll is slow by a timer only if at least this share (0 to 1) of its answers takes at least the
shortest time of a range in TIMERS_NS."""
MAX_CUT_SHARE = 0.1
"""NET-ONE-SIDE is reported only if events about cut or missing bytes are at most this share
(0 to 1) of the link's transactions: a capture with many such losses does not show that one
direction is absent."""
TIMERS_NS = ((36_000_000, 46_000_000), (185_000_000, 225_000_000))
"""Two ranges of time (least, greatest; ns): around 40 ms, the delayed acknowledgement of Linux, and
around 200 ms, that of Windows. Times in a range are taken for such a delay."""
KEPT_TIMES = 200
"""The last times (ns) that are kept of each sender, for the median that the trouble shows."""
QUICK_NS = 20_000_000
"""Slow polls of a unit are reported only if another poll of the same unit has a median latency
below this (ns)."""
_CUT = frozenset((EventKind.CUT, EventKind.GAP, EventKind.SKIPPED))


@dataclass(slots=True)
class _Parts:
    """The messages of one sender whose last byte came much later than the first."""

    count: int = 0
    delayed: int = 0
    """The number of messages whose second part came after a time in one of TIMERS_NS."""
    times: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT_TIMES))
    """The times (ns) between the parts of one message."""
    cases: list[Evidence] = field(default_factory=list)


class NetworkPolls(Sense):
    """Finds NET-ONE-SIDE and NET-DELAYED-ACK."""

    def __init__(self, cases: Cases) -> None:
        self._cases = cases
        self._cut: Counter[str] = Counter()
        """By link, the number of events about missing bytes."""
        self._parts: dict[tuple[str, str | int], _Parts] = {}
        """The key is the link and the sender: for requests the host of the master, for answers the
        number of the unit."""

    def transaction(self, one: NamedTransaction) -> None:
        if one.transport is not Transport.TCP or one.request_ns is None:
            return
        if one.request_parts_ns is not None:
            self._note_parts(one.link, host_of(one.source), one.request_parts_ns, one)
        if one.response_ns is not None and one.latency_ns is not None:
            parts_ns = one.response_ns - one.request_ns - one.latency_ns
            if parts_ns > PARTS_NS:
                self._note_parts(one.link, one.unit, parts_ns, one)

    def _note_parts(self, link: str, who: str | int, ns: int, one: NamedTransaction) -> None:
        parts = self._parts.get((link, who))
        if parts is None:
            if len(self._parts) >= MAX_LINKS:
                return
            parts = self._parts[link, who] = _Parts()
        parts.count += 1
        parts.delayed += any(least <= ns <= most for least, most in TIMERS_NS)
        parts.times.append(ns)
        keep(parts.cases, Evidence.of(one, f"its second part after {in_ms(ns)} ms"))

    def event(self, event: WireEvent) -> None:
        if event.kind in _CUT and (event.link in self._cut or len(self._cut) < MAX_LINKS):
            self._cut[event.link] += 1

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        for link in links:
            if not link.is_serial and link.is_whole:
                if self._cut[link.name] <= MAX_CUT_SHARE * link.tally.transactions:
                    yield from _one_side_trouble(link)
                found = [*self._delayed_parts_troubles(link)]
                yield from found
                told = {one.unit for one in found}
                yield from (
                    one
                    for one in _delayed_polls_troubles(link, self._cases)
                    if one.unit not in told
                )

    def _delayed_parts_troubles(self, link: LinkReport) -> Iterator[Trouble]:
        for (name, who), parts in self._parts.items():
            if name != link.name or parts.delayed < max(MIN_CASES, MIN_CASES_SHARE * parts.count):
                continue
            unit = who if isinstance(who, int) else None
            tallies = [one.tally for one in link.functions if unit in (None, one.unit)]
            messages = "requests" if unit is None else "answers"
            yield Trouble(
                code="NET-DELAYED-ACK", link=link.name, unit=unit,
                master=who if isinstance(who, str) else "", count=parts.count,
                of=max(parts.count, sum(one.requests for one in tallies)), weight=parts.count,
                figures={
                    "messages": f"{parts.count:,} {messages}",
                    "how": "come in two segments, the second "
                           f"{in_ms(median(parts.times))} ms after the first",
                },
                sureness=Sureness.LIKELY, evidence=tuple(parts.cases),
            )  # fmt: skip


def _one_side_trouble(link: LinkReport) -> Iterator[Trouble]:
    tally = link.tally
    whole, lacking = tally.transactions, tally.count(Outcome.NOT_CAPTURED)
    if lacking < MIN_CASES or lacking < MIN_CASES_SHARE * whole or any(map(tally.count, RESPONDED)):
        return
    if tally.requests >= MIN_SIDE_SHARE * whole:
        side, other = "requests", "responses"
    elif tally.requests <= (1 - MIN_SIDE_SHARE) * whole:
        side, other = "responses", "requests"
    else:
        return
    yield Trouble(
        code="NET-ONE-SIDE", link=link.name, count=lacking, of=whole, weight=lacking,
        figures={"side": side, "other": other},
    )  # fmt: skip


def _delayed_polls_troubles(link: LinkReport, cases: Cases) -> Iterator[Trouble]:
    by_unit: dict[int, list[PollStatistics]] = {}
    for one in link.polls:
        if one.poll.tally.latency.count >= MIN_CASES:
            by_unit.setdefault(one.poll.key.unit, []).append(one.poll)
    for unit, polls in by_unit.items():
        slow = [poll for poll in polls if _is_timer(poll)]
        if not slow or not any(_median(poll) < QUICK_NS for poll in polls):
            continue
        count = sum(poll.tally.latency.count for poll in slow)
        yield Trouble(
            code="NET-DELAYED-ACK", link=link.name, unit=unit, count=count,
            of=sum(poll.tally.latency.count for poll in polls), weight=count,
            figures={
                "messages": counted(len(slow), "poll"),
                "how": f"{'takes' if len(slow) == 1 else 'take'} {in_ms(_median(slow[0]))} ms each "
                       "time, others are quick",
            },
            sureness=Sureness.LIKELY, evidence=cases.slowest(slow),
        )  # fmt: skip


def _is_timer(poll: PollStatistics) -> bool:
    """True if the 20th and the 90th percentile of a poll's latencies are in one range of TIMERS_NS.

    Some answers may come earlier: another segment that was sent carried the acknowledgement.
    """
    latency = poll.tally.latency
    low, high = latency.percentile(100 * (1 - MIN_TIMER_SHARE)), latency.percentile(90)
    return any(least <= low and high <= greatest for least, greatest in TIMERS_NS)


def _median(poll: PollStatistics) -> int:
    return poll.tally.latency.percentile(50)
