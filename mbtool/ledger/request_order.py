"""Sorts requests by time, as needed for periods of polls, retries and poll cycles."""

# A request without a response is reported only after its timeout, so after many requests that were
# sent later. So each request waits in a heap until WINDOW further requests have been added. A
# request that comes after a later one has left the heap is only counted, in `late`.
#
# Memory: WINDOW requests, and for each of at most MAX_TAPES masters its last requests.

from __future__ import annotations

from collections import OrderedDict
from heapq import heappop, heappush
from itertools import count, repeat
from operator import sub
from typing import TYPE_CHECKING, NamedTuple

from mbtool.ledger.master_tape import MasterTape, TapedRequest

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence, Set

    from mbtool.ledger.answered_run import AnsweredRun
    from mbtool.ledger.poll_statistics import PollStatistics

MAX_TAPES = 256
WINDOW = 2048


class _AskedColumns(NamedTuple):
    """Answered TCP requests in the order in which they were added, as three lists of equal length.

    The lists have the time of each request (UTC ns), its poll, and the time of its response (UTC
    ns).
    """

    at_ns: list[int]
    polls: list[PollStatistics]
    ends_ns: list[int]


class RequestOrder:
    """Sorts requests by time and passes each on to two places: the periods of its poll, and its
    master's tape (the list of the master's last requests).
    """

    def __init__(self, on_retry: Callable[[PollStatistics, int, int], None] | None) -> None:
        """`on_retry` is called with a poll, the time (UTC ns) of a retry, and 1; or with -1, if a
        request that was told as a retry turns out to be none. None if nobody asks for retries.
        """
        self._on_retry = on_retry
        self.tapes: OrderedDict[tuple[str, str], MasterTape] = OrderedDict()
        """The tape (the last requests) of each master; the key is the link and the master's
        host."""
        self.late = 0
        """The number of requests left out because a later request had already been passed on."""
        self._heap: list[TapedRequest] = []
        self._ordered_ns = 0
        """The time (UTC ns) of the last request that was passed on, in the order of time."""
        self._taken = 0

    def begin_capture(self) -> None:
        """Note that the next request belongs to another capture, whose times may be earlier."""
        self.settle()
        self._ordered_ns = 0
        for tape in self.tapes.values():
            tape.cut()

    def settle(self, before_ns: int | None = None) -> None:
        """Pass on the waiting requests in order of time: those before `before_ns` (UTC ns), or all
        of them if it is None.
        """
        while self._heap and (before_ns is None or self._heap[0].at_ns < before_ns):
            self._order(heappop(self._heap))

    def add(
        self,
        at_ns: int,
        poll: PollStatistics,
        end_ns: int,
        wire_ns: int,
        *,
        is_missing: bool,
        is_damaged: bool = False,
        is_late: bool = False,
    ) -> None:
        """Add a request; the arguments are the fields of the same names in TapedRequest (times in
        UTC ns).
        """
        self._taken += 1
        if at_ns < self._ordered_ns:
            self.late += 1
            return
        heappush(
            self._heap,
            TapedRequest(
                at_ns, self._taken, poll, end_ns, is_missing, wire_ns, is_damaged, is_late
            ),
        )
        if len(self._heap) > WINDOW:
            self._order(heappop(self._heap))

    def add_run(self, run: AnsweredRun, polls: Sequence[PollStatistics]) -> None:
        """Add a batch of answered TCP requests; `polls[i]` is the poll of the group `run.kinds[i]`.

        The result is the same as if `add` was called for each request, but it takes less time.
        """
        if len(run.kind) < WINDOW // 4:  # For few requests, sorting the heap takes longer.
            self._add_each(run, polls)
            return
        held = sorted(self._heap)
        asked = _AskedColumns(
            [one.at_ns for one in held] + run.request_ns,
            [one.poll for one in held] + [polls[kind] for kind in run.kind],
            [one.end_ns for one in held] + run.response_ns,
        )
        order = sorted(range(len(asked.at_ns)), key=asked.at_ns.__getitem__)
        # The greatest number of positions by which a request stands later in `asked` than in order
        # of time.
        behind = max(map(sub, order, count()))
        is_simple = (
            len(order) > WINDOW >= behind
            and asked.at_ns[order[0]] >= self._ordered_ns
            and not any(one.is_missing or one.wire_ns for one in held)
            and self._can_tape_all({(poll.key.link, poll.key.master) for poll in {*asked.polls}})
        )
        if not is_simple:
            self._add_each(run, polls)
            return
        last = order[-WINDOW:]
        self._heap = list(
            map(
                TapedRequest,
                map(asked.at_ns.__getitem__, last),
                map(self._taken.__add__, last),
                map(asked.polls.__getitem__, last),
                map(asked.ends_ns.__getitem__, last),
                repeat(False),
                repeat(0),
            )
        )
        self._taken += len(order)
        self._order_all(asked, order[:-WINDOW])

    def _add_each(self, run: AnsweredRun, polls: Sequence[PollStatistics]) -> None:
        for at_ns, kind, end_ns in zip(run.request_ns, run.kind, run.response_ns, strict=True):
            self.add(at_ns, polls[kind], end_ns, 0, is_missing=False)

    def _order_all(self, asked: _AskedColumns, order: list[int]) -> None:
        """Pass on answered requests, with the same result as if `_order` was called for each.

        `order` has the indices in `asked` of the requests to pass on, in order of time.
        """
        by_poll: dict[PollStatistics, list[int]] = {poll: [] for poll in dict.fromkeys(asked.polls)}
        by_tape: dict[tuple[str, str], list[int]] = {}
        notes = {
            poll: (
                times.append,
                by_tape.setdefault((poll.key.link, poll.key.master), []).append,
            )
            for poll, times in by_poll.items()
        }
        at_ns, polls = asked.at_ns, asked.polls
        for one in order:
            note_time, note_place = notes[polls[one]]
            note_time(at_ns[one])
            note_place(one)
        self._ordered_ns = at_ns[order[-1]]
        for poll, times in by_poll.items():
            if times:
                poll.begin_all(times)
        # Masters come in the order of their last requests, because `_tape` moves each to the end of
        # `tapes`.
        used = [(at_ns[last[-1]], last[-1], key) for key, last in by_tape.items() if last]
        for _, _, key in sorted(used):
            places = by_tape[key]
            self._tape(*key).add_answered(
                list(map(at_ns.__getitem__, places)),
                list(map(polls.__getitem__, places)),
                list(map(asked.ends_ns.__getitem__, places)),
            )

    def _can_tape_all(self, keys: Set[tuple[str, str]]) -> bool:
        """True if the requests of several masters may be passed on as a batch.

        That is so if the tapes stay below MAX_TAPES, and if no master's last request is unanswered,
        so that no request of the batch can be a retry. A key is a pair of link and master's host.
        """
        known = [self.tapes[key] for key in keys if key in self.tapes]
        if len(self.tapes) + len(keys) - len(known) > MAX_TAPES:
            return False
        return not any(tape.is_waiting for tape in known)

    def _order(self, one: TapedRequest) -> None:
        self._ordered_ns = one.at_ns
        poll = one.poll
        if not self._tape(poll.key.link, poll.key.master).add(one):
            poll.begin(one.at_ns)
            return
        change = poll.begin_again(one.at_ns)
        if self._on_retry is not None:
            for at_ns in change.found:
                self._on_retry(poll, at_ns, 1)
            for at_ns in change.withdrawn:
                self._on_retry(poll, at_ns, -1)

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
