"""Keeps how the registers or bits of one table changed during a recording."""

# A Timeline holds, for each address seen, the times in ns at which the value changed, and the
# values. The first known value counts from time 0. For each address that the recorded master wrote
# to, it also holds the times and values of the writes. Values must be added in the order of time.
# Lookups use binary search.

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


class Timeline:
    """The values of one table of a slave, by address and time."""

    __slots__ = ("_history", "_writes")

    def __init__(self) -> None:
        self._history: dict[int, tuple[list[int], list[int]]] = {}
        """By address, the times in ns at which its value changed, and the value from each of them
        on."""
        self._writes: dict[int, tuple[list[int], list[int | None]]] = {}
        """By address, the times in ns of the writes, and the written values; None if unknown."""

    def note(self, at_ns: int, address: int, values: Sequence[int]) -> None:
        """Add the values of consecutive addresses, from `address` on, that were seen at `at_ns`.

        No call may have an earlier time than the call before it.
        """
        for each, value in enumerate(values, start=address):
            times, known = self._history.setdefault(each, ([], []))
            if not known or known[-1] != value:
                times.append(at_ns if known else 0)
                known.append(value)

    def at(self, address: int, at_ns: int) -> tuple[int, int] | None:
        """The value of an address at a time, and the time in ns since which it has it; None if
        never seen.
        """
        history = self._history.get(address)
        if history is None:
            return None
        times, known = history
        index = bisect_right(times, at_ns) - 1
        return known[index], times[index]

    def last(self, addresses: range) -> list[int] | None:
        """The values of addresses at the end of the timeline; None if one of them was never
        seen.
        """
        if not all(address in self._history for address in addresses):
            return None
        return [self._history[address][1][-1] for address in addresses]

    def note_writes(self, at_ns: int, address: int, values: Sequence[int | None]) -> None:
        """Add an acknowledged write to consecutive addresses; a value is None if unknown.

        No call may have an earlier time than the call before it.
        """
        for each, value in enumerate(values, start=address):
            times, written = self._writes.setdefault(each, ([], []))
            times.append(at_ns)
            written.append(value)

    def writes_until(self, address: int, at_ns: int) -> int:
        """The number of writes to an address up to a time in ns, inclusive."""
        writes = self._writes.get(address)
        return 0 if writes is None else bisect_right(writes[0], at_ns)

    def last_write(self, address: int, at_ns: int) -> int | None:
        """The value of the last write up to a time; None if there was no write."""
        count = self.writes_until(address, at_ns)
        return self._writes[address][1][count - 1] if count else None
