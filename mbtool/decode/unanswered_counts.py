"""Counts the requests of a link that had no answer, as retries of a later equal request."""

# Memory: at most MAX_OPEN_REQUESTS counts; beyond that, the oldest one is forgotten.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.giving_up import request_key

if TYPE_CHECKING:
    from mbtool.modbus.adu import Adu


class UnansweredCounts:
    """By unit and PDU, the number of requests in a row that had no answer."""

    __slots__ = ("_counts",)

    def __init__(self) -> None:
        self._counts: dict[tuple[int, bytes], int] = {}

    def __len__(self) -> int:
        return len(self._counts)

    def add(self, request: Adu) -> int:
        """Count a request without an answer; return the number of equal ones before it."""
        before = self.take(request)
        if len(self._counts) >= MAX_OPEN_REQUESTS:
            del self._counts[next(iter(self._counts))]
        self._counts[request_key(request)] = before + 1
        return before

    def take(self, request: Adu) -> int:
        """Forget the number of requests equal to this one, and return it."""
        return self._counts.pop(request_key(request), 0)
