"""Keeps the transactions before and after the longest pauses of each poll, for the report's table.

A poll is all equal requests of one master. Only at the end of the capture it is known which of its
pauses are reported (troubles/polling.py).
"""

# Memory: the last transaction of each of at most MAX_POLLS polls, and two transactions for each of
# the LONGEST longest pauses of a poll.

from __future__ import annotations

from heapq import heappush, heappushpop
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.moments import host_of
from mbtool.ledger.account import MAX_POLLS
from mbtool.ledger.poll_statistics import LONGEST, PollKey, poll_key
from mbtool.troubles.polling import PAUSE_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from mbtool.devices import NamedTransaction
    from mbtool.ledger.answered_run import AnsweredRun

_NEVER_NS = 1 << 63
"""A time (UTC ns) after all others, so that no pause begins with it."""


class _Asked(NamedTuple):
    number: int
    """The number of the transaction in the capture, from 1."""
    one: NamedTransaction


class _Pause(NamedTuple):
    ns: int
    order: int
    """The number of the transaction before the pause, times -1: of equal pauses the first ones are
    kept."""
    before: _Asked
    after: _Asked


class BesidePauses:
    """Collects the transactions beside pauses of at least PAUSE_NS (ns)."""

    def __init__(self) -> None:
        self._last: dict[PollKey, _Asked] = {}
        self._pauses: dict[PollKey, list[_Pause]] = {}
        """For each poll a heap: the shortest pause first."""

    def begin_capture(self) -> None:
        """Note that the next transaction belongs to another capture; the time between is no
        pause.
        """
        self._last.clear()

    def note(self, key: PollKey, number: int, one: NamedTransaction) -> None:
        """Take the next transaction, of the poll `key`; `number` is its number in the capture."""
        last = self._last.get(key)
        asked = _Asked(number, one)
        if last is not None:
            pause_ns = one.start_ns - last.one.start_ns
            if pause_ns < 0:
                return  # It has no response, so it was decoded late.
            if self._is_long(key, pause_ns):
                self._add(key, last, asked)
        self._set_last(key, asked)

    def note_run(
        self,
        run: AnsweredRun,
        number: int,
        transactions_at: Callable[[list[int]], Iterable[NamedTransaction]],
    ) -> None:
        """Take a batch of transactions, before which `number` were taken.

        `transactions_at` returns those with these indices in the batch.
        """
        slots: dict[PollKey, int] = {}
        likes = (kind.like for kind in run.kinds)
        keys = (poll_key(like, host_of(like.source)) for like in likes)
        slot_of = [slots.setdefault(key, len(slots)) for key in keys]
        asked = [self._last.get(key) for key in slots]
        last_ns = [_NEVER_NS if one is None else one.one.start_ns for one in asked]
        last_places = [-1] * len(slots)
        beside: list[tuple[int, int, int, int]] = []
        for place, (kind, at_ns) in enumerate(zip(run.kind, run.request_ns, strict=True)):
            slot = slot_of[kind]
            if at_ns - last_ns[slot] >= PAUSE_NS:
                beside.append((slot, at_ns - last_ns[slot], last_places[slot], place))
            last_ns[slot] = at_ns
            last_places[slot] = place

        def asked_at(*places: int) -> list[_Asked]:
            made = zip(places, transactions_at([*places]), strict=True)
            return [_Asked(number + place + 1, one) for place, one in made]

        of_slot = list(slots)
        for slot, pause_ns, before, after in beside:
            if self._is_long(of_slot[slot], pause_ns):
                last = asked[slot] if before < 0 else asked_at(before)[0]
                if last is not None:
                    self._add(of_slot[slot], last, *asked_at(after))
        for key, one in zip(of_slot, asked_at(*last_places), strict=True):
            self._set_last(key, one)

    def beside(self, begins_ns: Collection[int]) -> dict[int, NamedTransaction]:
        """Return the transactions before and after the pauses that begin at these times (UTC ns),
        by their numbers.
        """
        return {
            asked.number: asked.one
            for pauses in self._pauses.values()
            for pause in pauses
            if pause.before.one.start_ns in begins_ns
            for asked in (pause.before, pause.after)
        }

    def _is_long(self, key: PollKey, pause_ns: int) -> bool:
        """True if a pause is one of the longest of the poll so far."""
        if pause_ns < PAUSE_NS:
            return False
        heap = self._pauses.get(key)
        if heap is None:
            return len(self._pauses) < MAX_POLLS
        return len(heap) < LONGEST or pause_ns > heap[0].ns

    def _set_last(self, key: PollKey, asked: _Asked) -> None:
        if len(self._last) == MAX_POLLS and key not in self._last:
            self._last.pop(next(iter(self._last)))
        self._last[key] = asked

    def _add(self, key: PollKey, before: _Asked, after: _Asked) -> None:
        pause = _Pause(after.one.start_ns - before.one.start_ns, -before.number, before, after)
        heap = self._pauses.setdefault(key, [])
        if len(heap) < LONGEST:
            heappush(heap, pause)
        else:
            heappushpop(heap, pause)
