"""Joins requests and responses into transactions."""

# On a network a response belongs to the oldest open request of its connection with the same
# transaction id, unit and function: masters may pipeline, slaves may answer out of order, and some
# masters always send id 0. A response whose id no open request has belongs to the only open request
# of its unit and function, if there is just one; otherwise nobody asked for it.
#
# On a bus there is one open request. The next request ends it unanswered, whoever it is for.
#
# A request that goes unanswered is a transaction of its own, and the equal request after it says in
# `retries` how many went before.
#
# Holds at most MAX_OPEN requests, and as many counts of unanswered ones; beyond that the oldest
# request is given up as unanswered.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.adu import Adu, Verdict
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.modbus.joining import Ends, broadcast, no_answer, together, unsolicited

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

MAX_OPEN = 256
BUS_TIMEOUT_NS = 5_000_000_000
NETWORK_TIMEOUT_NS = 60_000_000_000
"""Longer than any master waits, so that a late answer is still joined to its request."""


class Pairing:
    """`Adu` of one bus or one connection in, `Transaction` out, each when it is complete."""

    def __init__(self, ends: Ends, *, bus: bool) -> None:
        self._ends = ends
        self._bus = bus
        self._timeout_ns = BUS_TIMEOUT_NS if bus else NETWORK_TIMEOUT_NS
        self._open: deque[Adu] = deque()
        self._unanswered: dict[tuple[int, bytes], int] = {}

    def feed(self, adu: Adu) -> list[Transaction]:
        """Take the next ADU, in order of time."""
        done = self.advance(adu.start_ns)
        if adu.direction is not Direction.RESPONSE:
            self._ask(adu, done)
            return done
        request, verdicts = self._match(adu)
        if request is None:
            done.append(unsolicited(self._ends, adu))
            return done
        self._open.remove(request)
        retries = self._unanswered.pop((request.unit, request.pdu), 0)
        done.append(together(self._ends, request, adu, retries, verdicts))
        return done

    def advance(self, now_ns: int) -> list[Transaction]:
        """Learn that no response came until now."""
        done: list[Transaction] = []
        while self._open and now_ns - self._open[0].end_ns > self._timeout_ns:
            self._give_up(done)
        return done

    def close(self) -> list[Transaction]:
        """The link ends; open requests stay unanswered."""
        done: list[Transaction] = []
        while self._open:
            self._give_up(done)
        return done

    def _ask(self, request: Adu, done: list[Transaction]) -> None:
        if self._bus:
            done += self.close()
            if request.unit == 0:
                done.append(broadcast(self._ends, request))
                return
        elif len(self._open) >= MAX_OPEN:
            self._give_up(done)
        self._open.append(request)

    def _match(self, response: Adu) -> tuple[Adu | None, tuple[Verdict, ...]]:
        function = response.pdu[0] & ~EXCEPTION_BIT if response.pdu else None
        same = [
            request
            for request in self._open
            if request.unit == response.unit and request.pdu[:1] == bytes([function or 0])
        ]
        for request in same:
            if request.transaction_id == response.transaction_id:
                return request, ()
        if len(same) == 1 and len(self._open) == 1:
            return same[0], (Verdict.OTHER_TRANSACTION_ID,)
        return None, ()

    def _give_up(self, done: list[Transaction]) -> None:
        request = self._open.popleft()
        key = (request.unit, request.pdu)
        retries = self._unanswered.pop(key, 0)
        if len(self._unanswered) >= MAX_OPEN:
            del self._unanswered[next(iter(self._unanswered))]
        self._unanswered[key] = retries + 1
        done.append(no_answer(self._ends, request, retries))
