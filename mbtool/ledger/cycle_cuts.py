"""Cuts the requests of a master into poll cycles, by finding the sequence that repeats."""

# poll_cycle.py uses this module and explains the method.
#
# Memory: a few copies of the list of requests that the caller passes.

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

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
    """True if the first attempt got no answer. If the last attempt got none either, `end_ns` is the
    time when the master stopped waiting."""


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
        if (cycles := _cut(starts, poll, at)) is not None
    ]
    if not tried:
        return None
    best = max(cycles.share for cycles in tried)
    tied = [cycles for cycles in tried if cycles.share >= best - _TIED]
    return _well_begun(min(tied, key=lambda one: (len(one.usual), -one.share)), places)


def _cut(starts: Sequence[PollStart[P]], first: P, places: list[int]) -> CutCycles[P] | None:
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
    begun = _cut(cycles.starts, usual[first], places[usual[first - 1], usual[first]])
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
    usual = [begin for (begin, _), is_usual in _marked(cycles) if is_usual]
    found = []
    for step in range(len(cycles.usual)):
        # The pause before the first request of the capture is unknown.
        known = [pauses[begin + step - 1] for begin in usual if begin + step]
        found.append(median(known) if known else 0.0)
    return found


def _marked(cycles: CutCycles[P]) -> list[tuple[tuple[int, int], bool]]:
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
    for (begin, end), is_usual in _marked(cycles):
        if is_usual and end < len(cycles.starts):
            time = cycles.starts[end].begin_ns - cycles.starts[begin].begin_ns
            is_missing = any(one.is_missing for one in cycles.starts[begin:end])
            (missing if is_missing else whole).append(time)
    return whole, missing


def number_of_other_cycles(cycles: CutCycles[P]) -> int:
    """The number of cycles that are not exactly the usual one. The last cycle is left out, as the
    capture may end before the cycle does.
    """
    return sum(not is_usual for _, is_usual in _marked(cycles)[:-1])
