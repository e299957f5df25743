"""Pairs requests with their responses and makes transactions of them."""

# On a TCP connection a response belongs to the oldest open request with the same transaction id,
# unit and function: masters may send several requests at once, slaves may respond out of order, and
# some masters always send id 0. Some slaves send an id of their own: if no open request matches and
# only one is open, the response belongs to that one, provided that unit and content fit. All other
# responses are unsolicited.
#
# On a serial line one request is open at a time. The next request ends it without an answer,
# whichever unit it is for.
#
# A request without an answer is a transaction of its own. The next equal request counts in
# `retries` how many went before it. On a TCP connection the response to a later request may come
# while an equal earlier one is still open; that one counts as well.
#
# Limits: MAX_OPEN_REQUESTS open requests, and as many counts of unanswered ones; beyond that the
# oldest of each is given up.

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.transactions import Ends, broadcast, no_answer, unsolicited, with_response
from mbtool.modbus.adu import Adu, Verdict
from mbtool.modbus.pdu import parse_pdu
from mbtool.modbus.request_match import is_response_code, is_response_to

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

BUS_TIMEOUT_NS = 5_000_000_000
NETWORK_TIMEOUT_NS = 60_000_000_000
"""Longer than any master waits, so that a late response is still paired with its request."""


class Pairing:
    """Takes the ADUs of one serial line or one connection, returns complete transactions."""

    def __init__(self, ends: Ends, *, bus: bool) -> None:
        """`bus` is True for a serial line, False for a TCP connection."""
        self._ends = ends
        self._bus = bus
        self._timeout_ns = BUS_TIMEOUT_NS if bus else NETWORK_TIMEOUT_NS
        self._open: deque[_OpenRequest] = deque()
        self._unanswered: dict[tuple[int, bytes], int] = {}
        """By unit and PDU, how many requests in a row had no answer."""

    def feed(self, adu: Adu) -> list[Transaction]:
        """Take the next ADU, in order of time."""
        done = self.advance(adu.start_ns) if self._open else []
        if adu.direction is not Direction.RESPONSE:
            self._add_request(adu, done)
            return done
        index, verdicts = self._match(adu)
        if index is None:
            done.append(unsolicited(self._ends, adu))
            return done
        answered = self._open[index]
        del self._open[index]
        retries = self._take_retries(answered, index)
        done.append(with_response(self._ends, answered.adu, adu, retries, verdicts))
        return done

    def advance(self, now_ns: int) -> list[Transaction]:
        """Give up requests that have waited longer than the timeout; return their transactions."""
        done: list[Transaction] = []
        while self._open and now_ns - self._open[0].adu.end_ns > self._timeout_ns:
            self._give_up(done)
        return done

    def close(self) -> list[Transaction]:
        """End the link: open requests stay without an answer."""
        done: list[Transaction] = []
        while self._open:
            self._give_up(done)
        return done

    def _add_request(self, request: Adu, done: list[Transaction]) -> None:
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
        """The index of the open request that a response belongs to, or None, and verdicts."""
        for index, candidate in enumerate(self._open):
            request = candidate.adu
            if (
                request.transaction_id == response.transaction_id
                and request.unit == response.unit
                and is_response_code(request.pdu[0], response.pdu[0])
            ):
                return index, ()
        if len(self._open) == 1:
            request = self._open[0].adu
            if request.unit == response.unit and is_response_to(
                parse_pdu(request.pdu, Direction.REQUEST), response.pdu
            ):
                return 0, (Verdict.OTHER_TRANSACTION_ID,)
        return None, ()

    def _take_retries(self, answered: _OpenRequest, index: int) -> int:
        """Count the equal requests before an answered one; each counts only once."""
        retries = self._unanswered.pop(answered.key, 0) if self._unanswered else 0
        for earlier in islice(self._open, index):
            if earlier.counts and earlier.key == answered.key:
                earlier.counts = False
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
    """A request whose response has not arrived."""

    adu: Adu
    counts: bool = True
    """False if a later equal request has already counted this one in its `retries`."""

    @property
    def key(self) -> tuple[int, bytes]:
        return self.adu.unit, self.adu.pdu
