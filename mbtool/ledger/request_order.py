"""Sorts requests by time, as needed for periods of polls, retries and poll cycles."""

# A request without a response is reported only after its timeout, so after many requests that were
# sent later. So requests wait until there are 2 * WINDOW of them; then the WINDOW earliest ones are
# passed on. A request that comes too late, when a later one was already passed on, is only counted
# in `late`.
#
# Memory: 2 * WINDOW requests, and for each of at most MAX_TAPES masters its last requests.

from __future__ import annotations

from bisect import bisect_left
from collections import OrderedDict
from itertools import count, repeat
from operator import itemgetter, sub
from typing import TYPE_CHECKING

from mbtool.ledger.master_tape import MAX_ASKED, Lacks, MasterTape
from mbtool.ledger.poll_statistics import PollStatistics

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence, Set

    from mbtool.ledger.master_tape import TapedPoll, TapedRequest

MAX_TAPES = 256
"""The last requests of at most this many masters are kept."""
WINDOW = 2048
"""Requests wait until there are twice this many; then this many, the earliest ones, are passed on
in the order of time."""
_AT_NS = itemgetter(0)


class RequestOrder:
    """Sorts requests by time and passes each on to two places: the periods of its poll, and its
    master's tape (the list of the master's last requests).
    """

    def __init__(self, on_retry: Callable[[PollStatistics, int, int], None] | None) -> None:
        """`on_retry` is called with a poll, the time (UTC ns) of a retry, and 1; or with -1, if a
        request that was reported as a retry turns out to be no retry. None if nobody asks for
        retries.
        """
        self._on_retry = on_retry
        self.tapes: OrderedDict[tuple[str, str], MasterTape] = OrderedDict()
        """The tape (the last requests) of each master; the key is the link and the master's
        host."""
        self.late = 0
        """The number of requests left out because a later request had already been passed on."""
        self._waiting: list[TapedRequest] = []
        self._ordered_ns = 0
        """The time (UTC ns) of the last request that was passed on, in the order of time."""

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
        self._waiting.sort(key=_AT_NS)
        if before_ns is None:
            self._pass_on(len(self._waiting))
        else:
            self._pass_on(bisect_left(self._waiting, before_ns, key=_AT_NS))

    def add(self, one: TapedRequest) -> None:
        self._waiting.append(one)
        if len(self._waiting) >= 2 * WINDOW:
            self._pass_on(WINDOW)

    def add_answered(self, at_ns: list[int], polls: list[TapedPoll], ends_ns: list[int]) -> None:
        """Add answered requests of a network: their times, polls, and the times of their responses
        (UTC ns). The result is the same as if `add` was called for each.
        """
        held = self._waiting
        if len(held) + len(at_ns) < 2 * WINDOW:  # No request is passed on yet.
            held += zip(at_ns, polls, ends_ns, repeat(0), repeat(Lacks.NOTHING))
            return
        at = [one[0] for one in held] + at_ns
        of_poll = [one[1] for one in held] + polls
        ends = [one[2] for one in held] + ends_ns
        number = (len(at) // WINDOW - 1) * WINDOW
        order = sorted(range(len(at)), key=at.__getitem__)
        keys = {poll.tape_key for poll in {*of_poll}}
        if number <= 0 or not self._is_simple(keys, order, at[order[0]]):
            for one in zip(at_ns, polls, ends_ns, repeat(0), repeat(Lacks.NOTHING)):
                self.add(one)
            return

        of_polls: dict[TapedPoll, list[int]] = {poll: [] for poll in {*of_poll}}
        for place in order[:number]:
            of_polls[of_poll[place]].append(place)
        places: dict[tuple[str, str], list[int]] = {key: [] for key in keys}
        for poll, some in of_polls.items():
            places[poll.tape_key] += some
            if isinstance(poll, PollStatistics) and some:
                poll.begin_all([at[place] for place in some])
        for some in places.values():
            some.sort(key=at.__getitem__)
        used = [(at[some[-1]], some[-1], key) for key, some in places.items() if some]
        for _, _, key in sorted(used):
            last = places[key][-MAX_ASKED:]
            self._tape(key).add_answered(
                [at[place] for place in last],
                [of_poll[place] for place in last],
                [ends[place] for place in last],
            )
        self._ordered_ns = at[order[number - 1]]
        self._waiting = [
            (at[place], of_poll[place], ends[place], 0, Lacks.NOTHING) for place in order[number:]
        ]

    def _is_simple(self, keys: Set[tuple[str, str]], order: Sequence[int], first_ns: int) -> bool:
        """True if answered requests can be passed on at once.

        That is so if none of them comes after more than WINDOW later ones, or is late; if there is
        room for the tapes of all their masters, `keys`; and if no request before them lacks its
        response. `order` has their places in order of time, and `first_ns` is the first time.
        """
        return (
            first_ns >= self._ordered_ns
            and max(map(sub, order, count())) <= WINDOW
            and len(keys | self.tapes.keys()) <= MAX_TAPES
            and not any(one[-1] or one[-2] for one in self._waiting)
            and not any(tape.unanswered for key, tape in self.tapes.items() if key in keys)
        )

    def _pass_on(self, number: int) -> None:
        """Pass on the `number` earliest requests."""
        self._waiting.sort(key=_AT_NS)
        late = bisect_left(self._waiting, self._ordered_ns, 0, number, key=_AT_NS)
        self.late += late
        by_tape: dict[tuple[str, str], list[TapedRequest]] = {}
        for one in self._waiting[late:number]:
            by_tape.setdefault(one[1].tape_key, []).append(one)
        if by_tape:
            self._ordered_ns = self._waiting[number - 1][0]
        del self._waiting[:number]
        # Take the tapes in the order of their last requests, because the oldest one is removed at
        # the limit.
        for key, asked in sorted(by_tape.items(), key=_last_of_tape):
            tape = self._tape(key)
            unanswered = tape.unanswered
            tape.add(asked)
            if unanswered is not None or any(one[-1] for one in asked):
                self._begin_each(unanswered, asked)
            else:
                _begin_all(asked)

    def _begin_each(self, unanswered: TapedPoll | None, asked: Sequence[TapedRequest]) -> None:
        """Note the requests of a master with their polls. A request may be a retry if it repeats
        the one before it, which got no response; `unanswered` is the poll of the one before the
        first.
        """
        for at_ns, poll, _, _, lacks in asked:
            if not isinstance(poll, PollStatistics):
                pass  # Periods and retries need a poll that is kept.
            elif poll is not unanswered:
                poll.begin(at_ns)
            else:
                change = poll.note_repetition(at_ns)
                if self._on_retry is not None:
                    for found_ns in change.found:
                        self._on_retry(poll, found_ns, 1)
                    for withdrawn_ns in change.withdrawn:
                        self._on_retry(poll, withdrawn_ns, -1)
            unanswered = poll if lacks else None

    def _tape(self, key: tuple[str, str]) -> MasterTape:
        tape = self.tapes.get(key)
        if tape is None:
            if len(self.tapes) >= MAX_TAPES:
                self.tapes.popitem(last=False)
            tape = self.tapes[key] = MasterTape()
        else:
            self.tapes.move_to_end(key)
        return tape


def _last_of_tape(item: tuple[tuple[str, str], Sequence[TapedRequest]]) -> int:
    """The time of the last request of a tape."""
    return item[1][-1][0]


def _begin_all(asked: Sequence[TapedRequest]) -> None:
    """Note answered requests of a master with their polls."""
    by_poll: dict[PollStatistics, list[int]] = {}
    for at_ns, poll, *_ in asked:
        if isinstance(poll, PollStatistics):
            by_poll.setdefault(poll, []).append(at_ns)
    for poll, times_ns in by_poll.items():
        poll.begin_all(times_ns)
