"""NET-ONE-SIDE and NET-DELAYED-ACK: what the account of a network shows."""

# NET-ONE-SIDE     Nothing of a slave is answered, and of most transactions the capture lacks one
#                  half, always the same: only one direction of the packets was recorded. A mirror
#                  port that loses packets lacks now this, now that half.
# NET-DELAYED-ACK  A poll takes nearly always the time of a delayed acknowledgement (40 or 200 ms,
#                  as Linux and Windows use them), while other polls of the same slave are quick: a
#                  sender waits with the second part of a message until the first is acknowledged.
#                  A slave whose polls all take that long may just need it, and nothing is said.
#
# Memory: a number for each of at most MAX_LINKS links; the account has the rest.

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.core.wording import counted, in_ms
from mbtool.modbus import RESPONDED, Outcome
from mbtool.troubles.sense import MAX_LINKS, Sense
from mbtool.troubles.trouble import Sureness, Trouble

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.core import WireEvent
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.statistics_report import LinkReport

ENOUGH = 10
MOSTLY = 0.8
FEW_CUT = 0.1
"""A capture that lacks parts of packets more often than this (0 to 1) lacks no whole direction."""
TIMERS_NS = ((38_000_000, 46_000_000), (185_000_000, 225_000_000))
"""The least and the greatest latency (ns) by which a delayed acknowledgement is recognised."""
QUICK_NS = 20_000_000
_CUT = frozenset((EventKind.CUT, EventKind.GAP, EventKind.SKIPPED))


class NetworkPolls(Sense):
    """Finds NET-ONE-SIDE and NET-DELAYED-ACK."""

    def __init__(self) -> None:
        self._cut: Counter[str] = Counter()
        """By link, the number of events about missing bytes."""

    def event(self, event: WireEvent) -> None:
        if event.kind in _CUT and (event.link in self._cut or len(self._cut) < MAX_LINKS):
            self._cut[event.link] += 1

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        for link in links:
            if not link.is_serial and link.is_whole:
                if self._cut[link.name] <= FEW_CUT * link.tally.transactions:
                    yield from _one_side(link)
                yield from _delayed(link)


def _one_side(link: LinkReport) -> Iterator[Trouble]:
    tally = link.tally
    whole, lacking = tally.transactions, tally.count(Outcome.NOT_CAPTURED)
    if lacking < ENOUGH or lacking < MOSTLY * whole or any(map(tally.count, RESPONDED)):
        return
    if tally.requests >= MOSTLY * whole:
        side, other = "requests", "responses"
    elif tally.requests <= (1 - MOSTLY) * whole:
        side, other = "responses", "requests"
    else:
        return
    yield Trouble(
        code="NET-ONE-SIDE", link=link.name, count=lacking, of=whole, weight=lacking,
        figures={"side": side, "other": other},
    )  # fmt: skip


def _delayed(link: LinkReport) -> Iterator[Trouble]:
    by_unit: dict[int, list[PollStatistics]] = {}
    for one in link.polls:
        if one.poll.tally.latency.count >= ENOUGH:
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
                "polls": counted(len(slow), "poll"), "latency": f"{in_ms(_median(slow[0]))} ms",
            },
            sureness=Sureness.LIKELY,
        )  # fmt: skip


def _is_timer(poll: PollStatistics) -> bool:
    latency = poll.tally.latency
    low, high = latency.percentile(10), latency.percentile(90)
    return any(least <= low and high <= greatest for least, greatest in TIMERS_NS)


def _median(poll: PollStatistics) -> int:
    return poll.tally.latency.percentile(50)
