"""Pairs the requests and responses of one serial line, and makes their transactions."""

# One request is pending at a time. The next request ends it without an answer, with one exception:
# if the next request is for another unit while the master of the pending request may still wait, a
# second master may have overtaken the first. Then the response to the overtaken request is accepted
# until one more request comes. If the times do not prove that the first master still waited, it may
# have given the request up, and the response may be late. Until the line has shown ENOUGH_OVERTAKEN
# such responses among the last RECENT_REQUESTS requests, that is supposed: the request has no
# answer, the response is unsolicited, and both are marked as ambiguous. (network_pairing.py pairs
# the requests and responses of a TCP connection.)
#
# A request without an answer is a transaction of its own. `retries` of the next equal request
# counts the requests before it that had no answer.
#
# Memory: two requests, and at most MAX_OPEN_REQUESTS counts of unanswered requests.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.decode.transactions import (
    Ends,
    broadcast,
    capture_ended,
    no_answer,
    unsolicited,
    with_response,
)
from mbtool.decode.unanswered_counts import UnansweredCounts
from mbtool.decode.unfinished import may_be_answered
from mbtool.modbus.adu import Verdict
from mbtool.modbus.request_match import is_response_code
from mbtool.serial_line.line_statistics import LatencyStatistics

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.decode.stream_progress import AduPlace
    from mbtool.modbus.adu import Adu
    from mbtool.modbus.transaction import Transaction

BUS_TIMEOUT_NS = 5_000_000_000
"""A request without a response is given up after this time, in ns. No master waits so long, so a
late response is still paired with its request."""
ENOUGH_OVERTAKEN = 3
"""The line has two masters if this many of the last RECENT_REQUESTS requests were overtaken by
another request and then answered. With one master, a response comes after the next request only if
it is late, and late responses are rarer than this."""
RECENT_REQUESTS = 100
EVEN = 0.5
"""The confidence (0 to 1) of each of two explanations that are equally likely."""
TWO_MASTERS = (
    "requests come while others wait for their response: two masters share this line, or one does "
    "not wait long enough"
)


def waits_before_any_retry(waited_ns: int) -> bool | None:
    """True if every master, whatever its timeout, still waits `waited_ns` after its request.

    False if some masters may have sent a retry by then.
    """
    return waited_ns < LatencyStatistics.MIN_RETRY_NS


class Pairing:
    """Takes the ADUs of one serial line, returns complete transactions."""

    def __init__(
        self, ends: Ends, still_waits: Callable[[int], bool | None] = waits_before_any_retry
    ) -> None:
        """`still_waits` takes the time since a request, in ns. It returns True if the master
        certainly still waits for the response, False if it may have given up, None if the times do
        not tell.
        """
        self._ends = ends
        self._still_waits = still_waits
        self._open: Adu | None = None
        self._overtaken: Adu | None = None
        """The request before the pending one, if a second master overtook it and its response may
        still come; else None."""
        self._is_surely_overtaken: bool
        """True if the master of the overtaken request certainly still waited. Set when a request is
        overtaken."""
        self._requests = 0
        self._slowest_ns = 0
        """The longest time so far from a request's end to its response's start, in ns."""
        self._answered_at: deque[int] = deque(maxlen=ENOUGH_OVERTAKEN)
        """For each of the last overtaken requests that got a response: the number of requests heard
        by then."""
        self._has_told = False
        """True once the event TWO_MASTERS (two masters on the line) was returned, so that it is not
        repeated."""
        self._unanswered = UnansweredCounts()

    def feed(self, adu: Adu, _place: AduPlace | None = None) -> list[Transaction | WireEvent]:
        """Take the next ADU, in order of time; return the transactions and events it completes.

        The event of kind TWO_MASTERS comes at most once.
        """
        done: list[Transaction | WireEvent] = []
        if self._open is not None or self._overtaken is not None:
            done += self.advance(adu.start_ns)
        if adu.direction is not Direction.RESPONSE:
            self._requests += 1
            if self._open is not None or self._overtaken is not None:
                self._doubt_silence(adu)
                done += self._make_way(adu)
            if adu.unit == 0:
                done.append(broadcast(self._ends, adu))
            else:
                self._open = adu
            return done
        if (request := self._open) is not None and _answers(adu, request):
            self._open = None
        elif (request := self._overtaken) is not None and _answers(adu, request):
            self._overtaken = None
            done += self._two_masters(adu)
            if not (self._is_surely_overtaken or self._has_told):
                done.append(self._unanswered_request(_in_doubt(request)))
                done.append(unsolicited(self._ends, _in_doubt(adu)))
                return done
        else:
            done.append(unsolicited(self._ends, adu))
            return done
        self._slowest_ns = max(self._slowest_ns, adu.start_ns - request.end_ns)
        retries = self._unanswered.take(request) if self._unanswered else 0
        done.append(with_response(self._ends, request, adu, retries, ()))
        return done

    def advance(self, now_ns: int) -> list[Transaction]:
        """Give up requests that waited more than BUS_TIMEOUT_NS; return their transactions."""
        done: list[Transaction] = []
        if (overtaken := self._overtaken) and now_ns - overtaken.end_ns > BUS_TIMEOUT_NS:
            self._overtaken = None
            done.append(self._unanswered_request(overtaken))
        if self._open is not None and now_ns - self._open.end_ns > BUS_TIMEOUT_NS:
            done += self.close()
        return done

    def _make_way(self, adu: Adu) -> list[Transaction]:
        """End the pending requests when the request `adu` comes; return their transactions.

        If `adu` may have overtaken the last one, that becomes `_overtaken` instead.
        """
        request = self._open
        if request is None or adu.unit in (0, request.unit):
            return self.close()
        waits = self._still_waits(adu.start_ns - request.end_ns)
        if waits is False:
            return self.close()
        self._open = None
        done = self.close()
        self._overtaken, self._is_surely_overtaken = request, waits is True
        return done

    def _two_masters(self, adu: Adu) -> list[WireEvent]:
        """Count `adu`, a response to an overtaken request.

        Returns the event TWO_MASTERS when ENOUGH_OVERTAKEN such responses were counted among the
        last RECENT_REQUESTS requests; otherwise, and later, nothing.
        """
        numbers = self._answered_at
        numbers.append(self._requests)
        is_enough = len(numbers) == ENOUGH_OVERTAKEN and numbers[-1] - numbers[0] < RECENT_REQUESTS
        if self._has_told or not is_enough:
            return []
        self._has_told = True
        return [
            WireEvent(
                ts_ns=adu.start_ns,
                link=self._ends.link,
                kind=EventKind.TWO_MASTERS,
                message=TWO_MASTERS,
            )
        ]

    def _doubt_silence(self, adu: Adu) -> None:
        """Mark the pending request as ambiguous if `adu` equals it and may be its response.

        `adu` was taken for a request, but ambiguously. The outcome of the pending request is no
        more certain than the direction of `adu`.
        """
        request = self._open
        if request is not None and request.raw == adu.raw and Verdict.AMBIGUOUS in adu.verdicts:
            verdicts = tuple(dict.fromkeys((*request.verdicts, Verdict.AMBIGUOUS)))
            confidence = min(request.confidence, adu.confidence)
            self._open = replace(request, confidence=confidence, verdicts=verdicts)

    def close(self, end_ns: int | None = None) -> list[Transaction]:
        """End the line: return the transactions of the requests that have no response.

        `end_ns` is the time at which the capture ended: a request whose response may have come
        later gets the outcome `not-captured`. If `end_ns` is None, all these requests get the
        outcome `no-answer`.
        """
        requests, self._overtaken, self._open = (self._overtaken, self._open), None, None
        return [
            capture_ended(self._ends, request)
            if end_ns is not None and self._may_be_answered(request, end_ns)
            else self._unanswered_request(request)
            for request in requests
            if request is not None
        ]

    def _may_be_answered(self, request: Adu, end_ns: int) -> bool:
        """True if the response to a request may come after `end_ns`, when the capture ends."""
        waited_ns = end_ns - request.end_ns
        return not self._ends.timed or may_be_answered(waited_ns, self._slowest_ns)

    def _unanswered_request(self, request: Adu) -> Transaction:
        """Count a request that got no response; return its transaction."""
        return no_answer(self._ends, request, self._unanswered.add(request))


def _in_doubt(adu: Adu) -> Adu:
    """Return the ADU marked as ambiguous, because it may belong to another transaction."""
    verdicts = tuple(dict.fromkeys((*adu.verdicts, Verdict.AMBIGUOUS)))
    return replace(adu, confidence=min(adu.confidence, EVEN), verdicts=verdicts)


def _answers(response: Adu, request: Adu) -> bool:
    """True if a response, or exception response, has the unit and the function of a request."""
    return request.unit == response.unit and is_response_code(request.pdu[0], response.pdu[0])
