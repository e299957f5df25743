"""Keeps the slowest answers of each unit until a report knows which of them were late."""

# An answer is late if it takes many times the median of its unit (troubles/polling.py). The median
# is known only at the end, so until then the longest answers of LATE_NS and more are kept.
#
# Memory: OF_UNIT transactions for each of MAX_UNITS units.

from __future__ import annotations

from collections.abc import Callable, Mapping
from heapq import heappush, heapreplace
from typing import TYPE_CHECKING

from mbtool.troubles.polling import LATE_NS

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.ledger.unit_account import UnitKey

OF_UNIT = 100
MAX_UNITS = 50


class LateAnswers:
    """Collects answered transactions that may turn out to be late."""

    def __init__(self) -> None:
        self._units: dict[UnitKey, list[tuple[int, int, NamedTransaction]]] = {}
        """For each unit a heap of latency (ns), number * -1 and transaction: the least first."""

    def offer(
        self, row: UnitKey, latency_ns: int, number: int, make: Callable[[], NamedTransaction]
    ) -> None:
        """Keep a transaction of the unit `row` if it is one of the slowest of its unit.

        `number` is its number in the capture, from 1; numbers rise. `make` returns the transaction,
        and is called only if it is kept.
        """
        if latency_ns < LATE_NS:
            return
        heap = self._units.get(row)
        if heap is None:
            if len(self._units) == MAX_UNITS:
                return
            heap = self._units[row] = []
        if len(heap) < OF_UNIT:
            heappush(heap, (latency_ns, -number, make()))
        elif latency_ns > heap[0][0]:
            heapreplace(heap, (latency_ns, -number, make()))

    def late(self, limits: Mapping[UnitKey, int]) -> list[tuple[int, NamedTransaction]]:
        """Return the late ones with their numbers, sorted by number. `limits` has the latency (ns)
        from which an answer of a unit is late; a unit that it lacks has no late answers.
        """
        found = [
            (-number, one)
            for row, heap in self._units.items()
            for latency_ns, number, one in heap
            if row in limits and latency_ns >= limits[row]
        ]
        return sorted(found, key=lambda item: item[0])
