"""Counts the requests of a link that had no answer, as retries of a later equal request."""

# Memory: at most MAX_OPEN_REQUESTS counts; beyond that, the oldest one is forgotten.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.giving_up import request_key

if TYPE_CHECKING:
    from mbtool.modbus.adu import Adu


class UnansweredCounts(dict[tuple[int, bytes], int]):
    """Maps unit and PDU to the number of equal requests in a row that had no answer."""

    # This is a dict because every transaction tests whether it is empty; for a dict the test calls
    # no Python function.
    __slots__ = ()

    def add(self, request: Adu) -> int:
        """Count a request without an answer; return the number counted before with equal unit and
        PDU.
        """
        before = self.take(request)
        if len(self) >= MAX_OPEN_REQUESTS:
            del self[next(iter(self))]
        self[request_key(request)] = before + 1
        return before

    def take(self, request: Adu) -> int:
        """Return the number of unanswered requests equal to this one, and forget them."""
        return self.pop(request_key(request), 0)
