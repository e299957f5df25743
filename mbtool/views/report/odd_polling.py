"""Finds what is odd in the polling though requests are answered: pauses, late answers, connections.

Each is found by figures of `stats`, and so without a look at single transactions.
"""

# A trouble's weight is about the time in s that it took from the polling, so that pauses, late
# answers and connections can be compared.

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core.wording import counted
from mbtool.overview.poll_statistics import LONG_NS
from mbtool.overview.request_tally import merged
from mbtool.views.report.troubles import Rank, VerdictTrouble, link_word
from mbtool.views.statistics_words import duration, in_ms

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from mbtool.overview.distribution import Distribution
    from mbtool.overview.poll_statistics import PollStatistics
    from mbtool.overview.request_tally import RequestTally
    from mbtool.overview.statistics_report import LinkReport
    from mbtool.series.history import UnitRow

LATE_NS = 100_000_000
LATE_TIMES = 20
"""An answer is late if it takes at least LATE_NS (ns), and this many times the unit's median."""
ENOUGH_ANSWERS = 50
"""Units with fewer answers than this have no late answers, as their usual latency is not known."""
_MS = 1_000_000
PAUSE_NS = LONG_NS
PAUSE_TIMES = 10
"""The polling paused if a poll with a regular period did not come for PAUSE_NS (ns) or longer, and
for this many of its periods."""
ENOUGH_PERIODS = 20
REQUESTS_PER_CONNECTION = 3
"""A link has a TCP connection for each poll if its connections carry at most so many requests in
the mean, and are at least ENOUGH_CONNECTIONS."""
ENOUGH_CONNECTIONS = 20
JOINED = 3
"""At least so many troubles of one kind are told as one."""


def odd_polling(
    links: Sequence[LinkReport],
    names: Mapping[UnitRow, str],
    latencies: Mapping[UnitRow, Distribution],
) -> Iterator[VerdictTrouble]:
    """Yield what is odd. `names` and `latencies` (ns) have an item for each unit."""
    yield from _joined_of_links([list(_pauses(link)) for link in links])
    yield from _joined_of_links([list(_connections(link)) for link in links])
    yield from _joined(
        [
            one
            for row, late_ns in late_limits(latencies).items()
            for one in _late_answers(row, names[row], latencies[row], late_ns)
        ],
        "unit",
    )


def _joined_of_links(by_link: list[list[VerdictTrouble]]) -> list[VerdictTrouble]:
    """Join troubles of one kind, each of a master on a link; `by_link` has those of each link."""
    troubles = [one for some in by_link for one in some]
    noun = "master" if len({one.who for one in troubles}) == len(troubles) else "case"
    return _joined(troubles, "link" if max(map(len, by_link), default=0) <= 1 else noun)


def _joined(troubles: list[VerdictTrouble], noun: str) -> list[VerdictTrouble]:
    """Join troubles of one kind if they are many: the text is that of the worst one.

    `noun` names the things that have one of the troubles each, such as `unit`.
    """
    if len(troubles) < JOINED:
        return troubles
    worst = max(troubles, key=lambda one: one.weight)
    return [
        replace(
            worst,
            text=f"{worst.text}, and {counted(len(troubles) - 1, f'more {noun}', ',')}",
            weight=sum(one.weight for one in troubles),
            units=frozenset(unit for one in troubles for unit in one.units),
        )
    ]


def late_limits(latencies: Mapping[UnitRow, Distribution]) -> dict[UnitRow, int]:
    """Return the latency (ns) from which an answer is late, for each unit that has late answers."""
    limits = {row: _late_limit(some) for row, some in latencies.items()}
    return {
        row: late_ns
        for row, late_ns in limits.items()
        if latencies[row].count >= ENOUGH_ANSWERS and latencies[row].greatest >= late_ns
    }


def _late_limit(latency: Distribution) -> int:
    """The limit is in whole ms (as ns), because the page searches for it."""
    late_ns = max(LATE_NS, LATE_TIMES * latency.percentile(50))
    return -(-late_ns // _MS) * _MS


def _late_answers(
    row: UnitRow, name: str, latency: Distribution, late_ns: int
) -> Iterator[VerdictTrouble]:
    usual = latency.percentile(50)
    number = latency.number_from(late_ns)
    longest = duration(latency.greatest)
    after = f"after {longest}" if number == 1 else f"the longest after {longest}"
    text = f"{name} gives {counted(number, 'answer', ',')} late, {after} "
    text += f"(usually {in_ms(usual)} ms)"
    yield VerdictTrouble(
        rank=Rank.ODD, text=text, weight=number * latency.greatest / 1e9, who=name,
        search=f"{link_word(row.link)}unit:{row.unit} ms>={late_ns // _MS}",
        units=frozenset((row,)),
    )  # fmt: skip


def _pauses(link: LinkReport) -> Iterator[VerdictTrouble]:
    """Yield the pauses of each master, as its fastest regular poll shows them."""
    fastest: dict[str, PollStatistics] = {}
    for one in link.polls:
        poll, period = one.poll, one.poll.period
        if period.count < ENOUGH_PERIODS or not poll.has_regular_period:
            continue
        other = fastest.get(poll.key.master)
        if other is None or period.percentile(50) < other.period.percentile(50):
            fastest[poll.key.master] = poll
    for master, poll in fastest.items():
        usual = poll.period.percentile(50)
        pause_ns = max(PAUSE_NS, PAUSE_TIMES * usual)
        number = poll.period.number_from(pause_ns)
        if not number:
            continue
        longest = duration(poll.period.greatest)
        how = f"for {longest}" if number == 1 else f"{number:,} times, for up to {longest}"
        text = f"{master or link.name} paused its polling{_of(link, master)} {how} "
        text += f"(usually a request every {duration(usual)})"
        yield VerdictTrouble(
            rank=Rank.ODD, text=text, weight=number * poll.period.greatest / 1e9,
            who=master or link.name, search=link_word(link.name).strip(),
            cases=tuple(
                (begin_ns, f"for {duration(length_ns)}")
                for length_ns, begin_ns in poll.longest
                if length_ns >= pause_ns
            ),
        )  # fmt: skip


def _of(link: LinkReport, master: str) -> str:
    return f" of {link.name}" if master else ""


def _connections(link: LinkReport) -> Iterator[VerdictTrouble]:
    """Yield the masters with a connection for each poll.

    Yields none if the requests of some polls are known only for the whole link.
    """
    if sum(one.poll.tally.requests for one in link.polls) < link.tally.requests:
        return
    tallies: dict[str, list[RequestTally]] = {}
    for each in link.polls:
        tallies.setdefault(each.poll.key.master, []).append(each.poll.tally)
    for master, one in link.connections:
        polls = tallies.get(master, [])
        requests = sum(poll.requests for poll in polls)
        if one.opened < ENOUGH_CONNECTIONS or requests > REQUESTS_PER_CONNECTION * one.opened:
            continue
        latency = merged(polls).latency
        text = f"{master or 'a master'} opened {one.opened:,} TCP connections to {link.name} for "
        text += f"{counted(requests, 'request', ',')} (one could stay open)"
        yield VerdictTrouble(
            rank=Rank.ODD, text=text, weight=one.opened * latency.percentile(50) / 1e9,
            who=master or link.name, search=link_word(link.name).strip(),
        )  # fmt: skip
