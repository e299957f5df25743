"""Keeps the last requests of one master on one link, to rebuild its poll cycle."""

# Memory: the last MAX_ASKED requests.

from __future__ import annotations

from collections import deque
from itertools import repeat
from typing import TYPE_CHECKING, NamedTuple

from mbtool.overview.poll_cycle import Asked, PollLists, find_lists

if TYPE_CHECKING:
    from mbtool.overview.poll_statistics import PollStatistics

MAX_ASKED = 2048
"""The number of requests kept: enough for three cycles of a list of 680 polls."""


class TapedRequest(NamedTuple):
    """A request of a poll. Sorts by its time, then by its number."""

    at_ns: int
    """The end of the request, in UTC ns."""
    number: int
    """Transactions are numbered as they are completed."""
    poll: PollStatistics
    end_ns: int
    """When the response was complete; when the request was, if there is none."""
    is_missing: bool
    """True if the slave should have answered and did not."""
    wire_ns: int
    """How long the request took on a serial line; 0 on a network."""
    is_damaged: bool = False
    """True if the answer is missing because it came with a wrong CRC or LRC."""


class MasterTape:
    """The last requests of one master on one link. They are put in order of time."""

    def __init__(self) -> None:
        self._asked: deque[TapedRequest] = deque(maxlen=MAX_ASKED)
        self._last: TapedRequest | None = None
        self._later: deque[tuple[list[int], list[PollStatistics], list[int]]] = deque()
        """Requests after those in `_asked`, all answered: their times, polls and ends."""

    def add(self, asked: TapedRequest) -> bool:
        """Take the next request; True if it repeats the last request, which had no answer."""
        self._join()
        last, self._last = self._last, asked
        self._asked.append(asked)
        return last is not None and last.is_missing and last.poll is asked.poll

    def add_answered(
        self, at_ns: list[int], polls: list[PollStatistics], ends_ns: list[int]
    ) -> None:
        """Take the next requests of a network, which were answered, as was the last one."""
        self._later.append((at_ns, polls, ends_ns))
        self._last = TapedRequest(at_ns[-1], 0, polls[-1], ends_ns[-1], False, 0)
        while sum(len(one[0]) for one in self._later) - len(self._later[0][0]) >= MAX_ASKED:
            self._later.popleft()

    def _join(self) -> None:
        for at_ns, polls, ends_ns in self._later:
            some = slice(-MAX_ASKED, None)  # Those before them would be given up again.
            self._asked.extend(
                map(
                    TapedRequest,
                    at_ns[some],
                    repeat(0),
                    polls[some],
                    ends_ns[some],
                    repeat(False),
                    repeat(0),
                )
            )
        self._later.clear()

    @property
    def is_waiting(self) -> bool:
        """True if the last request got no answer, so that the next one may repeat it."""
        return self._last is not None and self._last.is_missing

    def cut(self) -> None:
        """Forget what was asked: another capture begins."""
        self._asked.clear()
        self._later.clear()
        self._last = None

    def __len__(self) -> int:
        return min(len(self._asked) + sum(len(at_ns) for at_ns, _, _ in self._later), MAX_ASKED)

    def lists(self) -> PollLists[PollStatistics]:
        return find_lists(self._requests())

    def _requests(self) -> list[Asked[PollStatistics]]:
        asked = [
            Asked(one.poll, one.at_ns - one.wire_ns, one.end_ns, one.is_missing, one.is_damaged)
            for one in self._asked
        ]
        for at_ns, polls, ends_ns in self._later:
            asked += map(Asked, polls, at_ns, ends_ns, repeat(False))
        return asked[-MAX_ASKED:]
