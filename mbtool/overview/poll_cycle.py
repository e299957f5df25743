"""Rebuilds the lists that a master polls in cycles, from its requests and their times."""

# A list is a sequence of polls that a master asks in order, again and again, each time after a
# period or at once. A master may have several lists with different periods, repeat a request that
# got no answer, and ask other things in between, such as writes on an operator's command.
#
# Strategy. A repeated request counts as one with the request that it repeats. Polls that were asked
# fewer than MIN_CYCLES times belong to no list. Of the others:
#
# 1. Cut the sequence of polls at one transition (from one poll to another), and take the most
#    frequent piece as the cycle; of all transitions, the one whose cycle explains most requests.
#    If it explains nearly all, it is the list...
# 2. ...unless timing shows that it is two lists whose periods have a whole ratio: a poll that comes
#    several times in the cycle at even distances, while the pauses of the cycle are uneven.
# 3. If no cycle explains nearly all, join polls whose own periods are regular and equal, and start
#    again at 1 with each group. A poll without a regular period that comes equally often in
#    each cycle of a group belongs to it, too.
# 4. If there are no such groups, start again with the polls that are asked often; and take a
#    cycle that explains MANY of the requests, then look for lists in the rest.
#
# Memory: a few lists of the requests that are given; the caller bounds their number.

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from statistics import median, median_low
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from mbtool.overview.cycle_cuts import (
    MIN_CYCLES,
    CutCycles,
    PollStart,
    cycle_times,
    has_one_pace,
    number_of_other_cycles,
    step_pauses,
    usual_cycles,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterable, Sequence

P = TypeVar("P", bound="Hashable")

MOST = 0.9
"""The share of requests that one cycle must explain to be taken at once."""
MANY = 0.4
"""The share of requests that a cycle must explain to be a list at all."""
_REGULAR = 0.2
"""A period is regular if it differs from the poll's median period by at most this share of the
median."""
_REGULAR_SHARE = 0.7
"""A poll is regular if at least this share of its periods are. Of two alternating periods only half
are."""
_PERIOD_SUM = 1.3
"""The mean period of a regular poll is at most this many times its median period. A poll that comes
thrice in a cycle, close together, has a short median."""
_SOON = 0.5
"""A request repeats an equal one without answer if it comes at most this share of the timeout after
the master gave that one up. A later one is the next cycle of a list of one poll."""
_EQUAL_PERIODS = 1.08
_EVEN = 0.1
"""Distances are even if they differ by at most this share of their mean."""
_LONG_PAUSE = 0.2
"""A pause in a cycle is long if it has at least this share of the longest, and more than
_LONGER_THAN_SHORT times the shortest."""
_LONGER_THAN_SHORT = 4
_CONSTANT_SHARE = 0.8
"""A poll belongs to a list if it comes equally often in at least this share of its cycles."""
_SLACK_NS = 5_000_000
"""Pauses that differ by less than this, in ns, are equal: no master keeps time more exactly."""
_NEAR = 0.25
"""A cycle time is near the median if it differs by at most this share of the median."""


class Asked(NamedTuple, Generic[P]):
    """A request of the master: its poll and its times."""

    poll: P
    begin_ns: int
    end_ns: int
    """When the response was complete or, without a response, when the request was."""
    is_missing: bool
    """True if the slave had to answer and did not."""
    is_damaged: bool = False
    """True if the answer is missing because it came with a wrong CRC or LRC: then the master may
    go on before its timeout is over."""


@dataclass(frozen=True, slots=True)
class PollStep(Generic[P]):
    """One step of a list: a poll, and how long it takes."""

    poll: P
    pause_ns: int
    """The median time from the end of the previous step to the beginning of this one."""
    took_ns: int
    """The median time from the beginning of the first request to the end of the last response, or
    to when the master gave up."""
    missing: int
    """The number of cycles in which at least one answer of this step was missing."""


@dataclass(frozen=True, slots=True)
class PollList(Generic[P]):
    """A list that a master polls in cycles. Times are in ns."""

    steps: tuple[PollStep[P], ...]
    """The steps in the order of the requests; the first one follows the longest pause."""
    cycles: int
    """The number of cycles that went through the list exactly."""
    other_cycles: int
    """The number of cycles that lacked a step, had one more, or were in another order."""
    times: tuple[int, ...]
    """The time of each cycle, from its beginning to the next one's, in order of length."""
    whole_ns: int | None
    """The median time of the cycles in which no answer is missing; None if there is none."""
    missing_ns: int | None
    """The median time of the cycles in which an answer is missing; None if there is none."""

    @property
    def period_ns(self) -> int:
        """The usual time of a cycle: the mean of all that are near the median."""
        middle = median_low(self.times)
        near = [time for time in self.times if abs(time - middle) <= _NEAR * middle]
        return sum(near) // len(near)

    @property
    def polls(self) -> list[P]:
        return [step.poll for step in self.steps]

    @property
    def repeated(self) -> list[P]:
        """The polls that are asked more than once in a cycle."""
        return [poll for poll, count in Counter(self.polls).items() if count > 1]

    @property
    def missing_cost_ns(self) -> int | None:
        """The time by which missing answers make a cycle longer; None if that is unknown."""
        if self.whole_ns is None or self.missing_ns is None:
            return None
        return max(self.missing_ns - self.whole_ns, 0)


@dataclass(frozen=True, slots=True)
class PollLists(Generic[P]):
    """The lists that a master polls in cycles, and its other requests."""

    lists: tuple[PollList[P], ...]
    """The lists, the one with the shortest period first."""
    between: Mapping[P, int]
    """For each poll that is in no list, the number of its requests without repetitions."""
    timeout_ns: int | None
    """The estimated time that the master waits for an answer; None if no answer is missing."""


def find_lists(asked: Iterable[Asked[P]]) -> PollLists[P]:
    """Find the lists of one master on one link. The requests may come in any order."""
    in_order = sorted(asked, key=lambda one: one.begin_ns)
    timeout_ns = response_timeout(in_order)
    starts = _without_repetitions(in_order, timeout_ns or 0)
    counts = Counter(start.poll for start in starts)
    often = {poll for poll, count in counts.items() if count >= MIN_CYCLES}
    lists = _lists(_only(starts, often))
    lists.sort(key=lambda one: one.period_ns)
    listed = {step.poll for one in lists for step in one.steps}
    between = {poll: count for poll, count in counts.items() if poll not in listed}
    return PollLists(tuple(lists), between, timeout_ns)


def response_timeout(in_order: Sequence[Asked[P]]) -> int | None:
    """How long (ns) the master waits for an answer; None if it never waited in vain.

    This is nearly the shortest time from a request without answer to the next request: after some
    of them the master also pauses.
    """
    waits = sorted(
        after.begin_ns - one.end_ns
        for one, after in pairwise(in_order)
        if one.is_missing and not one.is_damaged
    )
    return max(waits[len(waits) // 10], 0) if waits else None


def _without_repetitions(asked: Sequence[Asked[P]], timeout_ns: int) -> list[PollStart[P]]:
    if not any(one.is_missing for one in asked):
        return [PollStart(*one[:4]) for one in asked]
    starts: list[PollStart[P]] = []
    was_missing = False
    for one in asked:
        is_waited_for = one.is_missing and not one.is_damaged
        end_ns = one.end_ns + (timeout_ns if is_waited_for else 0)
        is_soon = bool(starts) and one.begin_ns - starts[-1].end_ns <= _SOON * timeout_ns
        if was_missing and is_soon and starts[-1].poll == one.poll:
            starts[-1] = starts[-1]._replace(end_ns=end_ns)
        else:
            starts.append(PollStart(one.poll, one.begin_ns, end_ns, one.is_missing))
        was_missing = one.is_missing
    return starts


def _only(starts: Sequence[PollStart[P]], polls: Collection[P]) -> list[PollStart[P]]:
    return [start for start in starts if start.poll in polls]


def _lists(starts: Sequence[PollStart[P]]) -> list[PollList[P]]:
    if len(starts) < MIN_CYCLES:
        return []
    cycles = usual_cycles(starts)
    if cycles is not None and cycles.share >= MOST:
        fast = _faster_polls(cycles)
        if not fast:
            return _with_others(cycles)
        fast |= _irregular_polls(starts, fast)
        slow = {start.poll for start in starts} - fast
        return _lists(_only(starts, fast)) + _lists(_only(starts, slow))
    groups = _groups(starts)
    if groups:
        return [found for group in groups for found in _lists(_only(starts, group))]
    often = _asked_often(starts)
    if len(often) < len({start.poll for start in starts}):
        return _lists(_only(starts, often))
    return _with_others(cycles) if cycles is not None and cycles.share >= MANY else []


def _with_others(cycles: CutCycles[P]) -> list[PollList[P]]:
    """The list of these cycles, and the lists of the polls that are not in it."""
    if not _has_pace(cycles):
        return []
    others = {start.poll for start in cycles.starts} - set(cycles.usual)
    return [_poll_list(cycles), *_lists(_only(cycles.starts, others))]


def _faster_polls(cycles: CutCycles[P]) -> set[P]:
    """The polls that come several times in the usual cycle, at a shorter period of their own."""
    counts = Counter(cycles.usual)
    repeated = {poll for poll, count in counts.items() if count > 1}
    if not repeated or len(repeated) == len(counts):
        return set()
    pauses = step_pauses(cycles)
    if has_one_pace(cycles):
        return set()
    bursts = _bursts(cycles.usual, pauses)
    fast = {
        poll
        for poll in repeated
        if _is_evenly_asked(cycles, poll)
        or (len(bursts) > 1 and all(burst.count(poll) == 1 for burst in bursts))
    }
    most = max((counts[poll] for poll in fast), default=0)
    return {poll for poll in fast if counts[poll] == most}


def _bursts(usual: tuple[P, ...], pauses: Sequence[float]) -> list[tuple[P, ...]]:
    """Divide a cycle at its long pauses."""
    least = max(_LONG_PAUSE * max(pauses), _LONGER_THAN_SHORT * max(min(pauses), 0))
    long = [at for at, pause in enumerate(pauses) if pause > least]
    if not long:
        return [usual]
    inner = [usual[begin:end] for begin, end in pairwise(long)]
    return [*inner, usual[long[-1] :] + usual[: long[0]]]


def _is_evenly_asked(cycles: CutCycles[P], poll: P) -> bool:
    """True if all distances from one request of a poll to the next are about the same."""
    times = [start.begin_ns for piece in cycles.pieces() for start in piece if start.poll == poll]
    by_place: list[list[int]] = [[] for _ in range(cycles.usual.count(poll))]
    for at, (one, other) in enumerate(pairwise(times)):
        by_place[at % len(by_place)].append(other - one)
    distances = [median(one) for one in by_place if one]
    mean = sum(distances) / len(distances)
    return max(distances) - min(distances) <= _EVEN * mean


def _groups(starts: Sequence[PollStart[P]]) -> list[set[P]]:
    """Groups of polls with one period; empty if all polls would be in one, or none is regular."""
    times: defaultdict[P, list[int]] = defaultdict(list)
    for start in starts:
        times[start.poll].append(start.begin_ns)
    periods = {poll: _regular_period(one) for poll, one in times.items()}
    groups: list[set[P]] = []
    last_ns = 0.0
    for poll, period in sorted(
        ((poll, period) for poll, period in periods.items() if period is not None),
        key=lambda one: one[1],
    ):
        if groups and period <= last_ns * _EQUAL_PERIODS:
            groups[-1].add(poll)
        else:
            groups.append({poll})
        last_ns = period
    for poll in (poll for poll, period in periods.items() if period is None):
        for group in groups:
            if _is_constant(starts, group, times[poll]):
                group.add(poll)
                break
    return [] if any(len(group) == len(times) for group in groups) else groups


def _regular_period(times: Sequence[int]) -> float | None:
    """The median period of a poll in ns; None if its periods are not regular."""
    periods = [other - one for one, other in pairwise(times)]
    if len(periods) < MIN_CYCLES - 1:
        return None
    usual = median(periods)
    near = [period for period in periods if abs(period - usual) <= _REGULAR * usual]
    is_regular = (
        usual > 0
        and len(near) >= _REGULAR_SHARE * len(periods)
        and sum(periods) <= _PERIOD_SUM * usual * len(periods)
    )
    return usual if is_regular else None


def _is_constant(starts: Sequence[PollStart[P]], group: set[P], times: Sequence[int]) -> bool:
    """True if a poll, sent at `times`, comes equally often (not 0) in each cycle of a group."""
    cycles = usual_cycles(_only(starts, group))
    if cycles is None:
        return False
    begins = [cycles.starts[at].begin_ns for at in cycles.cuts[:-1]]
    counts = Counter(bisect_right(begins, time) for time in times)
    inner = [counts[at] for at in range(1, len(begins))]
    if not inner:
        return False
    usual, number = Counter(inner).most_common(1)[0]
    return usual > 0 and number >= _CONSTANT_SHARE * len(inner)


def _irregular_polls(starts: Sequence[PollStart[P]], group: set[P]) -> set[P]:
    """The polls without a regular period that come equally often in each cycle of a group."""
    times: defaultdict[P, list[int]] = defaultdict(list)
    for start in starts:
        if start.poll not in group:
            times[start.poll].append(start.begin_ns)
    return {
        poll
        for poll, one in times.items()
        if _regular_period(one) is None and _is_constant(starts, group, one)
    }


def _has_pace(cycles: CutCycles[P]) -> bool:
    """False for a single poll at irregular times, such as an operator's occasional write."""
    if len(cycles.usual) > 1:
        return True
    starts = [start for start in cycles.starts if start.poll == cycles.usual[0]]
    if _regular_period([start.begin_ns for start in starts]) is not None:
        return True
    pauses = [after.begin_ns - one.end_ns for one, after in pairwise(starts)]
    usual = median(pauses)
    near = [one for one in pauses if abs(one - usual) <= max(_REGULAR * usual, _SLACK_NS)]
    return len(near) >= _REGULAR_SHARE * len(pauses)


def _asked_often(starts: Sequence[PollStart[P]]) -> set[P]:
    """The polls that are asked at least half as often as the median poll."""
    counts = Counter(start.poll for start in starts)
    least = median(counts.values()) / 2
    return {poll for poll, count in counts.items() if count >= least}


def _poll_list(cycles: CutCycles[P]) -> PollList[P]:
    pieces = cycles.pieces()
    pauses = step_pauses(cycles)
    steps = tuple(
        PollStep(
            poll,
            max(round(pauses[at]), 0),
            median_low([one[at].end_ns - one[at].begin_ns for one in pieces]),
            sum(one[at].is_missing for one in pieces),
        )
        for at, poll in enumerate(cycles.usual)
    )
    whole, missing = cycle_times(cycles)
    return PollList(
        steps,
        len(pieces),
        number_of_other_cycles(cycles),
        tuple(sorted(whole + missing)),
        median_low(whole) if whole else None,
        median_low(missing) if missing else None,
    )
