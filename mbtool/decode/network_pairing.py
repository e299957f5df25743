"""Joins the requests and responses of one TCP connection into transactions, by evidence."""

# A response can belong to an open request with the same transaction id, unit and function. Masters
# may pipeline, slaves may respond out of order, and many masters always send the same id. So if
# several open requests are possible, these decide, the surest first:
#
#     acknowledgements   a response is sent after its request was received: its segment acknowledges
#                        the request. A request that acknowledges the response was sent after it.
#     what the capture   Bytes of responses that the capture lacks (a gap, or an acknowledgement of
#     lacks              bytes that are not in the capture) belong to open requests, the oldest
#                        first as far as their sizes add up. Bytes of requests likewise: the next
#                        response may belong to a request that the capture lacks.
#     form               the number of values and what the response repeats of its request
#     the master         If it never sends a request while another one waits, it gives a request up
#     and time           before it sends the next: it is given up if the master waited longer than
#                        the slowest response so far took, or LATE times as long until that is
#                        known. Of the requests that are not given up the oldest gets the response,
#                        unless that would be sooner than this slave ever responded.
#
# A request that was given up stays open for the timeout, because its response may be late. It gets
# a response only if no other request can get it and no request is missing from the capture.
#
# A slave may respond with another id than the request's. Such a response belongs to the only open
# request if it fits, and if either no bytes are missing and this slave never repeated an id
# correctly, or acknowledgements show that nothing came between the two.
#
# Memory: at most MAX_OPEN_REQUESTS open requests, and as many counts of unanswered requests. A
# request beyond that is dropped with the verdict over-limit; nothing is said of its response.

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.stream_progress import AduPlace
from mbtool.decode.transactions import (
    Ends,
    no_answer,
    response_not_captured,
    unsolicited,
    with_response,
)
from mbtool.modbus.adu import Adu, Transport, Verdict
from mbtool.modbus.expected_response import UNKNOWN_SIZE, ExpectedResponse
from mbtool.modbus.pdu import parse_pdu
from mbtool.modbus.request_match import is_response_code, is_response_to
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

TIMEOUT_NS = 60_000_000_000
"""Longer than any master waits, so that a late response is still paired with its request."""
LATE = 3
"""A master that waited this many times the slowest response has given up the request."""
MIN_LATE_NS = 30_000_000
FIRST_LATE_NS = 100_000_000
"""The same before the first response: no master times out sooner than this by default."""
ENOUGH_OVERLAPS = 3
"""So many responses while a further request waits show that the master pipelines."""
ENOUGH_REQUESTS = 8
"""So many requests in a row without another one waiting show that the master never pipelines."""

MAX_LOST_RESPONSES = 8
"""Responses that lost bytes are divided into at most; this bounds the combinations of lengths."""

_EXCEPTION_PDU = 2
_USUAL_REQUEST = 12
"""Bytes of the ADU of a read: lost bytes of requests are counted as so many reads."""
_ADDED_BYTES = {Transport.TCP: 7, Transport.RTU_TCP: 3}
"""Bytes of an ADU beside its PDU."""


class NetworkPairing:
    """Takes the ADUs of one connection in order, returns complete transactions."""

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self._open: deque[_OpenRequest] = deque()
        self._unanswered: dict[tuple[int, bytes], int] = {}
        """By unit and PDU, how many requests in a row had no answer."""
        self._slowest_ns: int | None = None
        """The longest time that a response took; None before the first one."""
        self._fastest_ns = TIMEOUT_NS
        """The shortest time that a response took."""
        self._in_a_row = 0
        """How many requests came while no other one waited."""
        self._is_sequential = False
        """True once ENOUGH_REQUESTS came in a row, and the master was never seen to pipeline."""
        self._pipelines = False
        """True once two requests waited at the same time and both got their responses."""
        self._overlaps = 0
        """How many responses came while a further request waited."""
        self._last_id: int | None = None
        self._ids_vary = False
        """True once two requests in a row had different ids."""
        self._ids_count_up = False
        """True if ids vary, and each was greater than the one before it (modulo 2^16)."""
        self._has_matching_ids = False
        """True once a response had the id of its request, and ids vary."""
        self._lost_requests = 0
        """Requests that the capture lacks, at least, whose responses may still come."""
        self._over_limit = 0
        """Requests that were dropped and whose responses may still come."""

    def feed(self, adu: Adu, place: AduPlace | None = None) -> list[Transaction]:
        """Take the next ADU, in order of time."""
        done = self.advance(adu.start_ns) if self._open else []
        if adu.direction is not Direction.RESPONSE:
            self._add_request(adu, place, done)
        else:
            done.append(self._respond(adu, place))
        return done

    def note_loss(self, direction: Direction, lost: int) -> list[Transaction]:
        """Note that the capture lacks `lost` bytes of one direction here; 0 if nobody knows.

        Returns the requests whose responses were among them.
        """
        if direction is Direction.REQUEST:
            if not self._pipelines:
                for one in self._open:
                    one.is_given_up = True
            likely = max(lost // _USUAL_REQUEST, 1)
            self._lost_requests = min(self._lost_requests + likely, MAX_OPEN_REQUESTS)
            return []
        waiting = [one for one in self._open if not one.is_given_up]
        for count in range(1, min(len(waiting), MAX_LOST_RESPONSES) + 1):
            if lost in _sums(waiting[:count]):
                for one in waiting[:count]:
                    self._open.remove(one)
                return [response_not_captured(self._ends, one.adu) for one in waiting[:count]]
        for one in waiting:
            one.may_be_lost = True
            one.counts = False
            one.is_given_up = one.is_given_up or not self._pipelines
        return []

    def advance(self, now_ns: int) -> list[Transaction]:
        """Give up requests that have waited longer than the timeout; return their transactions."""
        done: list[Transaction] = []
        while self._open and now_ns - self._open[0].adu.end_ns > TIMEOUT_NS:
            done.append(self._without_response())
        return done

    def close(self) -> list[Transaction]:
        """End the connection: open requests stay without an answer."""
        return [self._without_response() for _ in range(len(self._open))]

    def _add_request(self, request: Adu, place: AduPlace | None, done: list[Transaction]) -> None:
        if len(self._open) >= MAX_OPEN_REQUESTS:
            self._over_limit += 1
            dropped = self._open.popleft()
            done.append(response_not_captured(self._ends, dropped.adu, (Verdict.OVER_LIMIT,)))
        waiting = [one for one in self._open if not one.is_given_up]
        self._in_a_row = 0 if waiting else self._in_a_row + 1
        if waiting and not self._pipelines:
            for one in waiting:
                waited_ns = request.start_ns - one.adu.end_ns
                one.is_given_up = waited_ns > self._late_ns
        self._is_sequential = self._is_sequential or self._in_a_row >= ENOUGH_REQUESTS
        self._note_id(request.transaction_id)
        self._open.append(_OpenRequest(request, place, is_after_loss=self._lost_requests > 0))

    @property
    def _late_ns(self) -> int:
        """A master that waited longer than this has given up the request."""
        if self._slowest_ns is None:
            return FIRST_LATE_NS
        if self._is_sequential:
            return self._slowest_ns
        return max(LATE * self._slowest_ns, MIN_LATE_NS)

    def _respond(self, response: Adu, place: AduPlace | None) -> Transaction:
        """The transaction of a response, with its request if it has one."""
        found = self._find(response, place)
        if found is None:
            return self._without_request(response)
        index = self._open.index(found)
        del self._open[index]
        verdicts: tuple[Verdict, ...] = ()
        if found.adu.transaction_id == response.transaction_id:
            self._has_matching_ids = self._has_matching_ids or self._ids_vary
        else:
            verdicts = (Verdict.OTHER_TRANSACTION_ID,)
        if not found.is_given_up and response.start_ns >= found.adu.end_ns:
            latency_ns = response.start_ns - found.adu.end_ns
            self._slowest_ns = max(self._slowest_ns or 0, latency_ns)
            self._fastest_ns = min(self._fastest_ns, latency_ns)
        self._learn_pipelining(found)
        if found.is_after_loss and not self._pipelines:
            self._lost_requests = 0  # The master has gone on behind the lost requests.
        retries = self._take_retries(found, index)
        return with_response(self._ends, found.adu, response, retries, verdicts)

    @property
    def _newest(self) -> _OpenRequest:
        return self._open[-1]

    def _note_id(self, transaction_id: int | None) -> None:
        if transaction_id is None:
            return
        if self._last_id is not None:
            counts_up = 0 < (transaction_id - self._last_id & 0xFFFF) < 0x8000
            self._ids_count_up = counts_up and (self._ids_count_up or not self._ids_vary)
            self._ids_vary = self._ids_vary or transaction_id != self._last_id
        self._last_id = transaction_id

    def _learn_pipelining(self, answered: _OpenRequest) -> None:
        """Notice that another request waits while this one gets its response, both in time."""
        if not answered.is_given_up and any(
            not one.is_given_up and one is not answered for one in self._open
        ):
            self._overlaps += 1
            if self._overlaps >= ENOUGH_OVERLAPS:
                self._pipelines, self._is_sequential = True, False

    def _find(self, response: Adu, place: AduPlace | None) -> _OpenRequest | None:
        possible = [
            one
            for one in self._open
            if one.adu.unit == response.unit
            and is_response_code(one.adu.pdu[0], response.pdu[0])
            and one.can_get(response, place)
        ]
        same_id = [one for one in possible if one.adu.transaction_id == response.transaction_id]
        if not same_id:
            return self._of_other_id(possible, response, place)
        if len(same_id) > 1:
            fitting = [
                one
                for one in same_id
                if is_response_to(parse_pdu(one.adu.pdu, Direction.REQUEST), response.pdu)
            ]
            same_id = fitting or same_id
        waiting = [one for one in same_id if not one.is_given_up]
        found = waiting[0] if waiting else same_id[-1]
        if found is not same_id[0] and self._is_too_early(found, response):
            return same_id[same_id.index(found) - 1]  # A late response.
        if self._has_own_id(found):
            return found
        if self._over_limit:
            return None  # Slaves respond in order: this is the response of a dropped request.
        if self._lost_requests and (not waiting or (self._pipelines and found.is_after_loss)):
            return None
        return found

    def _is_too_early(self, request: _OpenRequest, response: Adu) -> bool:
        """True if a response came sooner than this slave responds."""
        return 2 * (response.start_ns - request.adu.end_ns) < self._fastest_ns < TIMEOUT_NS

    def _has_own_id(self, request: _OpenRequest) -> bool:
        """True if its id cannot be that of a request that the capture lacks."""
        if self._ids_count_up:
            return True
        ids = [one.adu.transaction_id for one in self._open]
        return self._ids_vary and request is self._newest and ids.count(ids[-1]) == 1

    def _of_other_id(
        self, possible: list[_OpenRequest], response: Adu, place: AduPlace | None
    ) -> _OpenRequest | None:
        if len(self._open) != 1 or not possible:
            return None
        (one,) = possible
        is_doubtful = (
            self._has_matching_ids or self._lost_requests or one.may_be_lost or one.is_given_up
        )
        if is_doubtful and not one.is_next_to(response, place):
            return None
        fits = is_response_to(parse_pdu(one.adu.pdu, Direction.REQUEST), response.pdu)
        return one if fits else None

    def _without_request(self, response: Adu) -> Transaction:
        if self._lost_requests:
            self._lost_requests -= 1
        elif self._over_limit:
            self._over_limit -= 1
        else:
            return unsolicited(self._ends, response)
        return unsolicited(self._ends, response, Outcome.NOT_CAPTURED)

    def _take_retries(self, answered: _OpenRequest, index: int) -> int:
        """Count the equal requests before an answered one; each counts only once."""
        retries = self._unanswered.pop(answered.key, 0) if self._unanswered else 0
        for earlier in islice(self._open, index):
            if earlier.counts and earlier.key == answered.key:
                earlier.counts = False
                retries += 1
        return retries

    def _without_response(self) -> Transaction:
        """Close the oldest open request."""
        ended = self._open.popleft()
        if ended.may_be_lost:
            return response_not_captured(self._ends, ended.adu)
        retries = 0
        if ended.counts:
            retries = self._unanswered.pop(ended.key, 0)
            if len(self._unanswered) >= MAX_OPEN_REQUESTS:
                del self._unanswered[next(iter(self._unanswered))]
            self._unanswered[ended.key] = retries + 1
        return no_answer(self._ends, ended.adu, retries)


class _OpenRequest(msgspec.Struct, gc=False, eq=False):
    """A request whose response has not arrived."""

    adu: Adu
    place: AduPlace | None = None
    is_given_up: bool = False
    """True if its master no longer waits for the response."""
    may_be_lost: bool = False
    """True if the capture lacks bytes that may have been its response."""
    counts: bool = True
    """False if a later equal request has already counted this one in its `retries`."""
    is_after_loss: bool = False
    """True if the capture lacks requests before it whose responses had not come by then."""

    @property
    def key(self) -> tuple[int, bytes]:
        return self.adu.unit, self.adu.pdu

    def can_get(self, response: Adu, place: AduPlace | None) -> bool:
        """False if acknowledgements rule out that this request got a response."""
        if place is None or self.place is None:
            return True
        if place.acknowledged is not None and place.acknowledged < self.place.end:
            return False
        received = self.place.acknowledged
        return received is None or received < place.end

    def is_next_to(self, response: Adu, place: AduPlace | None) -> bool:
        """True if acknowledgements show that no byte came between request and response."""
        if place is None or self.place is None:
            return False
        start = place.end - len(response.raw)
        return place.acknowledged == self.place.end and self.place.acknowledged == start

    def response_sizes(self) -> tuple[int, ...]:
        """The lengths that the ADU of its response can have; empty if unknown."""
        added = _ADDED_BYTES[self.adu.transport]
        expected = ExpectedResponse.of(self.adu.pdu)
        if expected is None or expected.size == UNKNOWN_SIZE:
            return ()
        return expected.size + added, _EXCEPTION_PDU + added


def _sums(requests: list[_OpenRequest]) -> set[int]:
    """All lengths that the responses of some requests can have together."""
    sums = {0}
    for one in requests:
        sums = {total + size for total in sums for size in one.response_sizes()}
    return sums
