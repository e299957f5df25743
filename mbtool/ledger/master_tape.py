"""Keeps the last requests of one master on one link, to rebuild its poll cycle."""

# Memory: the last MAX_ASKED requests of the master.

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import IntEnum
from itertools import repeat
from typing import TYPE_CHECKING, cast

from mbtool.ledger.poll_cycle import Asked, PollLists, find_lists
from mbtool.ledger.poll_statistics import PollStatistics

if TYPE_CHECKING:
    from mbtool.ledger.unit_account import UseAccount

    TapedPoll = PollStatistics | UseAccount
    """The poll of a request; its use, if the poll came and went with so few requests that it
    belongs to no cycle."""
    TapedRequest = tuple[int, TapedPoll, int, int, int]
    """A request: its time (UTC ns, of its last byte), its poll, the time of the response's last
    byte (without a response in time, of the request's), the time (ns) that the bytes of the request
    took on a serial line (0 on a network), and an item of Lacks. A plain tuple, as there are
    many."""

MAX_ASKED = 2048
"""The number of requests kept for each master: enough for three cycles of a list of 680 polls."""


class Lacks(IntEnum):
    """The fault of the response to a request: none, no response, or a wrong check."""

    NOTHING = 0
    RESPONSE = 1
    """The slave had to respond and did not, or late."""
    CHECK = 2
    """The response had a wrong CRC or LRC."""


class MasterTape:
    """The last requests of one master on one link. The caller adds them in order of time."""

    def __init__(self) -> None:
        # The fields of TapedRequest: columns of integers cost the garbage collector nothing.
        self._at_ns: deque[int] = deque(maxlen=MAX_ASKED)
        self._polls: deque[TapedPoll] = deque(maxlen=MAX_ASKED)
        self._ends_ns: deque[int] = deque(maxlen=MAX_ASKED)
        self._wires_ns: deque[int] = deque(maxlen=MAX_ASKED)
        self._lacks: deque[int] = deque(maxlen=MAX_ASKED)
        self._columns = self._at_ns, self._polls, self._ends_ns, self._wires_ns, self._lacks

    def add(self, asked: Sequence[TapedRequest]) -> None:
        for one in asked[-MAX_ASKED:]:
            self._at_ns.append(one[0])
            self._polls.append(one[1])
            self._ends_ns.append(one[2])
            self._wires_ns.append(one[3])
            self._lacks.append(one[4])

    def add_answered(
        self, at_ns: Sequence[int], polls: Sequence[TapedPoll], ends_ns: Sequence[int]
    ) -> None:
        """Add answered requests of a network: their times, polls, and times of the responses."""
        self._at_ns.extend(at_ns)
        self._polls.extend(polls)
        self._ends_ns.extend(ends_ns)
        for column in (self._wires_ns, self._lacks):
            column.extend(repeat(0, len(at_ns)))

    @property
    def unanswered(self) -> TapedPoll | None:
        """The poll of the last request if it got no response, so that the next one may be its
        retry.
        """
        return self._polls[-1] if self._lacks and self._lacks[-1] else None

    def cut(self) -> None:
        """Forget all requests, because a new capture begins, which does not continue the poll
        cycles of the last one.
        """
        for column in self._columns:
            column.clear()

    def __len__(self) -> int:
        return len(self._at_ns)

    def lists(self) -> PollLists[PollStatistics]:
        """Return the lists that the master polls in cycles."""
        # A use stands for polls of its function that belong to no list: each for another one.
        polls = (
            cast("PollStatistics", poll if isinstance(poll, PollStatistics) else object())
            for poll in self._polls
        )
        columns = zip(self._at_ns, polls, self._ends_ns, self._wires_ns, self._lacks, strict=True)
        return find_lists(
            [
                Asked(poll, at_ns - wire_ns, end_ns, lacks > 0, lacks == Lacks.CHECK)
                for at_ns, poll, end_ns, wire_ns, lacks in columns
            ]
        )
