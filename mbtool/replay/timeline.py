"""What the registers or bits of one table held at each moment of a recording."""

# For each address that was ever seen: the moments at which its value became another, and the
# values. The first known value counts as held from the beginning, moment 0. A lookup is a
# bisection. Observations come in the order of their time.

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


class Timeline:
    """The values of one table, by address and moment."""

    __slots__ = ("_history",)

    def __init__(self) -> None:
        self._history: dict[int, tuple[list[int], list[int]]] = {}
        """By address: when its value changed, and to what."""

    def note(self, at_ns: int, address: int, values: Sequence[int]) -> None:
        """Values were seen, or written, at a moment that is not before the last noted one."""
        for place, value in enumerate(values, start=address):
            moments, known = self._history.setdefault(place, ([], []))
            if not known or known[-1] != value:
                moments.append(at_ns if known else 0)
                known.append(value)

    def at(self, address: int, moment_ns: int) -> tuple[int, int] | None:
        """The value at a moment and when it became so; None for an address never seen."""
        history = self._history.get(address)
        if history is None:
            return None
        moments, known = history
        place = bisect_right(moments, moment_ns) - 1
        return known[place], moments[place]

    def last(self, addresses: range) -> list[int] | None:
        """The values noted last, or None where an address was never seen."""
        if not all(address in self._history for address in addresses):
            return None
        return [self._history[address][1][-1] for address in addresses]
