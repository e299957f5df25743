"""Writes the first sentence of a report: which unit has which trouble since when."""

# A trouble belongs to a unit, a link or a host. Failures that came late, or have ended, are told
# with their time, and their share is of the requests in it (ledger/unit_times.py). A unit can
# have several troubles; the worst come first.

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core.wording import counted, in_ms, percent
from mbtool.ledger.history import UnitRow
from mbtool.ledger.poll_statistics import PollStatistics
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.statistics import OTHER_UNITS
from mbtool.ledger.statistics_report import unit_polls, unit_tallies, unit_times
from mbtool.ledger.unit_times import UnitTimes
from mbtool.modbus import Outcome
from mbtool.troubles.failed_shares import FailedShare, missing_share, refused_share
from mbtool.troubles.failure_limits import FEW, are_damaged, never_answers
from mbtool.troubles.odd_polling import LateUnit, odd_polling
from mbtool.troubles.slow_units import are_many
from mbtool.troubles.slower_units import Slower, slow_and_slower_units
from mbtool.views.report.line_troubles import finding_troubles, line_troubles
from mbtool.views.report.odd_polling import odd_troubles
from mbtool.views.report.refusals import joined_refusals, refused_polls
from mbtool.views.report.troubles import Rank, VerdictTrouble, link_word, rank_of
from mbtool.views.trouble_words import (
    JOINED,
    codes_text,
    many_slow_text,
    many_slower_text,
    since_text,
    slow_text,
    slower_text,
    unit_name,
    units_text,
)

if TYPE_CHECKING:
    from mbtool.ledger.distribution import Distribution
    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.views.findings_table import Summaries

IN_SENTENCE = 3
"""The first sentence of a report names at most this many troubles; the page lists all below it."""


@dataclass(frozen=True, slots=True)
class _Unit:
    """The counts of one unit, and the times of its requests."""

    row: UnitRow
    name: str
    tally: RequestTally
    polls: Sequence[PollStatistics]
    times: UnitTimes | None
    """The times of its requests; None if the capture has no times."""

    def trouble(self, rank: Rank, text: str, weight: float, word: str = "") -> VerdictTrouble:
        search = f"{link_word(self.row.link)}unit:{self.row.unit} {word}".rstrip()
        return VerdictTrouble(
            rank=rank, text=text, weight=weight, who=self.name, search=search,
            units=frozenset((self.row,)), is_refusal=word == "exception",
        )  # fmt: skip

    def failure(self, text: str, share: FailedShare, word: str) -> VerdictTrouble:
        rank = rank_of(Rank.FAILING, share.failed, share.asked)
        return self.trouble(rank, text, share.share, word)


@dataclass(frozen=True, slots=True)
class ReportVerdict:
    """The report's first sentence, and all troubles."""

    sentence: str
    troubles: list[VerdictTrouble] = field(default_factory=list)
    told: int = 0
    """The sentence names this many of the troubles, the first ones of the list."""
    late_ns: dict[UnitRow, int] = field(default_factory=dict)
    """The latency (ns) from which an answer is late, for the units that have late answers."""

    is_answered: bool = False
    """True if a request of the capture was answered."""

    @property
    def level(self) -> str:
        """Return `bad` if a trouble is worse than Rank.RULE, `well` if there is none and requests
        were answered, else `doubt`.
        """
        worst = min((one.rank for one in self.troubles), default=None)
        if worst is None:
            return "well" if self.is_answered else "doubt"
        return "bad" if worst < Rank.RULE else "doubt"


def report_verdict(links: Sequence[LinkReport], findings: Summaries) -> ReportVerdict:
    """Judge a capture by its statistics and its findings (broken rules)."""
    tallies = unit_tallies(links)
    total = merged(list(tallies.values()))
    units = {UnitRow(*unit): tally for unit, tally in tallies.items() if unit[1] != OTHER_UNITS}
    if not total.transactions and not findings:
        some = "There are only broadcasts, which no unit answers, in the capture."
        none = "There is no transaction in the capture."
        return ReportVerdict(some if any(link.tally.transactions for link in links) else none)
    names = {row: unit_name(row, several=len(links) > 1) for row in units}
    polls = {UnitRow(*unit): some for unit, some in unit_polls(links).items()}
    times = unit_times(links)
    latencies: dict[tuple[str, int], Distribution] = {
        row: one.latency for row, one in units.items()
    }
    slow, slower = slow_and_slower_units(latencies, times)
    odd = odd_polling(links, tallies)
    troubles = [
        *line_troubles(links),
        *finding_troubles(findings),
        *odd_troubles(odd, lambda unit: names[UnitRow(*unit)]),
    ]
    for row, tally in units.items():
        unit = _Unit(row, names[row], tally, polls.get(row, ()), times.get(row))
        troubles += _unit_troubles(unit, slow.get(row), slower.get(row))
    troubles.sort(key=lambda one: (one.rank, -one.weight))
    troubles = joined_refusals(troubles, units, polls)
    troubles = _joined_slow(troubles, slower, len(units))
    grave = sum(one.rank < Rank.RULE for one in troubles)
    told = min(grave or len(troubles), IN_SENTENCE)
    sentence = _sentence(troubles, tallies, total)
    late_ns = {
        UnitRow(*one.unit): one.late_ns for kind in odd for one in kind if isinstance(one, LateUnit)
    }
    return ReportVerdict(sentence, troubles, told, late_ns, is_answered=_answered(total) > 0)


def _sentence(
    troubles: Sequence[VerdictTrouble], units: Collection[tuple[str, int]], total: RequestTally
) -> str:
    grave = [one for one in troubles if one.rank < Rank.RULE]
    minor = [one for one in troubles if one.rank >= Rank.RULE]
    if not troubles:
        return _all_well(units, total)
    told = grave or minor
    parts = [one.text for one in told[:IN_SENTENCE]]
    more = len(told) - len(parts)
    if more:
        parts.append(f"{counted(more, 'more trouble')} below")
    elif grave:
        sick = {unit for one in grave for unit in one.units}
        if len(units) > len(sick):
            parts.append("everything else is well" if not minor else "nothing else is grave")
    text = "; ".join(parts)
    if grave:
        return f"{text[:1].upper()}{text[1:]}."
    if minor[0].rank is Rank.MINOR:
        return f"Everything is well, but for small things: {text}."
    return f"Nothing grave, but worth a look: {text}."


def _answered(total: RequestTally) -> int:
    return sum(map(total.count, (Outcome.OK, Outcome.EXCEPTION, Outcome.MALFORMED)))


def _all_well(units: Collection[tuple[str, int]], total: RequestTally) -> str:
    """Return a sentence without troubles: which units answer how many requests.

    What the capture lacks is no trouble of a unit, but is not said to be well, either.
    """
    lacking = total.count(Outcome.NOT_CAPTURED)
    answered = _answered(total)
    lacks = f"the capture lacks parts of {counted(lacking, 'transaction', ',')}"
    if not answered:
        return f"No trouble shows, but {lacks if lacking else 'no request is answered'}."
    who = "the unit answers" if len(units) == 1 else f"{units_text(units)} answer"
    usual = total.latency.percentile(50)
    half = f", half of them within {in_ms(usual)} ms" if usual else ""
    text = f"Everything is well: {who} {counted(answered, 'request', ',')}{half}"
    return f"{text}; {lacks}." if lacking else f"{text}."


def _joined_slow(
    troubles: list[VerdictTrouble], slower: Collection[tuple[str, int]], units: int
) -> list[VerdictTrouble]:
    """Join the slow ones of all `units` into one trouble if they are many, and those that became
    `slower` into another one.

    Many slow units are a small thing, as their kind may just be slow.
    """
    of_slow = [one for one in troubles if one.rank is Rank.SLOW]
    became = [one for one in of_slow if one.units.issubset(slower)]
    always = [one for one in of_slow if not one.units.issubset(slower)]
    if (number := len(always)) >= JOINED:
        rank = Rank.MINOR if are_many(number, units) else Rank.SLOW
        text = many_slow_text(number, units, always[0].text)
        always = [replace(always[0], rank=rank, text=text, units=_units_of(always))]
    if (number := len(became)) >= JOINED:
        text = many_slower_text(number, units, became[0].text)
        became = [replace(became[0], text=text, units=_units_of(became))]
    told = sorted([*always, *became], key=lambda one: -one.weight)
    others = [one for one in troubles if one.rank is not Rank.SLOW]
    return sorted([*told, *others], key=lambda one: one.rank)


def _units_of(troubles: Sequence[VerdictTrouble]) -> frozenset[UnitRow]:
    return frozenset(unit for one in troubles for unit in one.units)


def _unit_troubles(unit: _Unit, usual: float | None, slower: Slower | None) -> list[VerdictTrouble]:
    """Return the troubles of one unit: missing, refused, malformed and slow responses.

    `usual` is the median latency of the other units in ns if this one is slow, else None;
    `slower` tells since when it is slower, if it became slower.
    """
    name, tally = unit.name, unit.tally
    asked = tally.requests
    found = []
    if never_answers(tally):
        what = "gives no answer with a right CRC" if are_damaged(tally) else "never answers"
        lacking = asked - tally.unanswered
        cut = f", and {lacking:,} not captured whole" if lacking else ""
        never = f"{name} {what} ({counted(tally.unanswered, 'request', ',')}{cut})"
        return [unit.trouble(Rank.DEAD, never, tally.unanswered)]
    if (missing := missing_share(tally, unit.times)) is not None:
        found.append(_unanswered(unit, missing))
    if (refused := refused_share(tally, unit.times)) is not None:
        found.append(_refusals(unit, refused))
    if number := tally.count(Outcome.MALFORMED):
        share = FailedShare(number, asked)
        text = f"{name} gives {counted(number, 'malformed answer', ',')} ({percent(share.share)})"
        found.append(unit.failure(text, share, "malformed"))
    own = tally.latency.percentile(50)
    if usual is not None:
        found.append(unit.trouble(Rank.SLOW, slow_text(name, own, usual), own / usual))
    elif slower is not None:
        found.append(unit.trouble(Rank.SLOW, slower_text(name, slower), slower.factor))
    return found


def _unanswered(unit: _Unit, share: FailedShare) -> VerdictTrouble:
    requests, when = _requests(share), since_text(share)
    if are_damaged(unit.tally):
        is_all = unit.tally.damaged == unit.tally.unanswered
        how = "with a wrong CRC" if is_all else "with a wrong CRC or not at all"
        text = f"{unit.name} answers {requests} {how}{when}"
    else:
        text = f"{unit.name} leaves {requests} without an answer{when}"
    return unit.failure(text, share, "no-answer")


def _refusals(unit: _Unit, share: FailedShare) -> VerdictTrouble:
    codes = codes_text(unit.tally)
    text = f"{unit.name} refuses {_requests(share)}{since_text(share)}, {codes}"
    named = refused_polls(unit.polls, unit.tally)
    if named:
        text = f"{unit.name} {named} {codes}"
    return unit.failure(text, share, "exception")


def _requests(share: FailedShare) -> str:
    if share.failed == share.asked:
        return "all its requests"
    number = percent(share.share) if share.share >= FEW else f"{share.failed:,}"
    return f"{number} of its requests"
