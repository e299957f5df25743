"""Keeps the last requests of one master on one link, to rebuild its poll cycle."""

# Memory: the last MAX_ASKED requests of the master.

from __future__ import annotations

from collections import deque
from itertools import repeat
from typing import TYPE_CHECKING, NamedTuple

from mbtool.ledger.poll_cycle import Asked, PollLists, find_lists

if TYPE_CHECKING:
    from mbtool.ledger.poll_statistics import PollStatistics

MAX_ASKED = 2048
"""The number of requests kept for each master: enough for three cycles of a list of 680 polls."""


class TapedRequest(NamedTuple):
    """A request, and the poll that it belongs to. Requests compare by time, and at equal times by
    number.
    """

    at_ns: int
    """The time (UTC ns) of the request's last byte."""
    number: int
    """The number of the transaction, in the order in which transactions were completed. It
    is 0 if the request was added to the tape in a batch."""
    poll: PollStatistics
    end_ns: int
    """The time (UTC ns) of the response's last byte; without a response, of the request's last
    byte."""
    is_missing: bool
    """True if the slave had to respond and did not, or late, or only with a wrong CRC or LRC."""
    wire_ns: int
    """The time (ns) that the bytes of the request took on a serial line; 0 on a network."""
    is_damaged: bool = False
    """True if `is_missing` is True because the response had a wrong CRC or LRC."""
    is_late: bool = False
    """True if `is_missing` is True because the response was late; `end_ns` is the request's."""


class MasterTape:
    """The last requests of one master on one link. The caller adds them in order of time."""

    def __init__(self) -> None:
        self._asked: deque[TapedRequest] = deque(maxlen=MAX_ASKED)
        self._last: TapedRequest | None = None
        self._later: deque[tuple[list[int], list[PollStatistics], list[int]]] = deque()
        """Batches of answered requests that came after the requests in `_asked`.

        Each batch has three lists of equal length: the times of the requests (UTC ns), their polls,
        and the times of the responses (UTC ns)."""

    def add(self, asked: TapedRequest) -> bool:
        """Add the next request. Returns True if it is a retry: the request before it is equal and
        got no response.
        """
        self._join()
        last, self._last = self._last, asked
        self._asked.append(asked)
        return last is not None and last.is_missing and last.poll is asked.poll

    def add_answered(
        self, at_ns: list[int], polls: list[PollStatistics], ends_ns: list[int]
    ) -> None:
        """Add answered requests of a network, in order of time; call it only if `is_waiting` is
        False.

        The lists have one element for each request: its time, its poll, and the time of its
        response (times in UTC ns).
        """
        self._later.append((at_ns, polls, ends_ns))
        self._last = TapedRequest(at_ns[-1], 0, polls[-1], ends_ns[-1], False, 0)
        while sum(len(one[0]) for one in self._later) - len(self._later[0][0]) >= MAX_ASKED:
            self._later.popleft()

    def _join(self) -> None:
        for at_ns, polls, ends_ns in self._later:
            some = slice(-MAX_ASKED, None)  # `_asked` would drop all earlier ones at once.
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
        """True if the last request got no response, so that the next one may be its retry."""
        return self._last is not None and self._last.is_missing

    def cut(self) -> None:
        """Forget all requests, because a new capture begins, which does not continue the poll
        cycles of the last one.
        """
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
