"""Keeps the last requests of one master on one link, to rebuild its poll cycle."""

# Memory: the last MAX_ASKED requests.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from mbtool.overview.poll_cycle import Asked, PollLists, find_lists, response_timeout

if TYPE_CHECKING:
    from mbtool.overview.poll_statistics import PollStatistics

MAX_ASKED = 2048
"""The number of requests kept: enough for three cycles of a list of 680 polls."""


class MasterTape:
    """The last requests of one master on one link. They are put in order of time."""

    def __init__(self) -> None:
        self._asked: deque[Asked[PollStatistics]] = deque(maxlen=MAX_ASKED)
        self._last: Asked[PollStatistics] | None = None

    def add(self, asked: Asked[PollStatistics]) -> bool:
        """Take the next request; True if it repeats the last request, which had no answer."""
        last, self._last = self._last, asked
        self._asked.append(asked)
        return last is not None and last.is_missing and last.poll is asked.poll

    def cut(self) -> None:
        """Forget what was asked: another capture begins."""
        self._asked.clear()
        self._last = None

    def __len__(self) -> int:
        return len(self._asked)

    def lists(self) -> PollLists[PollStatistics]:
        return find_lists(self._asked)

    def timeout_ns(self) -> int | None:
        """How long (ns) the master waits for an answer; None if no answer is missing."""
        return response_timeout(sorted(self._asked, key=lambda one: one.begin_ns))
