"""Finds what is odd in the polling though requests are answered: pauses, late answers, connections.

Each is found by figures of `Statistics`, and so without a look at single transactions.
"""

# `watch` calls this once a second, so what costs more than a comparison is computed only where a
# duration is long enough to be told, or where a master has opened many connections.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from heapq import nlargest
from typing import TYPE_CHECKING, Generic, TypeVar

from mbtool.ledger.poll_statistics import LONG_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from mbtool.ledger.distribution import Distribution
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.request_tally import RequestTally
    from mbtool.ledger.statistics_connections import ConnectionTally
    from mbtool.ledger.statistics_report import LinkReport

K = TypeVar("K")

LATE_NS = 100_000_000
LATE_TIMES = 20
"""An answer is late if it takes at least LATE_NS (ns), and this many times the unit's median."""
ENOUGH_ANSWERS = 50
"""Units with fewer answers than this have no late answers, as their usual latency is not known."""
PAUSE_NS = LONG_NS
PAUSE_TIMES = 10
"""The polling paused if a poll with a regular period did not come for PAUSE_NS (ns) or longer, and
for this many of its periods."""
ENOUGH_PERIODS = 20
_TRIED = 50
"""Only among so many of the most frequent polls of a master a regular one is looked for."""
REQUESTS_PER_CONNECTION = 3
"""A link has a TCP connection for each poll if its connections carry at most so many requests in
the mean, and are at least ENOUGH_CONNECTIONS."""
ENOUGH_CONNECTIONS = 20
_HANDSHAKE_S = 0.001
"""The time that opening a connection takes, for the comparison with pauses and late answers."""
_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class PollingPause:
    """The times (ns) for which a master did not send its most frequent regular poll of a link."""

    link: str
    master: str
    """The master's host; empty on a serial line."""
    number: int
    longest_ns: int
    usual_ns: int
    """The median time from one request of a poll to the next."""
    cases: tuple[tuple[int, int], ...]
    """The length (ns) and the begin (UTC ns) of the longest pauses, the longest first."""

    @property
    def lost_s(self) -> float:
        """About the time (s) that was lost for the polling."""
        return self.number * self.longest_ns / 1e9


@dataclass(frozen=True, slots=True)
class LateUnit(Generic[K]):
    """A unit some of whose answers are late. Latencies are in ns."""

    unit: K
    number: int
    """The number of late answers."""
    longest_ns: int
    usual_ns: int
    """The median latency of the unit."""
    late_ns: int
    """The latency from which an answer of the unit is late."""

    @property
    def lost_s(self) -> float:
        return self.number * self.longest_ns / 1e9


@dataclass(frozen=True, slots=True)
class ShortConnections:
    """The TCP connections to a link, if there is about one for each request."""

    link: str
    master: str
    """The master's host; empty if connections of several masters are counted together, as the
    requests of each are not known."""
    opened: int
    requests: int

    @property
    def lost_s(self) -> float:
        return self.opened * _HANDSHAKE_S


Oddity = PollingPause | LateUnit[K] | ShortConnections


def odd_polling(
    links: Sequence[LinkReport], tallies: Mapping[tuple[str, int], RequestTally]
) -> tuple[list[PollingPause], list[ShortConnections], list[LateUnit[tuple[str, int]]]]:
    """Return what is odd in the polling, by kind. `tallies` has the counts of each unit.

    There is nothing if the statistics are not whole.
    """
    if not all(link.is_whole for link in links):
        return [], [], []
    polls = [one.poll for link in links for one in link.polls]
    connections = {(link.name, master): one for link in links for master, one in link.connections}
    requests = {link.name: link.tally.requests for link in links}
    return (
        pauses(polls),
        short_connections(connections, polls, lambda link: requests[link]),
        late_units({unit: one.latency for unit, one in tallies.items()}),
    )


def pauses(polls: Iterable[PollStatistics]) -> list[PollingPause]:
    """Return the pauses of each master on each link, as its most frequent regular poll shows
    them.
    """
    of_masters: dict[tuple[str, str], list[PollStatistics]] = {}
    for poll in polls:
        if poll.period.count >= ENOUGH_PERIODS:
            of_masters.setdefault((poll.key.link, poll.key.master), []).append(poll)
    found = [_pause(some) for some in of_masters.values()]
    return [one for one in found if one is not None]


def _pause(polls: list[PollStatistics]) -> PollingPause | None:
    """Return the pauses of one master on one link; `polls` are its polls."""
    if all(poll.period.greatest < PAUSE_NS for poll in polls):
        return None
    often = nlargest(_TRIED, polls, key=lambda one: one.period.count)
    poll = next((one for one in often if one.has_regular_period), None)
    if poll is None or poll.period.greatest < PAUSE_NS:
        return None
    usual_ns = poll.period.percentile(50)
    pause_ns = max(PAUSE_NS, PAUSE_TIMES * usual_ns)
    number = poll.period.number_from(pause_ns)
    if not number:
        return None
    cases = tuple(one for one in poll.longest if one[0] >= pause_ns)
    key = poll.key
    return PollingPause(key.link, key.master, number, poll.period.greatest, usual_ns, cases)


def late_units(latencies: Mapping[K, Distribution]) -> list[LateUnit[K]]:
    """Return the units with late answers; `latencies` has those of each unit."""
    found = []
    for unit, latency in latencies.items():
        if latency.count < ENOUGH_ANSWERS or latency.greatest < LATE_NS:
            continue
        usual_ns = latency.percentile(50)
        # In whole ms, because a user searches for it.
        late_ns = -(-max(LATE_NS, LATE_TIMES * usual_ns) // _MS) * _MS
        if latency.greatest >= late_ns:
            number = latency.number_from(late_ns)
            found.append(LateUnit(unit, number, latency.greatest, usual_ns, late_ns))
    return found


def short_connections(
    connections: Mapping[tuple[str, str], ConnectionTally],
    polls: Iterable[PollStatistics],
    requests_of: Callable[[str], int],
) -> list[ShortConnections]:
    """Return the masters with a connection for each poll.

    The keys of `connections` are link and master; `requests_of` returns the number of requests to a
    link. If some polls of a link are no longer known, the requests of each master are not known,
    and its masters are judged together.
    """
    of_links: dict[str, dict[str, int]] = {}
    for (link, master), one in connections.items():
        of_links.setdefault(link, {})[master] = one.opened
    of_links = {
        link: opened
        for link, opened in of_links.items()
        if sum(opened.values()) >= ENOUGH_CONNECTIONS
    }
    if not of_links:
        return []
    requests: Counter[tuple[str, str]] = Counter()
    for poll in polls:
        requests[poll.key.link, poll.key.master] += poll.tally.requests
    known = Counter[str]()
    for (link, _), number in requests.items():
        known[link] += number
    found = []
    for link, opened in of_links.items():
        whole = requests_of(link)
        if known[link] < whole:
            master = next(iter(opened)) if len(opened) == 1 else ""
            found.append(ShortConnections(link, master, sum(opened.values()), whole))
            continue
        found += [
            ShortConnections(link, master, number, requests[link, master])
            for master, number in opened.items()
        ]
    return [one for one in found if _are_short(one)]


def _are_short(one: ShortConnections) -> bool:
    is_polled = 0 < one.requests <= REQUESTS_PER_CONNECTION * one.opened
    return is_polled and one.opened >= ENOUGH_CONNECTIONS
