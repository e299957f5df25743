"""Counts the cases of a rule that come close together: at least a number of cases within a time."""

# A limit says how many cases must come within how much time. A window is any span of time of at
# most that length, its ends included. It is full if it contains at least that number of cases. The
# times of cases may be slightly out of order, because a request without a response is decoded late.
#
# Memory: the times and packets of the last cases, fewer than KEPT_RATIO x the limit's number.

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator
from itertools import islice
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import PollName, QuietRun, Stay
    from mbtool.devices.checking.security_limits import SecurityLimit

# LruDict is a dictionary of bounded size for the state of many connections, units or requests.

K = TypeVar("K", bound="Hashable")
V = TypeVar("V")

MAX_ENTRIES = 4096


class LruDict(Generic[K, V]):
    """A dictionary that makes an entry for a missing key with `make`.

    When it has `limit` entries, it removes the least recently used one for each new one.
    """

    def __init__(self, make: Callable[[], V], limit: int = MAX_ENTRIES) -> None:
        self._make = make
        self._limit = limit
        self._entries: OrderedDict[K, V] = OrderedDict()

    def __getitem__(self, key: K) -> V:
        value = self._entries.get(key)
        if value is None:
            if len(self._entries) >= self._limit:
                self.pop_oldest()
            value = self._entries[key] = self._make()
        else:
            self._entries.move_to_end(key)
        return value

    def use(self: LruDict[PollName, V], run: QuietRun) -> Iterator[tuple[V, Stay]]:
        """Use the names of the polls of a run as keys, in turn, as `[]` does. Yields the entries
        that are left of those used, with their stays in the run.
        """
        stays = run.stays(self._entries, self._limit, few=len(run))
        for name in (*stays.dropped, *(stay.name for stay in stays.ended)):
            del self._entries[name]
        for stay in stays.left:
            yield self[stay.name], stay

    def get(self, key: K) -> V | None:
        """Return the value of a key; None if there is none.

        Unlike `[]`, it makes no entry, and does not make the entry a recently used one.
        """
        return self._entries.get(key)

    def has_room(self, keys: Iterable[K]) -> bool:
        """True if entries for all these keys fit without removing another entry."""
        new = {key for key in keys if key not in self._entries}
        return len(self._entries) + len(new) <= self._limit

    def would_keep(self, keys: Collection[K]) -> bool:
        """True if no entry of these keys that is there can be removed while all of them are used,
        in any order and each several times.
        """
        room = self._limit - len(self._entries)
        known = {key for key in keys if key in self._entries}
        if len(keys) - len(known) <= room or not known:
            return len(keys) <= self._limit
        newest = {*islice(reversed(self._entries), max(self._limit - len(keys), 0))}
        return known <= newest

    def __contains__(self, key: K) -> bool:
        return key in self._entries

    def __len__(self) -> int:
        return len(self._entries)

    def pop(self, key: K) -> V | None:
        return self._entries.pop(key, None)

    def pop_oldest(self) -> V:
        """Remove the least recently used entry and return its value. There must be one."""
        return self._entries.popitem(last=False)[1]

    def items(self) -> Iterator[tuple[K, V]]:
        yield from self._entries.items()

    def values(self) -> Iterator[V]:
        yield from self._entries.values()

    def clear(self) -> None:
        self._entries.clear()


KEPT_RATIO = 4
"""Fewer cases than this many times the limit's number are kept; beyond it, half of them are
dropped."""


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
        if len(times) >= KEPT_RATIO * number:
            del times[: -(KEPT_RATIO // 2) * number]
        if len(self._packets) >= KEPT_RATIO * number:
            del self._packets[: -(KEPT_RATIO // 2) * number]
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
