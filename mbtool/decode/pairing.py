"""Joins requests and responses into transactions."""

# On a network a response belongs to the oldest open request of its connection with the same
# transaction id, unit and function: masters may pipeline, slaves may answer out of order, and some
# masters always send id 0. Some slaves answer with an id of their own: a response whose id no open
# request has belongs to the only open request, if it can be its answer. Otherwise nobody asked.
#
# On a bus there is one open request. The next request ends it unanswered, whoever it is for.
#
# A request that goes unanswered is a transaction of its own, and the equal request after it says in
# `retries` how many went before. On a network the answer to the later one may come while the
# earlier one is still open; that is a retry too.
#
# Holds at most MAX_OPEN_REQUESTS requests, and as many counts of unanswered ones; beyond that the
# oldest of each is given up.

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.transactions import Ends, broadcast, no_answer, together, unsolicited
from mbtool.modbus.adu import Adu, Verdict
from mbtool.modbus.pdu import parse_pdu
from mbtool.modbus.request_match import is_response_code, is_response_to

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

BUS_TIMEOUT_NS = 5_000_000_000
NETWORK_TIMEOUT_NS = 60_000_000_000
"""Longer than any master waits, so that a late answer is still joined to its request."""


class Pairing:
    """`Adu` of one bus or one connection in, `Transaction` out, each when it is complete."""

    def __init__(self, ends: Ends, *, bus: bool) -> None:
        self._ends = ends
        self._bus = bus
        self._timeout_ns = BUS_TIMEOUT_NS if bus else NETWORK_TIMEOUT_NS
        self._open: deque[_OpenRequest] = deque()
        self._unanswered: dict[tuple[int, bytes], int] = {}
        """How many requests of a unit and a PDU stayed without an answer in a row."""

    def feed(self, adu: Adu) -> list[Transaction]:
        """Take the next ADU, in order of time."""
        done = self.advance(adu.start_ns) if self._open else []
        if adu.direction is not Direction.RESPONSE:
            self._ask(adu, done)
            return done
        place, verdicts = self._match(adu)
        if place is None:
            done.append(unsolicited(self._ends, adu))
            return done
        answered = self._open[place]
        del self._open[place]
        retries = self._retries(answered, place)
        done.append(together(self._ends, answered.adu, adu, retries, verdicts))
        return done

    def advance(self, now_ns: int) -> list[Transaction]:
        """Learn that no response came until now."""
        done: list[Transaction] = []
        while self._open and now_ns - self._open[0].adu.end_ns > self._timeout_ns:
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
            if self._open:
                done += self.close()
            if request.unit == 0:
                done.append(broadcast(self._ends, request))
                return
        elif len(self._open) >= MAX_OPEN_REQUESTS:
            self._give_up(done)
        self._open.append(_OpenRequest(request))

    def _match(self, response: Adu) -> tuple[int | None, tuple[Verdict, ...]]:
        """Which open request a response belongs to, and what is odd about it."""
        for place, one in enumerate(self._open):
            asked = one.adu
            if (
                asked.transaction_id == response.transaction_id
                and asked.unit == response.unit
                and is_response_code(asked.pdu[0], response.pdu[0])
            ):
                return place, ()
        if len(self._open) == 1:
            asked = self._open[0].adu
            if asked.unit == response.unit and is_response_to(
                parse_pdu(asked.pdu, Direction.REQUEST), response.pdu
            ):
                return 0, (Verdict.OTHER_TRANSACTION_ID,)
        return None, ()

    def _retries(self, answered: _OpenRequest, place: int) -> int:
        """How many equal requests without an answer an answered one ends."""
        retries = self._unanswered.pop(answered.key, 0) if self._unanswered else 0
        for one in islice(self._open, place):
            if one.counts and one.key == answered.key:
                one.counts = False
                retries += 1
        return retries

    def _give_up(self, done: list[Transaction]) -> None:
        given_up = self._open.popleft()
        retries = 0
        if given_up.counts:
            retries = self._unanswered.pop(given_up.key, 0)
            if len(self._unanswered) >= MAX_OPEN_REQUESTS:
                del self._unanswered[next(iter(self._unanswered))]
            self._unanswered[given_up.key] = retries + 1
        done.append(no_answer(self._ends, given_up.adu, retries))


class _OpenRequest(msgspec.Struct, gc=False):
    """A request that waits for its response."""

    adu: Adu
    counts: bool = True
    """Whether it counts as a retry of the equal request after it, should it stay unanswered."""

    @property
    def key(self) -> tuple[int, bytes]:
        return self.adu.unit, self.adu.pdu
