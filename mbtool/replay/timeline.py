"""Keeps how the registers or bits of one table changed during a recording."""

# A Timeline holds, for each address seen, the times in ns at which the value changed, and the
# values. The first known value counts from time 0. For each address that the recorded master wrote
# to, it also holds the times and values of the writes. Values must be added in the order of time.
# Lookups use binary search.

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

# TimeRange is the part of a recording that is played.


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A part of a recording: its beginning and end, in ns from the first request, or from the first
    byte of a recording played on a serial line. By default the whole recording.

    The end is not included, so that a request at the border of two ranges is only in the second.
    """

    start_ns: int = 0
    end_ns: int | None = None

    def __contains__(self, position_ns: int) -> bool:
        return self.start_ns <= position_ns and (self.end_ns is None or position_ns < self.end_ns)

    def __str__(self) -> str:
        start = f"from {self.start_ns / 1e9:g} s"
        return f"{start} on" if self.end_ns is None else f"{start} to {self.end_ns / 1e9:g} s"


class Timeline:
    """The values of one table of a slave, by address and time. Times are in UTC ns."""

    __slots__ = ("_history", "_writes")

    def __init__(self) -> None:
        self._history: dict[int, tuple[list[int], list[int]]] = {}
        """By address, two lists of equal length: the times (UTC ns) at which the value changed, and
        the new values. The first known value has the time 0."""
        self._writes: dict[int, tuple[list[int], list[int | None]]] = {}
        """By address, two lists of equal length: the times (UTC ns) of the writes, and the written
        values. None stands for a value that is unknown."""

    def note(self, at_ns: int, address: int, values: Sequence[int]) -> None:
        """Add the values of consecutive addresses, from `address` on, that were seen at `at_ns`
        (UTC ns).

        No call may have an earlier time than the call before.
        """
        for each, value in enumerate(values, start=address):
            times, known = self._history.setdefault(each, ([], []))
            if not known or known[-1] != value:
                times.append(at_ns if known else 0)
                known.append(value)

    def at(self, address: int, at_ns: int) -> tuple[int, int] | None:
        """Return the value that an address had at `at_ns`, and the time (UTC ns) since which it had
        it.

        None if the recording never shows a value of the address.
        """
        history = self._history.get(address)
        if history is None:
            return None
        times, known = history
        index = bisect_right(times, at_ns) - 1
        return known[index], times[index]

    def last(self, addresses: range) -> list[int] | None:
        """The last known values of `addresses`; None if the recording never shows a value of one of
        them.
        """
        if not all(address in self._history for address in addresses):
            return None
        return [self._history[address][1][-1] for address in addresses]

    def note_writes(self, at_ns: int, address: int, values: Sequence[int | None]) -> None:
        """Add an acknowledged write to consecutive addresses, from `address` on, at `at_ns` (UTC
        ns).

        A value is None if it is unknown. No call may have an earlier time than the call before.
        """
        for each, value in enumerate(values, start=address):
            times, written = self._writes.setdefault(each, ([], []))
            times.append(at_ns)
            written.append(value)

    def writes_until(self, address: int, at_ns: int) -> int:
        """The number of writes to an address up to and including `at_ns` (UTC ns)."""
        writes = self._writes.get(address)
        return 0 if writes is None else bisect_right(writes[0], at_ns)

    def last_write(self, address: int, at_ns: int) -> int | None:
        """The value that the last write up to `at_ns` (UTC ns) gave to an address; None if there
        was no write or its value is unknown.
        """
        count = self.writes_until(address, at_ns)
        return self._writes[address][1][count - 1] if count else None
