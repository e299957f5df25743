"""Reconstructs the lists that a master polls in cycles, from its requests and their times."""

# A poll is all equal requests of one master to one unit. A polled list is a sequence of polls that
# a master sends in order, again and again, at a fixed period or without a pause. A master may have
# several lists with different periods, retry a request that got no response, and send other
# requests in between, such as writes on an operator's command.
#
# Strategy. A request and its retries count as one request. Polls that were sent fewer than
# MIN_CYCLES times belong to no list. For the others:
#
# 1. A transition is a poll that follows a certain other poll. Cut the sequence of requests at every
#    occurrence of one transition. The most frequent sequence between two cuts is the cycle of this
#    transition; it explains the share of all requests that are in such sequences. Take the
#    transition whose cycle explains most. If that share is at least MOST, the cycle is a list,
#    except for case 2.
# 2. If a poll comes several times in the cycle at even distances, while the pauses in the cycle are
#    uneven, the cycle consists of two lists. The period of one is a multiple of the other's.
# 3. If no cycle explains MOST of the requests, group the polls whose own periods are regular and
#    equal, and start again at 1 with the requests of each group. A poll without a regular period
#    that comes equally often in each cycle of a group belongs to that group, too.
# 4. If there are no such groups, start again at 1 with only the polls that are sent often. If all
#    polls are sent often, take a cycle that explains at least MIN_CYCLE_SHARE, and search for lists
#    in the remaining requests.
#
# Memory: a few copies of the list of requests; the caller limits its length.

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median, median_low
from typing import Generic, NamedTuple, TypeVar

# The code below cuts the requests of a master into poll cycles, by finding the sequence that
# repeats.
#
# Memory: a few copies of the list of requests that the caller passes.

P = TypeVar("P", bound="Hashable")

MIN_CYCLES = 3
"""A sequence of requests must repeat at least this often to count as a poll cycle, as two equal
sequences may be chance."""
MIN_REQUESTS = 6
"""All repetitions of a poll cycle together must have at least this many requests. So a single
request that was sent only three times is no cycle."""
_TRANSITIONS = 64
"""At most this many transitions (pairs of polls that follow each other) are tried as the beginning
of a cycle, the most frequent first. In a cycle with more steps than that, all transitions are
equally frequent, so that any of them gives the cycle."""
_SAME_PACE = 0.25
"""The pauses before the steps of a cycle count as equal if the longest and the shortest differ by
at most this share of the mean time from one request to the next."""
_TIED = 0.02
"""Two ways to cut requests into cycles count as equally good if their shares (0 to 1) of requests
in equal cycles differ by at most this. Then the cycle with fewer steps is taken."""


class PollStart(NamedTuple, Generic[P]):
    """A request together with its retries, which lasts from the beginning of the first attempt to
    the end of the last one.
    """

    poll: P
    begin_ns: int
    end_ns: int
    is_missing: bool
    """True if the first attempt got no answer. If all attempts got no answer, `end_ns` is the time
    when the master stopped waiting."""


class CutCycles(NamedTuple, Generic[P]):
    """A sequence of requests in order of time, cut into poll cycles."""

    starts: Sequence[PollStart[P]]
    cuts: Sequence[int]
    """The indices in `starts` of the first request of each cycle; the last element is the length of
    `starts`."""
    usual: tuple[P, ...]
    share: float
    """The share (0 to 1) of all requests that are in cycles whose polls are exactly `usual`."""

    def pieces(self) -> list[Sequence[PollStart[P]]]:
        """The requests of each cycle whose polls are exactly `usual`, cycle by cycle."""
        found = (self.starts[begin:end] for begin, end in pairwise(self.cuts))
        return [one for one in found if tuple(start.poll for start in one) == self.usual]


def usual_cycles(starts: Sequence[PollStart[P]]) -> CutCycles[P] | None:
    """Cut the requests `starts`, which are in order of time, so that as many as possible are in
    equal cycles.

    All cuts are at one transition, that is wherever a certain poll follows a certain other poll.
    Returns None if no sequence repeats often enough to be a cycle.
    """
    places: defaultdict[tuple[P, P], list[int]] = defaultdict(list)
    for at, (before, start) in enumerate(pairwise(starts), 1):
        places[before.poll, start.poll].append(at)
    recurring = [one for one in places.items() if len(one[1]) >= MIN_CYCLES - 1]
    recurring.sort(key=lambda one: -len(one[1]))
    tried = [
        cycles
        for (_, poll), at in recurring[:_TRANSITIONS]
        if (cycles := _cut_cycles(starts, poll, at)) is not None
    ]
    if not tried:
        return None
    best = max(cycles.share for cycles in tried)
    tied = [cycles for cycles in tried if cycles.share >= best - _TIED]
    return _well_begun(min(tied, key=lambda one: (len(one.usual), -one.share)), places)


def _cut_cycles(starts: Sequence[PollStart[P]], first: P, places: list[int]) -> CutCycles[P] | None:
    """Cut the requests `starts` before each index in `places`; each cycle then begins with the poll
    `first`.

    Returns None if no sequence of polls repeats often enough to be a cycle.
    """
    cuts = [*places, len(starts)]
    if starts[0].poll == first:
        cuts.insert(0, 0)
    polls = [start.poll for start in starts]
    pieces = Counter(tuple(polls[begin:end]) for begin, end in pairwise(cuts))
    usual, count = max(pieces.items(), key=lambda one: (one[1] * len(one[0]), one[1]))
    if count < MIN_CYCLES or count * len(usual) < MIN_REQUESTS:
        return None
    # Add the requests before the first cut, and those after the last one, if they are a part of the
    # usual cycle.
    head = cuts[0] if tuple(polls[: cuts[0]]) == usual[-cuts[0] :] else 0
    last = tuple(polls[cuts[-2] :])
    tail = len(last) if len(last) < len(usual) and last == usual[: len(last)] else 0
    return CutCycles(starts, cuts, usual, (count * len(usual) + head + tail) / len(starts))


def _well_begun(cycles: CutCycles[P], places: Mapping[tuple[P, P], list[int]]) -> CutCycles[P]:
    """Return the same cycles, but cut so that each begins after its longest pause.

    If all pauses are about equal, each cycle begins with the poll of the very first request.
    `places` has the indices of all requests by transition: the poll before and the request's own
    poll.
    """
    usual, pauses = cycles.usual, step_pauses(cycles)
    first = pauses.index(max(pauses))
    if _is_one_pace(pauses, cycles):
        first = usual.index(cycles.starts[0].poll) if cycles.starts[0].poll in usual else 0
    begun = _cut_cycles(cycles.starts, usual[first], places[usual[first - 1], usual[first]])
    is_same = begun is not None and begun.usual == usual[first:] + usual[:first]
    return begun if begun is not None and is_same else cycles


def _step_ns(cycles: CutCycles[P]) -> float:
    """The mean time from the beginning of one request to that of the next, in ns."""
    starts = cycles.starts
    return (starts[-1].begin_ns - starts[0].begin_ns) / max(len(starts) - 1, 1)


def step_pauses(cycles: CutCycles[P]) -> list[float]:
    """For each step of the usual cycle, the median pause (ns) between the end of the transaction
    before it and the beginning of its request.
    """
    pauses = [after.begin_ns - before.end_ns for before, after in pairwise(cycles.starts)]
    usual = [begin for (begin, _), is_usual in _cycle_marks(cycles) if is_usual]
    found = []
    for step in range(len(cycles.usual)):
        # The pause before the first request of the capture is unknown.
        known = [pauses[begin + step - 1] for begin in usual if begin + step]
        found.append(median(known) if known else 0.0)
    return found


def _cycle_marks(cycles: CutCycles[P]) -> list[tuple[tuple[int, int], bool]]:
    """For each cycle, a pair: the indices in `cycles.starts` at which it begins and ends (the end
    not included), and True if its polls are exactly those of the usual cycle.
    """
    polls, usual = [one.poll for one in cycles.starts], [*cycles.usual]
    return [((begin, end), polls[begin:end] == usual) for begin, end in pairwise(cycles.cuts)]


def has_one_pace(cycles: CutCycles[P]) -> bool:
    """True if the pauses before all steps of the usual cycle are about equal. Then no timer starts
    the cycles; the master polls without a pause.
    """
    return _is_one_pace(step_pauses(cycles), cycles)


def _is_one_pace(pauses: Sequence[float], cycles: CutCycles[P]) -> bool:
    return max(pauses) - min(pauses) <= _SAME_PACE * _step_ns(cycles)


def cycle_times(cycles: CutCycles[P]) -> tuple[list[int], list[int]]:
    """The durations (ns) of the cycles that are exactly the usual one, from the beginning of the
    cycle to that of the next.

    Returns two lists: the durations of the cycles in which no answer is missing, and of those in
    which at least one is.
    """
    whole: list[int] = []
    missing: list[int] = []
    for (begin, end), is_usual in _cycle_marks(cycles):
        if is_usual and end < len(cycles.starts):
            time = cycles.starts[end].begin_ns - cycles.starts[begin].begin_ns
            is_missing = any(one.is_missing for one in cycles.starts[begin:end])
            (missing if is_missing else whole).append(time)
    return whole, missing


def number_of_other_cycles(cycles: CutCycles[P]) -> int:
    """The number of cycles that are not exactly the usual one. The last cycle is left out, as the
    capture may end before the cycle does.
    """
    return sum(not is_usual for _, is_usual in _cycle_marks(cycles)[:-1])


MOST = 0.9
"""If at least this share (0 to 1) of the requests is in equal cycles, the cycles are accepted, and
the polls are not grouped in another way."""
MIN_CYCLE_SHARE = 0.4
"""If the polls cannot be grouped, a cycle is taken as a polled list only if at least this share (0
to 1) of the requests is in equal cycles."""
_REGULAR = 0.2
"""The time from one request of a poll to the next is regular if it differs from the poll's median
period by at most this share of the median."""
_REGULAR_SHARE = 0.7
"""A poll is regular if at least this share (0 to 1) of its periods are. If two different periods
alternate, only half of them are, so the poll is not regular."""
_MAX_MEAN_TO_MEDIAN = 1.3
"""A poll is regular only if its mean period is at most this many times its median period. If a poll
comes several times in a cycle, close together, its median period is short, and this excludes it."""
_RETRY_WITHIN = 0.5
"""A request equal to an unanswered one before it is a retry if it begins at most this share of the
timeout after the master has stopped waiting. If it begins later, it belongs to the next cycle of a
list of one poll."""
_EQUAL_PERIODS = 1.08
"""Regular polls belong to one group if their periods differ by at most this factor."""
_DISTANCE_TOLERANCE = 0.1
"""A poll comes at even distances in a cycle if the times from one of its requests to the next
differ by at most this share of their mean."""
_LONG_PAUSE = 0.2
"""A pause in a cycle is long if it is longer than this share of the longest pause in the cycle, and
more than _LONGER_THAN_SHORT times as long as the shortest."""
_LONGER_THAN_SHORT = 4
"""A pause is long only if it is more than this many times the shortest pause in the cycle; see
_LONG_PAUSE."""
_CONSTANT_SHARE = 0.8
"""A poll without a regular period belongs to a list if it comes equally often in at least this
share (0 to 1) of the list's cycles."""
_SLACK_NS = 5_000_000
"""Pauses of a master that differ by less than this (ns) count as equal, as masters do not keep time
more exactly."""
_DURATION_TOLERANCE = 0.25
"""The duration of a cycle is near the median if it differs from it by at most this share of the
median."""


class Asked(NamedTuple, Generic[P]):
    """A request of the master: its poll, its begin and end (UTC ns), and True if its response is
    missing.
    """

    poll: P
    begin_ns: int
    end_ns: int
    """The time (UTC ns) of the end of the response; without a response, of the end of the
    request."""
    is_missing: bool
    """True if the slave had to respond and did not."""
    is_damaged: bool = False
    """True if the response counts as missing because it had a wrong CRC or LRC. Then the master may
    send its next request before its timeout has passed."""


@dataclass(frozen=True, slots=True)
class PollStep(Generic[P]):
    """One step of a polled list: a poll, the pause before it, and the time that the poll takes.
    Times are in ns.
    """

    poll: P
    pause_ns: int
    """The median time (ns) from the end of the previous step to the beginning of this one."""
    took_ns: int
    """The median time (ns) from the beginning of the request to the end of the response, retries
    included. If there is no response, it counts to when the master stopped waiting."""
    missing: int
    """The number of cycles in which the first attempt of this step got no response."""


@dataclass(frozen=True, slots=True)
class PollList(Generic[P]):
    """A sequence of requests that a master sends again and again, in cycles. Times are in ns."""

    steps: tuple[PollStep[P], ...]
    """The steps in the order in which the master sends them; the longest pause is before the first
    one."""
    cycles: int
    """The number of cycles that had exactly the steps of the list, in the order of the list."""
    other_cycles: int
    """The number of cycles that lacked a step of the list, had another one in addition, or had the
    steps in another order."""
    times: tuple[int, ...]
    """The durations (ns), sorted, of the cycles that had exactly the steps of the list; each counts
    from the beginning of the cycle to that of the next."""
    whole_ns: int | None
    """The median duration (ns) of the cycles in which no answer is missing; None if there are no
    such cycles."""
    missing_ns: int | None
    """The median duration (ns) of the cycles in which at least one answer is missing; None if there
    are no such cycles."""

    @property
    def period_ns(self) -> int:
        """The usual duration (ns) of a cycle: the mean of those durations in `times` that differ by
        at most 25 % from their median.
        """
        middle = median_low(self.times)
        near = [time for time in self.times if abs(time - middle) <= _DURATION_TOLERANCE * middle]
        return sum(near) // len(near)

    @property
    def polls(self) -> list[P]:
        return [step.poll for step in self.steps]

    @property
    def repeated(self) -> list[P]:
        """The polls that are sent more than once in a cycle."""
        return [poll for poll, count in Counter(self.polls).items() if count > 1]

    @property
    def missing_cost_ns(self) -> int | None:
        """The time (ns) by which a cycle is longer if an answer is missing: the difference of
        `missing_ns` and `whole_ns`, at least 0.

        None if one of the two is unknown.
        """
        if self.whole_ns is None or self.missing_ns is None:
            return None
        return max(self.missing_ns - self.whole_ns, 0)


@dataclass(frozen=True, slots=True)
class PollLists(Generic[P]):
    """The lists that a master polls in cycles, and the requests that it sends in between."""

    lists: tuple[PollList[P], ...]
    """The polled lists, the one with the shortest period first."""
    between: Mapping[P, int]
    """For each poll that is in no list, the number of its requests; retries are not counted."""
    timeout_ns: int | None
    """The estimated response timeout of the master (ns); None if the master never waited in
    vain."""


def find_lists(asked: Iterable[Asked[P]]) -> PollLists[P]:
    """Find the lists that one master polls in cycles on one link.

    `asked` are its requests, retries included, in any order.
    """
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
    """Estimate how long (ns) the master waits for a response; None if it never waited in vain.
    `in_order` are its requests in order of time.

    The estimate is the 10th percentile of the times from an unanswered request to the next request.
    Longer times may include a pause of the master; the shortest tenth is ignored as exceptional.
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
    was_missing = was_damaged = False
    for one in asked:
        is_waited_for = one.is_missing and not one.is_damaged
        end_ns = one.end_ns + (timeout_ns if is_waited_for else 0)
        # After a damaged response, a master repeats the request at once, or when the timeout is
        # over.
        soon_ns = (_RETRY_WITHIN + was_damaged) * timeout_ns
        is_soon = bool(starts) and one.begin_ns - starts[-1].end_ns <= soon_ns
        if was_missing and is_soon and starts[-1].poll == one.poll:
            starts[-1] = starts[-1]._replace(end_ns=end_ns)
        else:
            starts.append(PollStart(one.poll, one.begin_ns, end_ns, one.is_missing))
        was_missing, was_damaged = one.is_missing, one.is_damaged
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
    return _with_others(cycles) if cycles is not None and cycles.share >= MIN_CYCLE_SHARE else []


def _with_others(cycles: CutCycles[P]) -> list[PollList[P]]:
    """Return the polled list of the usual cycle in `cycles`, and lists of all polls that this cycle
    lacks.
    """
    if not _has_pace(cycles):
        return []
    others = {start.poll for start in cycles.starts} - set(cycles.usual)
    return [_poll_list(cycles), *_lists(_only(cycles.starts, others))]


def _faster_polls(cycles: CutCycles[P]) -> set[P]:
    """The polls that are sent several times in the usual cycle at even distances, so that they have
    a shorter period of their own.

    These polls form a second list. The set is empty if the cycle is a single list.
    """
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
    """Divide the polls of a cycle at its long pauses. `pauses[i]` is the pause (ns) before
    `usual[i]`.
    """
    least = max(_LONG_PAUSE * max(pauses), _LONGER_THAN_SHORT * max(min(pauses), 0))
    long = [at for at, pause in enumerate(pauses) if pause > least]
    if not long:
        return [usual]
    inner = [usual[begin:end] for begin, end in pairwise(long)]
    return [*inner, usual[long[-1] :] + usual[: long[0]]]


def _is_evenly_asked(cycles: CutCycles[P], poll: P) -> bool:
    """True if the times from one request of `poll` to its next are about equal."""
    times = [start.begin_ns for piece in cycles.pieces() for start in piece if start.poll == poll]
    by_place: list[list[int]] = [[] for _ in range(cycles.usual.count(poll))]
    for at, (one, other) in enumerate(pairwise(times)):
        by_place[at % len(by_place)].append(other - one)
    distances = [median(one) for one in by_place if one]
    mean = sum(distances) / len(distances)
    return max(distances) - min(distances) <= _DISTANCE_TOLERANCE * mean


def _groups(starts: Sequence[PollStart[P]]) -> list[set[P]]:
    """Return groups of polls: the polls of a group have regular periods that are equal.

    A poll without a regular period joins the group in whose cycles it comes equally often. Returns
    an empty list if no poll is regular, or if all polls would be in one group.
    """
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
    """The median time (ns) from one request of a poll to the next, if that is regular; None if not.
    `times` (ns) are the times of its requests.
    """
    periods = [other - one for one, other in pairwise(times)]
    if len(periods) < MIN_CYCLES - 1:
        return None
    usual = median(periods)
    near = [period for period in periods if abs(period - usual) <= _REGULAR * usual]
    is_regular = (
        usual > 0
        and len(near) >= _REGULAR_SHARE * len(periods)
        and sum(periods) <= _MAX_MEAN_TO_MEDIAN * usual * len(periods)
    )
    return usual if is_regular else None


def _is_constant(starts: Sequence[PollStart[P]], group: set[P], times: Sequence[int]) -> bool:
    """True if a poll comes equally often, at least once, in nearly every cycle of the polls in
    `group`.

    `times` (ns) are the times of the poll's requests; `starts` are the requests of all polls.
    """
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
    """The polls outside `group` that have no regular period of their own, but come equally often in
    nearly every cycle of the polls in `group`.
    """
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
    """False if the cycle is a single poll sent at irregular times, such as an operator's occasional
    write.
    """
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
    """The polls that are sent at least half as often as the median of all polls."""
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
