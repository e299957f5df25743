"""Finds the troubles of units: silent, missing, damaged, malformed, refused and slow answers."""

# failed_shares.py computes which share of the requests failed in which time, and if this share is
# small; slow_units.py and `slow_and_slower_units` decide which latency is slow. A unit that never
# answers has no other trouble. If a unit refuses a request each time, the trouble has no beginning.

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from mbtool.core.moments import DAY_NS, counted, in_ms, percent
from mbtool.ledger.poll_statistics import PollStatistics
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.statistics_report import LinkReport, unit_polls, unit_tallies, unit_times
from mbtool.ledger.unit_account import UnitAccount
from mbtool.modbus import Outcome, short_name
from mbtool.modbus.functions import GATEWAY_EXCEPTIONS
from mbtool.troubles.failed_shares import (
    MIN_FAILED_SHARE,
    FailedShare,
    are_damaged,
    missing_share,
    never_answers,
    refused_share,
)
from mbtool.troubles.slow_units import GRAVE_NS, MIN_ANSWERS, are_many, slow_units
from mbtool.troubles.trouble import Trouble, moment_text

if TYPE_CHECKING:
    from mbtool.ledger.distribution import Distribution
    from mbtool.ledger.time_bins import UnitBin
    from mbtool.troubles.cases import Cases


# Judges the requests that units refuse: which ones, by how many units, and if in a scan.

K = TypeVar("K")

MANY_REFUSING = 4
"""If at least this many units, and half of all, refuse requests, one trouble reports all: the
requests are wrong, not the units."""
SCAN = 20
"""Refused requests are called a scan if at least this many of them are different, and ONCE."""
ONCE = 0.9
"""Refused requests are called a scan only if the number of different ones is at least this share
(0 to 1) of all: nearly none was sent twice."""


@dataclass(frozen=True, slots=True)
class JointRefusals:
    """Many units that refuse requests."""

    units: int
    of: int
    """The number of all units."""
    tally: RequestTally
    """The counts of all units that refuse, added up."""
    scanned: int
    """The number of different requests if they look like a scan; otherwise 0."""
    master: str
    """The host that scans; empty if it is not known, or if there are several."""


def joint_refusals(
    refusing: Collection[K],
    tallies: Mapping[K, RequestTally],
    polls: Mapping[K, Sequence[PollStatistics]],
) -> JointRefusals | None:
    """Return the refusals of the units `refusing` as one trouble; None if these are not many.

    `tallies` has the counts of all units, `polls` the polls of each that are still known.
    """
    if len(refusing) < MANY_REFUSING or len(refusing) * 2 < len(tallies):
        return None
    tally = merged([tallies[unit] for unit in refusing])
    known = [poll for unit in refusing for poll in polls.get(unit, ())]
    is_scan = are_all(known, tally) and len(known) >= max(SCAN, ONCE * tally.requests)
    masters = {poll.key.master for poll in known}
    return JointRefusals(
        units=len(refusing),
        of=len(tallies),
        tally=tally,
        scanned=len(known) if is_scan else 0,
        master=masters.pop() if is_scan and len(masters) == 1 else "",
    )


def always_refused(polls: Sequence[PollStatistics], tally: RequestTally) -> list[PollStatistics]:
    """Return the polls (repeated requests) that a unit refuses each time.

    `tally` has the counts of the unit, `polls` those of its polls that are still known. The list is
    empty if some are no longer known, if other refusals remain, or if the unit refuses all that it
    is asked.
    """
    refused = [poll for poll in polls if poll.tally.count(Outcome.EXCEPTION)]
    number = sum(poll.tally.transactions for poll in refused)
    is_certain = number == tally.count(Outcome.EXCEPTION) and are_all(polls, tally)
    return refused if is_certain and len(refused) < len(polls) else []


def are_all(polls: Sequence[PollStatistics], tally: RequestTally) -> bool:
    """False if some of the requests of `tally` are of polls that are no longer known."""
    return sum(poll.tally.requests for poll in polls) >= tally.requests


# Finds the units that became slower, and the time since when they are slower.


SLOWER = 2
"""A unit has become slower if its mean latency in the last quarter of its bins of time is at least
this many times that in the first half, and at least SLOWER_NS more."""
SLOWER_NS = 10_000_000
"""The least rise (ns) of the mean latency of a unit that became slower; see SLOWER."""
_ENOUGH_BINS = 8
"""A unit with answers in fewer bins than this is never said to have become slower."""


class Slower(NamedTuple):
    """The time from which a unit answers slower, and its mean latencies before and since."""

    since_ns: int
    """The time (UTC ns), exact to a bin."""
    mean_ns: float
    """The mean latency since then, in ns."""
    before_ns: float
    """The mean latency before, in ns."""
    is_long: bool
    """True if the unit was heard for a day or longer, so that times need a date."""

    @property
    def factor(self) -> float:
        """The mean latency since then, divided by that before."""
        return self.mean_ns / (self.before_ns or 1)


def slow_and_slower_units(
    latencies: Mapping[K, Distribution], times: Mapping[K, UnitAccount]
) -> tuple[dict[K, float], dict[K, Slower]]:
    """Return the units that always were slow, as slow_units does, and those that became slower.

    `latencies` and `times` have the latencies and the times of the requests of each unit.
    """
    found = {unit: became_slower(one.bins.bins()) for unit, one in times.items()}
    slower = {unit: one for unit, one in found.items() if one is not None and unit in latencies}
    slow = slow_units(latencies)
    return {unit: usual for unit, usual in slow.items() if unit not in slower}, slower


def became_slower(bins: Sequence[UnitBin]) -> Slower | None:
    """Return since when a unit is slower (SLOWER); None if it is not, or not any more.

    `bins` are the unit's, sorted by time.
    """
    bins = [one for one in bins if one.answered]
    if len(bins) < _ENOUGH_BINS:
        return None
    half = len(bins) // 2
    usual_ns, late_ns = _mean(bins[:half]), _mean(bins[-len(bins) // 4 :])
    if late_ns < max(SLOWER * usual_ns, usual_ns + SLOWER_NS):
        return None
    middle_ns = (usual_ns + late_ns) / 2
    fast = (at for at, one in enumerate(bins) if _mean([one]) < middle_ns)
    first = max(fast, default=-1) + 1
    since = bins[first:]
    is_over = len(since) < len(bins) // 8  # The unit became fast again.
    if not first or is_over or sum(one.answered for one in since) < MIN_ANSWERS:
        return None

    def slow_ns(one: UnitBin) -> int:
        """Return for how much of a bin the unit was slow, by the bin's mean."""
        share = (_mean([one]) - usual_ns) / (late_ns - usual_ns)
        return round(min(max(share, 0), 1) * (one.end_ns - one.begin_ns))

    since_ns = since[0].end_ns - slow_ns(since[0])
    if bins[first - 1].end_ns == since[0].begin_ns == since_ns:
        since_ns -= slow_ns(bins[first - 1])
    is_long = bins[-1].end_ns - bins[0].begin_ns >= DAY_NS
    # Leave out the last bin before the slow ones, because the unit may have become slower in it.
    # Leave out the second half of the recording, because it may have single late answers.
    before = bins[: max(min(first - 1, half), 1)]
    return Slower(since_ns, _mean(since), _mean(before), is_long)


def _mean(bins: Sequence[UnitBin]) -> float:
    """Return the mean latency in some bins, in ns."""
    return sum(one.latency_ns for one in bins) / sum(one.answered for one in bins)


_NAMED = 2
"""A text names the requests that a unit always refuses if there are at most this many."""
_SEARCH = {
    "UNIT-SILENT": "no-answer",
    "UNIT-BAD-CRC": "no-answer",
    "UNIT-MISSING": "no-answer",
    "UNIT-MALFORMED": "malformed",
    "UNIT-REFUSES": "exception",
}
"""By code, the search in the report's table that shows the trouble's requests."""
_CHECK_LINE = "check its power, address, wires and line settings"
_CHECK_NETWORK = "check that it runs, and that address, unit and gateway are right"
_LOOK_LINE = "check its cable, and if the master's time-out is long enough"
_LOOK_NETWORK = "check its load, the network, and if the master's time-out is long enough"
_ADVICE = {
    1: "use a function that its manual lists",
    2: "correct the address or quantity of the request by its manual",
    3: "correct the quantity or value of the request by its manual",
    4: "read the error of the device itself",
    5: "give it time, and ask again later",
    6: "ask it more rarely",
    0x0A: "correct the routes of the gateway",
    0x0B: "check the unit behind the gateway: its power, address, wires and line settings",
}
"""What to do about an exception, by its code."""
_OTHER_ADVICE = "look the exception up in its manual"


class _Joined(NamedTuple):
    text: str
    advice: str


@dataclass(frozen=True, slots=True)
class _JudgedUnit:
    link: str
    number: int
    tally: RequestTally
    polls: Sequence[PollStatistics]
    times: UnitAccount | None
    """The times of the unit's requests; None if the recording has no times, or if the unit never
    answers."""
    is_serial: bool

    def trouble(self, code: str, share: FailedShare, **figures: str) -> Trouble:
        never = never_answers(self.tally)
        return Trouble(
            code=code,
            link=self.link,
            unit=self.number,
            count=share.failed,
            of=max(share.asked, share.failed),
            since_ns=share.since_ns,
            until_ns=share.until_ns,
            is_long=share.is_long,
            is_small=not (share.is_grave or (never and share.failed > 1)),
            weight=share.failed if never else share.share,
            search=_SEARCH[code],
            figures={
                "requests": _requests(share),
                "part": _part_text(share),
                "percent": percent(share.share),
                "check": _CHECK_LINE if self.is_serial else _CHECK_NETWORK,
                "look": _LOOK_LINE if self.is_serial else _LOOK_NETWORK,
                **figures,
            },
        )


def unit_troubles(links: Sequence[LinkReport], cases: Cases) -> Iterator[Trouble]:
    """Yield the troubles of single units; `links` has the account of each link."""
    tallies, times, polls = unit_tallies(links), unit_times(links), unit_polls(links)
    serial = {link.name for link in links if link.is_serial}
    units = {
        (link, number): _JudgedUnit(
            link,
            number,
            tally,
            polls.get((link, number), ()),
            None if never_answers(tally) else times.get((link, number)),
            link in serial,
        )
        for (link, number), tally in tallies.items()
    }
    refusing: dict[tuple[str, int], Trouble] = {}
    for key, unit in units.items():
        yield from _failures(unit)
        if not never_answers(unit.tally) and (refusal := _refusal(unit)) is not None:
            refusing[key] = refusal
    grave = [key for key, one in refusing.items() if not one.is_small]
    joint = joint_refusals(grave, tallies, polls)
    if joint is not None and joint.scanned:
        first = refusing[grave[0]]
        yield _scan(joint, first.link)
        refusing = {key: one for key, one in refusing.items() if one.is_small}
    yield from refusing.values()
    yield from _slow(units, cases)


def _failures(unit: _JudgedUnit) -> Iterator[Trouble]:
    tally = unit.tally
    if never_answers(tally):
        share = FailedShare(tally.unanswered, tally.unanswered)
        lacking = tally.requests - tally.unanswered
        requests = counted(tally.unanswered, "request", ",")
        if lacking:
            requests = f"{requests}, and {lacking:,} not captured whole"
        if are_damaged(tally):
            yield unit.trouble("UNIT-BAD-CRC", share, requests="all its requests", part="")
        else:
            yield unit.trouble("UNIT-SILENT", share, requests=requests)
        return
    missing = missing_share(tally, unit.times)
    if missing is not None:
        code = "UNIT-BAD-CRC" if are_damaged(tally) else "UNIT-MISSING"
        yield unit.trouble(code, missing)
    if number := tally.count(Outcome.MALFORMED):
        yield unit.trouble("UNIT-MALFORMED", FailedShare(number, tally.requests))


def _refusal(unit: _JudgedUnit) -> Trouble | None:
    share = refused_share(unit.tally, unit.times)
    if share is None:
        return None
    requests, part = _requests(share), _part_text(share)
    refused = always_refused(unit.polls, unit.tally)
    if refused:
        # The trouble has no beginning if the unit refuses the request each time.
        share = share._replace(since_ns=None, until_ns=None)
        requests, part = _refused_text(refused, unit), ""
    codes, advice = _codes(unit.tally)
    figures = {"requests": requests, "part": part, "codes": codes, "advice": advice}
    return unit.trouble("UNIT-REFUSES", share, **figures)


def _refused_text(refused: Sequence[PollStatistics], unit: _JudgedUnit) -> str:
    """Return which requests a unit refuses each time: `03 holding 4 each time (3 times)`."""
    number = unit.tally.count(Outcome.EXCEPTION)
    often = sorted(refused, key=lambda poll: -poll.tally.transactions)
    if len(often) > _NAMED:
        some = f"{len(often):,} of its {len(unit.polls):,} different requests"
        return f"{some}, such as {_request(often[0])}"
    named = " and ".join(map(_request, often))
    return f"{named} each time ({number:,} times)" if number > 1 else f"{named} (once)"


def _request(poll: PollStatistics) -> str:
    return f"{poll.key.function:02X} {poll.reference or short_name(poll.key.function, '')}".rstrip()


def _codes(tally: RequestTally) -> _Joined:
    """Return the exception codes of the refusals in words, the most frequent first, and what to do
    about the most frequent one.
    """
    often = sorted(tally.exceptions, key=lambda one: -tally.exceptions[one])
    if not often:  # Only logs of other programs lack the codes.
        return _Joined("with unknown codes", _OTHER_ADVICE)
    names = [exception_text(code, tally.exception_names[code]) for code in often]
    text = f"with {names[0]}"
    if len(names) == 2:
        text = f"{text} or {names[1]}"
    elif len(names) > 2:
        text = f"{text}, {names[1]} or others"
    return _Joined(text, _ADVICE.get(often[0], _OTHER_ADVICE))


def exception_text(code: int, name: str) -> str:
    """Return code and name, such as `02 illegal data address`.

    The name of an unknown code has the number in it, so the name alone is returned.
    """
    return name if name.startswith("exception") else f"{code:02X} {name}".rstrip()


def _scan(joint: JointRefusals, link: str) -> Trouble:
    some = f"{joint.units} of {joint.of}" if joint.units < joint.of else f"all {joint.of}"
    refused, asked = joint.tally.count(Outcome.EXCEPTION), joint.tally.requests
    total = FailedShare(refused, asked)
    figures = {
        "units": f"{some} units",
        "requests": _requests(total).replace("its", "their") + _part_text(total),
        "codes": _codes(joint.tally).text,
        "different": f"{joint.scanned:,}",
        "by": f" by {joint.master}" if joint.master else "",
    }
    return Trouble(
        code="NET-SCANNED", link=link, master=joint.master, count=refused, of=asked,
        figures=figures, search="exception",
    )  # fmt: skip


def _slow(units: dict[tuple[str, int], _JudgedUnit], cases: Cases) -> Iterator[Trouble]:
    """Yield a trouble for each slow unit, and for each that became slower."""
    units = {key: unit for key, unit in units.items() if not _is_answered_for(unit.tally)}
    slow, slower = slow_and_slower_units(
        {key: unit.tally.latency for key, unit in units.items()},
        {key: unit.times for key, unit in units.items() if unit.times is not None},
    )
    are_of_kind = are_many(len(slow), len(units))
    for key, usual in slow.items():
        unit, own = units[key], units[key].tally.latency.percentile(50)
        yield Trouble(
            code="UNIT-SLOW", link=unit.link, unit=unit.number, count=unit.tally.latency.count // 2,
            of=unit.tally.latency.count, weight=own / usual,
            is_small=are_of_kind or own < GRAVE_NS,
            figures={"median": _ms(own), "usual": _ms(usual)},
            evidence=cases.slowest(unit.polls),
        )  # fmt: skip
    for key, one in slower.items():
        yield _slower(units[key], one, cases)


def _is_answered_for(tally: RequestTally) -> bool:
    """True if most answers come from a gateway that could not reach the unit (0A, 0B).

    Their latencies are those of the gateway's time-out.
    """
    of_gateway = sum(tally.exceptions.get(code, 0) for code in GATEWAY_EXCEPTIONS)
    return 2 * of_gateway > tally.latency.count


def _slower(unit: _JudgedUnit, one: Slower, cases: Cases) -> Trouble:
    answers = sum(each.answered for each in unit.times.bins.bins()) if unit.times else 0
    since = f" since {moment_text(one.since_ns, is_long=one.is_long)}"
    return Trouble(
        code="UNIT-SLOWER", link=unit.link, unit=unit.number, count=answers, weight=one.factor,
        is_long=one.is_long,
        figures={"mean": _ms(one.mean_ns), "before": _ms(one.before_ns), "since": since},
        evidence=cases.slowest(unit.polls, since_ns=one.since_ns),
    )  # fmt: skip


def _ms(ns: float) -> str:
    return f"{in_ms(ns)} ms"


def _requests(share: FailedShare) -> str:
    """Return `all its 12 requests`, `its only request` or `3 of its 19 requests`."""
    if share.failed >= share.asked:
        return "its only request" if share.failed == 1 else f"all its {share.failed:,} requests"
    return f"{share.failed:,} of its {share.asked:,} requests"


def _part_text(share: FailedShare) -> str:
    """Return ` (26 %)`, to be put behind the requests; empty for all of them, or hardly any."""
    is_told = MIN_FAILED_SHARE <= share.share < 1
    return f" ({percent(share.share)})" if is_told else ""
