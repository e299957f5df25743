"""Finds troubles of polling in which all requests are answered: pauses, late answers, and one
connection for each request.

The figures of the account (ledger/account.py) show them; single transactions are not needed.
"""

# `watch` calls these functions once a second. So costly figures are computed only where a duration
# is long enough to be reported, or where a master has opened many connections.

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from heapq import nlargest
from typing import TYPE_CHECKING

from mbtool.core.moments import counted, duration, in_ms
from mbtool.ledger.poll_statistics import LONG_NS, PollStatistics
from mbtool.troubles.trouble import Evidence, Trouble

if TYPE_CHECKING:
    from mbtool.ledger.statistics_connections import ConnectionTally
    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.troubles.cases import Cases

LATE_NS = 100_000_000
"""The least latency (ns) of an answer that is counted in POLL-LATE; see LATE_TIMES."""
LATE_TIMES = 20
"""An answer is counted in POLL-LATE if it takes at least LATE_NS (ns), and at least this many times
the median latency of its poll."""
ENOUGH_ANSWERS = 20
"""POLL-LATE is not judged for polls with fewer answers than this, as their usual latency is not
known."""
PAUSE_NS = LONG_NS
PAUSE_TIMES = 10
"""The polling paused if a poll with a regular period did not come for PAUSE_NS (ns) or longer, and
for this many of its periods."""
ENOUGH_PERIODS = 20
"""Pauses are looked for only in polls with at least this many measured periods."""
_TRIED = 50
"""A poll with a regular period is looked for among at most this many polls of a master, those with
the most periods."""
REQUESTS_PER_CONNECTION = 3
"""A link has a TCP connection for each poll if its connections carry at most this many requests in
the mean, and are at least ENOUGH_CONNECTIONS."""
ENOUGH_CONNECTIONS = 20
"""A link with fewer opened connections than this is not said to have one for each poll."""
_HANDSHAKE_S = 0.001
"""The time (s) that opening a connection is assumed to take. Opened connections times this is the
lost time by which the trouble is ranked among pauses and late answers."""
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
class LateUnit:
    """A unit some of whose answers are late. Latencies are in ns."""

    unit: tuple[str, int]
    """Link and unit."""
    number: int
    """The number of late answers."""
    answers: int
    """The number of all answers, late or not, of the polls in `polls`."""
    longest_ns: int
    usual_ns: int
    """The median latency of the poll with most late answers."""
    late_ns: int
    """The least latency from which an answer of the unit is late."""
    polls: Sequence[PollStatistics]
    """The polls that have late answers."""

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


def polling_troubles(links: Sequence[LinkReport], cases: Cases) -> Iterator[Trouble]:
    """Yield what is odd in the polling as troubles; nothing if a filter left out transactions."""
    if not all(link.is_whole for link in links):
        return
    polls = [one.poll for link in links for one in link.polls]
    connections = {(link.name, master): one for link in links for master, one in link.connections}
    requests = {link.name: link.tally.requests for link in links}
    yield from map(_pause_trouble, pauses(polls))
    yield from map(
        _short_connections_trouble,
        short_connections(connections, polls, lambda link: requests[link]),
    )
    yield from (_late_answers_trouble(one, cases) for one in late_units(polls))


def _pause_trouble(one: PollingPause) -> Trouble:
    longest = duration(one.longest_ns)
    how = f"for {longest}" if one.number == 1 else f"{one.number:,} times, for up to {longest}"
    figures = {
        "of_link": f" of {one.link}" if one.master else "",
        "paused": how,
        "usual": duration(one.usual_ns),
    }
    cases = [Evidence(ts_ns=begin_ns, text=f"for {duration(ns)}") for ns, begin_ns in one.cases]
    return Trouble(
        code="POLL-PAUSED", link=one.link, master=one.master, count=one.number,
        weight=one.lost_s, figures=figures, evidence=tuple(cases),
    )  # fmt: skip


def _short_connections_trouble(one: ShortConnections) -> Trouble:
    figures = {"opened": f"{one.opened:,}", "requests": counted(one.requests, "request", ",")}
    return Trouble(
        code="NET-SHORT", link=one.link, master=one.master or "masters", count=one.opened,
        weight=one.lost_s, figures=figures,
    )  # fmt: skip


def _late_answers_trouble(one: LateUnit, cases: Cases) -> Trouble:
    longest = duration(one.longest_ns)
    figures = {
        "late": counted(one.number, "answer", ","),
        "longest": f"after {longest}" if one.number == 1 else f"the longest after {longest}",
        "usual": f"{in_ms(one.usual_ns)} ms",
    }
    link, unit = one.unit
    return Trouble(
        code="POLL-LATE", link=link, unit=unit, count=one.number, of=one.answers,
        weight=one.lost_s, figures=figures, search=f"ms>={one.late_ns // _MS}",
        evidence=cases.slowest(one.polls, one.late_ns),
    )  # fmt: skip


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
    number = poll.period.count_at_least(pause_ns)
    if not number:
        return None
    cases = tuple(one for one in poll.longest if one[0] >= pause_ns)
    key = poll.key
    return PollingPause(key.link, key.master, number, poll.period.greatest, usual_ns, cases)


def late_units(polls: Iterable[PollStatistics]) -> list[LateUnit]:
    """Return the units with late answers. An answer is compared with those of its own poll, as
    another poll of the unit may always take long.
    """
    found: dict[tuple[str, int], LateUnit] = {}
    for poll in polls:
        latency = poll.tally.latency
        if latency.count < ENOUGH_ANSWERS or latency.greatest < LATE_NS:
            continue
        usual_ns = latency.percentile(50)
        # Round up to whole ms, because the user searches with this number.
        late_ns = -(-max(LATE_NS, LATE_TIMES * usual_ns) // _MS) * _MS
        if latency.greatest < late_ns:
            continue
        unit = poll.key.link, poll.key.unit
        number = latency.count_at_least(late_ns)
        one = LateUnit(unit, number, latency.count, latency.greatest, usual_ns, late_ns, (poll,))
        other = found.get(unit)
        found[unit] = one if other is None else _joined_polls(other, one)
    return [*found.values()]


def _joined_polls(one: LateUnit, other: LateUnit) -> LateUnit:
    """Return the late answers of two polls of a unit as one; the one with more tells the usual."""
    first = max(one, other, key=lambda each: each.number)
    return replace(
        first,
        number=one.number + other.number,
        answers=one.answers + other.answers,
        longest_ns=max(one.longest_ns, other.longest_ns),
        late_ns=min(one.late_ns, other.late_ns),
        polls=(*one.polls, *other.polls),
    )


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
