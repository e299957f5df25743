"""Remembers requests dropped at the limit of pending requests, to recognise their responses."""

# A slave answers requests of one transaction id and unit in their order, and dropped requests are
# older than the pending ones. So the next response with the id and unit of a dropped request
# belongs to that request.
#
# Memory: MAX_DROPPED pairs of transaction id and unit; beyond that, the oldest pair is forgotten.
# All pairs are forgotten when FORGET_NS have passed since a request was dropped.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.modbus.adu import Adu

MAX_DROPPED = 1 << 16
"""The counts of at most this many pairs of transaction id and unit are kept; beyond it, the oldest
is forgotten."""
FORGET_NS = 60_000_000_000
"""All counts are forgotten if a response comes more than this time (ns) after the last dropped
request: slaves respond sooner."""

_Key = tuple[int | None, int]


class DroppedRequests:
    """Counts dropped requests by transaction id and unit."""

    def __init__(self) -> None:
        self._counts: dict[_Key, int] = {}
        self._last_ns: int
        """The time at which the last request was dropped, in ns; set with the first dropped
        request."""

    @property
    def is_empty(self) -> bool:
        return not self._counts

    def note(self, request: Adu, now_ns: int) -> None:
        """Remember a request that is dropped at the time `now_ns`."""
        key = (request.transaction_id, request.unit)
        if key not in self._counts and len(self._counts) >= MAX_DROPPED:
            del self._counts[next(iter(self._counts))]
        self._counts[key] = self._counts.get(key, 0) + 1
        self._last_ns = now_ns

    def take_response(self, response: Adu) -> bool:
        """True if a response belongs to a dropped request; that request is then forgotten."""
        if not self._counts:
            return False
        if response.start_ns - self._last_ns > FORGET_NS:
            self._counts.clear()
            return False
        key = (response.transaction_id, response.unit)
        count = self._counts.pop(key, 0)
        if count > 1:
            self._counts[key] = count - 1
        return count > 0
