"""Puts requests in the order of their times, for periods, poll cycles and hours."""

# A transaction without answer may come long after later ones. So requests wait in a heap until
# WINDOW later ones have come; what comes later still is `late`, and left out.
#
# Memory: WINDOW requests, and MAX_TAPES masters with their last requests.

from __future__ import annotations

from collections import OrderedDict
from heapq import heappop, heappush
from itertools import count, repeat
from operator import itemgetter, sub
from typing import TYPE_CHECKING

from mbtool.overview.master_tape import MasterTape, TapedRequest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence, Set

    from mbtool.overview.answered_run import AnsweredRun
    from mbtool.overview.link_statistics import LinkStatistics
    from mbtool.overview.poll_statistics import PollStatistics

MAX_TAPES = 256
WINDOW = 2048

_NUMBER, _IS_MISSING = itemgetter(1), itemgetter(4)


class RequestOrder:
    """Tells links, polls and tapes of requests in the order of their times."""

    def __init__(self, links: Mapping[str, LinkStatistics]) -> None:
        self._links = links
        self.tapes: OrderedDict[tuple[str, str], MasterTape] = OrderedDict()
        """The last requests of each master, by link and the master's host."""
        self.late = 0
        """The number of transactions that came too late to be put in order."""
        self._heap: list[TapedRequest] = []
        self._ordered_ns = 0
        """The time of the last request that was put in order."""
        self._taken = 0

    def begin_capture(self) -> None:
        """Note that the next request is of another capture, which may be of another day."""
        self.settle()
        self._ordered_ns = 0
        for tape in self.tapes.values():
            tape.cut()

    def settle(self, before_ns: int | None = None) -> None:
        """Put the waiting transactions in order: all, or those whose request came before a time."""
        while self._heap and (before_ns is None or self._heap[0].at_ns < before_ns):
            self._order(heappop(self._heap))

    def add(
        self, at_ns: int, poll: PollStatistics, end_ns: int, wire_ns: int, *, is_missing: bool
    ) -> None:
        """Take a request, as TapedRequest has it."""
        self._taken += 1
        if at_ns < self._ordered_ns:
            self.late += 1
            return
        heappush(self._heap, TapedRequest(at_ns, self._taken, poll, end_ns, is_missing, wire_ns))
        if len(self._heap) > WINDOW:
            self._order(heappop(self._heap))

    def add_run(self, run: AnsweredRun, polls: Sequence[PollStatistics]) -> None:
        """Take the requests of a run on a network; `polls` are those of its kinds."""
        arrived = zip(
            run.request_ns,
            count(self._taken + 1),
            map(polls.__getitem__, run.kind),
            run.response_ns,
            repeat(False),
            repeat(0),
        )
        taken = [*self._heap, *map(TapedRequest._make, arrived)]
        waiting = sorted(taken)
        held, first = len(self._heap), self._taken + 1
        # Where each request is among all that are sorted, against when it came.
        behind = max(map(sub, map(_NUMBER, waiting), count())) + held - first
        if waiting[0].at_ns < self._ordered_ns or behind > WINDOW or len(waiting) <= WINDOW:
            for one in taken[held:]:
                self.add(one.at_ns, one.poll, one.end_ns, 0, is_missing=False)
            return
        self._taken += len(run)
        self._heap = waiting[-WINDOW:]
        self._order_all(waiting[:-WINDOW])

    def _order_all(self, asked: list[TapedRequest]) -> None:
        """Take requests in order of time, with the same result as one by one."""
        by_poll: dict[PollStatistics, tuple[list[int], list[TapedRequest]]] = {}
        by_tape: dict[tuple[str, str], list[TapedRequest]] = {}
        for one in asked:
            lists = by_poll.get(one.poll)
            if lists is None:
                key = one.poll.key
                lists = [], by_tape.setdefault((key.link, key.master), [])
                by_poll[one.poll] = lists
            lists[0].append(one.at_ns)
            lists[1].append(one)
        if any(map(_IS_MISSING, asked)) or not self._can_tape_all(by_tape.keys()):
            for one in asked:
                self._order(one)
            return
        self._ordered_ns = asked[-1].at_ns
        by_link: dict[str, list[int]] = {}
        for poll, (times, _) in by_poll.items():
            poll.begin_all(times)
            by_link.setdefault(poll.key.link, []).extend(times)
        for link, times in by_link.items():
            self._links[link].hours.add_answered(times)
        # The tape that was used last comes last.
        for (link, master), some in sorted(by_tape.items(), key=lambda item: item[1][-1]):
            self._tape(link, master).add_answered(some)

    def _can_tape_all(self, keys: Set[tuple[str, str]]) -> bool:
        """True if no tape is given up for these, and none of them waits for an answer."""
        known = [self.tapes[key] for key in keys if key in self.tapes]
        if len(self.tapes) + len(keys) - len(known) > MAX_TAPES:
            return False
        return not any(tape.is_waiting for tape in known)

    def _order(self, one: TapedRequest) -> None:
        self._ordered_ns = one.at_ns
        poll = one.poll
        link, master = poll.key.link, poll.key.master
        self._links[link].hours.add(one.at_ns, is_missing=one.is_missing)
        if self._tape(link, master).add(one):
            poll.repetitions += 1
        else:
            poll.begin(one.at_ns)

    def _tape(self, link: str, master: str) -> MasterTape:
        key = link, master
        tape = self.tapes.get(key)
        if tape is None:
            if len(self.tapes) >= MAX_TAPES:
                self.tapes.popitem(last=False)
            tape = self.tapes[key] = MasterTape()
        else:
            self.tapes.move_to_end(key)
        return tape
