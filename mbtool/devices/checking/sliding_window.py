"""Counts the cases of a rule that come close together: at least a number of cases within a time."""

# A limit says how many cases must come within how much time. A window is any span of time of at
# most that length, its ends included. It is full if it contains at least that number of cases. The
# times of cases may be slightly out of order, because a request without a response is decoded late.
#
# Memory: the times and packets of the last cases, fewer than KEPT x the limit's number.

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.devices.checking.security_limits import SecurityLimit

KEPT = 4


class SlidingWindow:
    """Counts the cases of a rule that lie in a full window.

    A window is a span of time as long as the limit says. It is full if it contains at least the
    limit's number of cases.
    """

    __slots__ = ("_counted_to_ns", "_limit", "_packets", "_times", "first_ns")

    def __init__(self, limit: SecurityLimit) -> None:
        self._limit = limit
        self._times: list[int] = []
        """The times of the last cases, in ns, sorted."""
        self._packets: list[tuple[int, ...]] = []
        """The packets of the last cases, in the order in which they came."""
        self._counted_to_ns: int | None = None
        """The time of the last case that was counted, in ns; None if none was."""
        self.first_ns: int | None = None
        """The time (ns) of the first case in the first full window; None if no window was full
        yet."""

    def last_packets(self, count: int) -> list[tuple[int, ...]]:
        """Return the packets of the last `count` cases, as far as they are kept."""
        return self._packets[-count:]

    def add(self, at_ns: int, packets: tuple[int, ...] = ()) -> int:
        """Add a case at the time `at_ns`, and return the number of cases that are counted for the
        first time now. `packets` are those of the request and its response.

        A case is counted if it is in a full window: one of at least the limit's number of cases
        within the limit's time.
        """
        times, number = self._times, self._limit.number
        self._packets.append(packets)
        place = bisect_right(times, at_ns)
        times.insert(place, at_ns)
        begin = self._full_window(place)
        if begin is None:
            counted = 0
        else:
            counted = self._count(begin)
            if self.first_ns is None:
                self.first_ns = times[begin]
        if len(times) >= KEPT * number:
            del times[: -(KEPT // 2) * number]
        if len(self._packets) >= KEPT * number:
            del self._packets[: -(KEPT // 2) * number]
        return counted

    def _full_window(self, place: int) -> int | None:
        """Find a full window with the case at the index `place` in `_times`.

        Returns the index of the window's first case; None if there is no such window.
        """
        times, number, window_ns = self._times, self._limit.number, self._limit.window_ns
        for begin in range(max(0, place - number + 1), min(place, len(times) - number) + 1):
            if times[begin + number - 1] - times[begin] <= window_ns:
                return begin
        return None

    def _count(self, begin: int) -> int:
        """Count the cases of a full window that begins at the index `begin` in `_times`.

        Returns the number of those that were not counted before.
        """
        times, known_ns = self._times, self._counted_to_ns
        end = begin + self._limit.number
        if known_ns is None:
            new = self._limit.number
        elif times[end - 1] <= known_ns:
            return 1  # A late case, between cases already counted.
        else:
            new = end - bisect_right(times, known_ns, begin, end)
        self._counted_to_ns = times[end - 1]
        return new
