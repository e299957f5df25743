"""Pairs the requests and responses of one serial line, and makes their transactions."""

# The last request is the pending one; earlier requests without a response stay open for a while
# (OpenLineRequests). A response belongs to an open request of its unit and function:
#
#     form      The response fits the request: the number of values, what it repeats of the request.
#               A response that fits no open request goes to the pending one, as malformed.
#     order     The pending request is tried first, then the oldest open one, since a slave answers
#               in order.
#     time      The unit never answers in less than half of its shortest time so far.
#     the next  If a response fits the pending request and an earlier one, it is held back. If the
#               next response of the unit has no request of its own, each held response belongs to
#               the request before the one that it was held for.
#
# A response to an earlier request is late if its master had given this request up before it sent
# the next one. If the master certainly still waited, and only one request was sent since, the
# response is in time: a second master has sent that request. If the times do not tell which of the
# two is true, the response counts as late and ambiguous, until the line has shown ENOUGH_OVERTAKEN
# such responses among the last RECENT_REQUESTS requests. From then on, equal waits
# (MIN_EQUAL_WAITS) before the next request are the time-out of one master, and different waits show
# two masters.
#
# If bytes that belong to no frame follow a request, they are its damaged response, and the request
# has no answer. A response that follows such bytes directly may answer a damaged request, so it is
# paired with no earlier request.
#
# A request without an answer is a transaction of its own. `retries` of the next equal request
# counts the requests before it that had no answer. The transactions of one unit come in the order
# of their requests.
#
# Memory: the open requests (see OpenLineRequests), MAX_HELD responses for each of at most 247
# units, and at most MAX_OPEN_REQUESTS counts of unanswered requests.

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.decode.transactions import (
    Ends,
    broadcast,
    capture_ended,
    late,
    no_answer,
    unsolicited,
    with_pair_confidence,
    with_response,
)
from mbtool.decode.unanswered_counts import UnansweredCounts
from mbtool.decode.unfinished import may_be_answered
from mbtool.modbus.adu import Adu, Skipped, Verdict
from mbtool.modbus.expected_response import ExpectedResponse, is_response_code
from mbtool.modbus.transaction import Outcome, Transaction
from mbtool.serial_line.line_statistics import LatencyStatistics

if TYPE_CHECKING:
    from mbtool.decode.stream_progress import AduPlace

BUS_TIMEOUT_NS = 5_000_000_000
"""A request that got no response within this time (ns) is given up. Masters wait less, so that a
late response is still paired with its request."""
ENOUGH_OVERTAKEN = 3
"""The line has two masters if this many of the last RECENT_REQUESTS requests were overtaken by
another request and then answered. With one master, a response comes after the next request only if
it is late, and late responses are rarer than this."""
RECENT_REQUESTS = 100
"""The number of last requests among which ENOUGH_OVERTAKEN must be overtaken and then answered."""
EVEN_ODDS = 0.5
"""The confidence (0 to 1) of a transaction whose response may as well belong to another request of
the unit."""
MIN_EQUAL_WAITS = 0.8
"""The waits before requests count as one time-out if the shortest is at least this share (0 to 1)
of the longest. Then there is one master, and late responses do not prove two."""
MAX_HELD = 4
"""At most this many responses of one unit wait until a later frame shows which requests they
answer."""
LEAST_DAMAGED = 4
"""Bytes in no frame are taken for a damaged request if at least this many stand in a row; the next
response may then be the answer to it."""
TWO_MASTERS = (
    "requests come while others wait for their response: two masters share this line, or one does "
    "not wait long enough"
)

MIN_APART = 0.25
"""Two responses of a unit answer two requests if the second begins later than the end of the first
by at least this share (0 to 1) of the time that the first took. A second copy of the same response
comes sooner."""


class _HeldChain(NamedTuple):
    """Responses that each belong to its own request, or else all to the request before it."""

    requests: list[Adu]
    """Requests to one unit; the first was given up without a response."""
    responses: list[Adu]
    """One response fewer than there are requests."""

    @property
    def until_ns(self) -> int:
        """The time (ns) from which on, if the unit sent no other response, each response is paired
        with its own request.
        """
        return min(
            self.responses[-1].end_ns + 2 * self._response_time_ns,
            self.requests[-2].end_ns + BUS_TIMEOUT_NS,
        )

    @property
    def apart_ns(self) -> int:
        """The least time (ns) from the end of the unit's last response to its response to another
        request; a copy of the last response comes sooner.
        """
        return int(MIN_APART * self._response_time_ns)

    @property
    def _response_time_ns(self) -> int:
        """The time (ns) from the last request but one to the last response, which may answer it."""
        return self.responses[-1].start_ns - self.requests[-2].end_ns


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
        self._pending: Adu | None = None
        self._earlier = OpenLineRequests()
        self._held: dict[int, _HeldChain] = {}
        """By unit, the responses that are held back."""
        self._requests = 0
        self._slowest_ns = 0
        """The longest time so far from a request's end to its response's start, in ns."""
        self._overtaken: deque[tuple[int, OpenLineRequest]] = deque(maxlen=ENOUGH_OVERTAKEN)
        """The last overtaken requests that got a response, each with the number of requests heard
        by then."""
        self._last_answer = b""
        """The bytes of the last frame if it was a response; otherwise empty."""
        self._is_damaged = False
        """True if bytes that belong to no frame came since the last ADU."""
        self._has_told = False
        """True once the event TWO_MASTERS (two masters on the line) was returned, so that it is not
        repeated."""
        self._unanswered = UnansweredCounts()

    def feed(self, adu: Adu, _place: AduPlace | None = None) -> list[Transaction | WireEvent]:
        """Take the next ADU, in order of time; return the transactions and events it completes.

        The event of kind TWO_MASTERS comes at most once.
        """
        done: list[Transaction | WireEvent] = []
        if self._pending is not None or self._earlier.open or self._held:
            done += self.advance(adu.start_ns)
        done += self._ask(adu) if adu.direction is not Direction.RESPONSE else self._respond(adu)
        self._is_damaged = False
        return done

    def note_skipped(self, skipped: Skipped) -> list[Transaction]:
        """Take the next bytes that belong to no frame; return the transactions that time out."""
        self._is_damaged |= len(skipped.raw) >= LEAST_DAMAGED
        return self.advance(skipped.ts_ns)

    def advance(self, now_ns: int) -> list[Transaction]:
        """Give up requests that waited more than BUS_TIMEOUT_NS; return their transactions."""
        done: list[Transaction] = []
        for unit in [unit for unit, held in self._held.items() if now_ns > held.until_ns]:
            done += self._release(unit)
        limit_ns = now_ns - BUS_TIMEOUT_NS
        if self._earlier.open:
            done += self._unanswered_of(self._earlier.take_sent_before(limit_ns))
        if self._pending is not None and self._pending.end_ns < limit_ns:
            pending, self._pending = self._pending, None
            done.append(self._unanswered_request(pending))
        return done

    def close(self, end_ns: int | None = None) -> list[Transaction]:
        """End the line: return the transactions of the requests that have no response.

        `end_ns` is the time at which the capture ended: a request whose response may have come
        later, in time or late, gets the outcome `not-captured`. If `end_ns` is None, all these
        requests get the outcome `no-answer`.
        """
        done = [each for unit in [*self._held] for each in self._release(unit)]
        # If the capture has no times, a request that was followed by another is not known to be
        # recent.
        timed = self._ends.timed
        earlier = self._earlier.take_all()
        requests = [(one.adu, timed or self._is_overtaken(one)) for one in earlier]
        if self._pending is not None:
            requests.append((self._pending, True))
            self._pending = None
        for request, may_be_recent in requests:
            if end_ns is not None and may_be_recent and self._may_be_answered(request, end_ns):
                done.append(capture_ended(self._ends, request))
            else:
                done.append(self._unanswered_request(request))
        return done

    def _ask(self, request: Adu) -> list[Transaction]:
        """Take a request; the one that was pending becomes an earlier one."""
        self._requests += 1
        self._last_answer = b""
        done: list[Transaction] = []
        pending, self._pending = self._pending, None
        if self._held and not self._hears_waits():
            done += [each for unit in [*self._held] for each in self._release(unit)]
        if pending is not None:
            waited_ns = request.start_ns - pending.end_ns
            waits = self._still_waits(waited_ns)
            if pending.unit in self._held:
                done += self._release(pending.unit)
            if (request.unit, request.pdu) == (pending.unit, pending.pdu):
                waits = False  # The master repeats its request.
            pending = _with_doubt(pending, request)
            if self._is_damaged and not waits:
                done += self._unanswered_of(self._earlier.take_all_of(pending.unit))
                done.append(self._unanswered_request(pending))
            else:
                one = OpenLineRequest(pending, self._requests, waited_ns, waits)
                done += self._unanswered_of(self._earlier.add(one))
        if request.unit:
            self._pending = request
        else:
            done.append(broadcast(self._ends, request))
        return done

    def _respond(self, response: Adu) -> list[Transaction | WireEvent]:
        """Take a response; return the transactions that it completes."""
        pending = self._pending
        if pending is not None and not has_code(pending, response):
            pending = None
        if self._is_damaged and pending is not None and not fits(pending, response):
            # The damaged bytes were its request.
            return [*self._alone(response, Outcome.NOT_CAPTURED)]
        if pending is not None and not (self._earlier.open or self._held):
            # The usual case, before the general one.
            self._pending = None
            return [self._answered_transaction(pending, response)]
        done: list[Transaction | WireEvent] = []
        if response.unit in self._held:
            if pending is not None and self._extends_held(pending, response):
                return done
            done += self._reconsider(pending, response)
        earlier = self._earlier_of(response) if self._earlier.open else []
        if pending is None:
            done += self._answer_earlier(earlier[0], response) if earlier else self._alone(response)
        elif not earlier:
            done += self._answer_pending(pending, response)
        elif not fits(pending, response) or self._is_surely_overtaken(earlier[0]):
            done += self._answer_earlier(earlier[0], response)
        elif self._earlier.is_too_early(response.unit, response.start_ns - pending.end_ns):
            done += self._answer_earlier(earlier[0], response)
            # The master takes the late response for the response to the pending request.
            self._earlier.put_back(pending)
            self._pending = None
        elif self._may_be_late(earlier[0], response):
            done += self._hold(earlier[0], pending, response)
        else:
            done += self._answer_pending(pending, response)
        return done

    def _earlier_of(self, response: Adu) -> list[OpenLineRequest]:
        """Return the earlier requests that a response may answer, the oldest first."""
        found = self._earlier.fitting(response)
        if self._is_damaged:
            found = [one for one in found if self._is_surely_overtaken(one)]
        return found

    def _is_surely_overtaken(self, one: OpenLineRequest) -> bool:
        """True if a second master sent the next request while the first still waited.

        A slave answers in order, so its next response is to the first request.
        """
        return one.waits is True and self._is_overtaken(one)

    def _is_overtaken(self, one: OpenLineRequest) -> bool:
        """True if a second master may have sent the one request that followed an open one."""
        return one.waits is not False and self._requests == one.next_number

    def _alone(self, response: Adu, outcome: Outcome = Outcome.UNSOLICITED) -> list[Transaction]:
        """Return the transaction of a response that belongs to no request."""
        self._earlier.note_unrequested_response(response.unit)
        if not self._requests:  # Its request was sent before the capture began.
            outcome = Outcome.NOT_CAPTURED
        # If the line shows no silences that tell a retry, this response may be a repeater's copy of
        # the previous one, or the response to a retry.
        is_heard = response.silence_before_ns != 0 and self._still_waits(0) is not None
        # If only slaves are heard, an equal response is the response to the next request.
        is_doubted = self._requests > 0 and response.raw == self._last_answer and not is_heard
        self._last_answer = response.raw
        return [
            with_pair_confidence(
                unsolicited(self._ends, response, outcome), EVEN_ODDS if is_doubted else 1.0
            )
        ]

    def _may_be_late(self, earlier: OpenLineRequest, response: Adu) -> bool:
        """True if a response may belong to a request that its master has given up."""
        if not self._hears_waits():
            return True
        taken_ns = response.start_ns - earlier.adu.end_ns
        return earlier.waits is not True and self._earlier.can_take(response.unit, taken_ns)

    def _hears_waits(self) -> bool:
        """True if the times tell how long a slave took and how long the master waited."""
        return self._ends.timed and self._still_waits(0) is not None

    def _answer_pending(self, pending: Adu, response: Adu) -> list[Transaction]:
        self._pending = None
        done = self._unanswered_of(self._earlier.take_all_of(response.unit))
        return [*done, self._answered_transaction(pending, response)]

    def _answer_earlier(
        self, earlier: OpenLineRequest, response: Adu
    ) -> list[Transaction | WireEvent]:
        """Pair a response with a request that is not the line's last one."""
        done: list[Transaction | WireEvent] = [*self._unanswered_of(self._earlier.take(earlier))]
        is_late, confidence = True, 1.0
        if self._is_overtaken(earlier):
            self._overtaken.append((self._requests, earlier))
            done += self._two_masters(response)
            is_late = not (earlier.waits or self._has_told)
            if is_late and not self._has_timeout():
                confidence = EVEN_ODDS
        done.append(
            self._answered_transaction(
                earlier.adu, response, is_late=is_late, confidence=confidence
            )
        )
        return done

    def _hold(self, earlier: OpenLineRequest, pending: Adu, response: Adu) -> list[Transaction]:
        """Hold the pending request's response back, as it may belong to an `earlier` request.

        Returns the transactions of the requests before `earlier`. From now on `earlier` belongs to
        the held responses, so it is returned only once.
        """
        self._pending = None
        done = self._unanswered_of(self._earlier.take(earlier))
        self._held[response.unit] = _HeldChain([earlier.adu, pending], [response])
        return done

    def _extends_held(self, pending: Adu, response: Adu) -> bool:
        """Hold one more response of a unit back if it, too, may belong to the request before."""
        held = self._held[response.unit]
        last = held.requests[-1]
        taken_ns = response.start_ns - last.end_ns
        if not (fits(pending, response) and fits(last, response)):
            return False
        if len(held.responses) >= MAX_HELD or not self._earlier.can_take(response.unit, taken_ns):
            return False
        self._pending = None
        held.requests.append(pending)
        held.responses.append(response)
        return True

    def _reconsider(self, pending: Adu | None, response: Adu) -> list[Transaction]:
        """Decide about a unit's held responses when the unit sends another one.

        If that is an answer to the last of the held requests, because no other request waits for
        it, each held response belongs to the request before. The last request is then open again.
        """
        unit = response.unit
        held = self._held[unit]
        is_answer = pending is None and fits(held.requests[-1], response)
        is_answer &= not self._is_damaged  # The damaged bytes may have been its request.
        if is_answer and self._hears_waits():
            is_answer = response.start_ns - held.responses[-1].end_ns >= held.apart_ns
        elif is_answer and response.raw == held.responses[-1].raw:
            # It may be a repeater's copy, too. Which of two equal requests got it is no question.
            is_retry = held.requests[0].raw == held.requests[1].raw
            return self._release(unit, 1.0 if is_retry else EVEN_ODDS)
        if not is_answer:
            return self._release(unit)
        del self._held[unit]
        done = self._unanswered_of(self._earlier.take_all_of(unit))
        self._earlier.put_back(held.requests[-1])
        for request, one in zip(held.requests, held.responses, strict=False):
            done.append(self._answered_transaction(request, one, is_late=True))
        return done

    def _release(self, unit: int, confidence: float = 1.0) -> list[Transaction]:
        """Return the transactions of a unit's held responses, each with its own request, and those
        of the requests before them.

        `confidence` (0 to 1) tells how surely each response is to its own request.
        """
        held = self._held.pop(unit)
        done = [self._unanswered_request(held.requests[0])]
        done += self._unanswered_of(self._earlier.take_all_of(unit))
        for request, response in zip(held.requests[1:], held.responses, strict=True):
            done.append(self._answered_transaction(request, response, confidence=confidence))
        return done

    def _answered_transaction(
        self, request: Adu, response: Adu, *, is_late: bool = False, confidence: float = 1.0
    ) -> Transaction:
        """Return the transaction of a request and its response.

        `confidence` (0 to 1) tells how surely they belong together, and how surely the response is
        in time or late.
        """
        self._last_answer = response.raw
        taken_ns = response.start_ns - request.end_ns
        if taken_ns > self._slowest_ns:
            self._slowest_ns = taken_ns
        if self._ends.timed:
            self._earlier.note_response(request.unit, taken_ns)
        else:
            self._earlier.note_unrequested_response(request.unit)
        retries = self._unanswered.take(request) if self._unanswered else 0
        done = with_response(self._ends, request, response, retries, ())
        if confidence < 1.0:
            done = with_pair_confidence(done, confidence)
        return late(done) if is_late else done

    def _unanswered_of(self, requests: list[OpenLineRequest]) -> list[Transaction]:
        return [self._unanswered_request(one.adu) for one in requests]

    def _two_masters(self, response: Adu) -> list[WireEvent]:
        """Return the event TWO_MASTERS if the last overtaken requests show that.

        ENOUGH_OVERTAKEN of the last RECENT_REQUESTS requests must have been overtaken and then
        answered. The event comes only once.
        """
        found = self._overtaken
        if self._has_told or len(found) < ENOUGH_OVERTAKEN or self._has_timeout():
            return []
        if found[-1][0] - found[0][0] >= RECENT_REQUESTS:
            return []
        self._has_told = True
        return [
            WireEvent(
                ts_ns=response.start_ns,
                link=self._ends.link,
                kind=EventKind.TWO_MASTERS,
                message=TWO_MASTERS,
            )
        ]

    def _has_timeout(self) -> bool:
        """True if the last requests with a response behind the next one were given up after equal
        times: the time-out of one master.
        """
        found = [one for _, one in self._overtaken]
        if len(found) < ENOUGH_OVERTAKEN or not self._ends.timed or any(one.waits for one in found):
            return False
        waits = [one.waited_ns for one in found]
        return min(waits) >= max(MIN_EQUAL_WAITS * max(waits), LatencyStatistics.MIN_RETRY_NS)

    def _may_be_answered(self, request: Adu, end_ns: int) -> bool:
        """True if the response to a request may come after `end_ns`, when the capture ends."""
        waited_ns = end_ns - request.end_ns
        return not self._ends.timed or may_be_answered(waited_ns, self._slowest_ns)

    def _unanswered_request(self, request: Adu) -> Transaction:
        """Count a request that got no response; return its transaction."""
        return no_answer(self._ends, request, self._unanswered.add(request))


def _with_doubt(pending: Adu, request: Adu) -> Adu:
    """Return the pending request, with the confidence of `request` if that may answer it.

    `request` was taken for a request, and may be a response that repeats the pending one or, of a
    write, its address. So the outcome of the pending request is no more certain.
    """
    if request.confidence >= pending.confidence or not _may_echo(pending, request):
        return pending
    verdicts, confidence = pending.verdicts, request.confidence
    if Verdict.AMBIGUOUS in request.verdicts:
        verdicts = tuple(dict.fromkeys((*verdicts, Verdict.AMBIGUOUS)))
    return replace(pending, confidence=confidence, verdicts=verdicts)


def _may_echo(pending: Adu, request: Adu) -> bool:
    """True if a frame equals the pending request, or has its unit, function and address."""
    return request.unit == pending.unit and request.pdu[:3] == pending.pdu[:3]


# The requests of a serial line that have no response yet, though another request followed them.
#
# A request stays open until its unit answers a later request, until the unit has left more than
# MAX_OF_UNIT requests in a row without a response, or until the caller takes it out as too old. A
# unit that has left that many requests unanswered counts as switched off: its further requests stay
# open only if a second master may have sent the next request while the first one still waited.
#
# Memory: MAX_OPEN requests, and one record of times for each of at most 247 units.

MAX_OF_UNIT = 4
"""At most this many requests of one unit stay open; a further one closes the oldest without a
response. A unit that left more in a row unanswered counts as switched off."""
MAX_OPEN = 32
"""At most this many requests of one line stay open; a further one closes the oldest without a
response."""
ENOUGH_TIMES = 3
"""The response times of a unit are compared with new ones once this many responses came in time."""
BLOCK_NS = 16_000_000
"""The time (ns) by which an adapter may deliver bytes late: FTDI adapters deliver every 16 ms by
default. A response is called too early for its request only by more than this."""
UNUSUAL = 2
"""A response is too late for its request if it takes more than this many times as long as the
slowest response of its unit so far."""


class OpenLineRequest(NamedTuple):
    """A request without a response that was not the line's last one."""

    adu: Adu
    next_number: int
    """The number of the request after this one; the requests of the line are counted from 1."""
    waited_ns: int
    """The time (ns) from the end of this request to the start of the next one."""
    waits: bool | None
    """True if the master certainly still waited for this request when it sent the next one, False
    if it had given the request up, None if the times do not tell."""


class _Unit:
    """The times that one unit takes to respond, in ns, and its requests without a response."""

    __slots__ = ("fastest_ns", "number", "silent", "slowest_ns")

    def __init__(self) -> None:
        self.silent = 0
        """The number of requests in a row without a response."""
        self.number = 0
        self.fastest_ns = 1 << 63
        self.slowest_ns = 0


class OpenLineRequests:
    """Holds open requests, the oldest first."""

    def __init__(self) -> None:
        self.open: list[OpenLineRequest] = []
        """The open requests, the oldest first. The caller only reads it."""
        self._units: dict[int, _Unit] = {}

    def add(self, one: OpenLineRequest) -> list[OpenLineRequest]:
        """Add a request that another one followed; return the requests that no longer stay open."""
        number = one.adu.unit
        unit = self._times_of_unit(number)
        unit.silent += 1
        if one.waits is False and unit.silent > MAX_OF_UNIT:
            return [*self._take(self._requests_of_unit(number)), one]
        self.open.append(one)
        if len(of_unit := self._requests_of_unit(number)) > MAX_OF_UNIT:
            return self._take(of_unit[:1])
        return self._take(self.open[:1]) if len(self.open) > MAX_OPEN else []

    def put_back(self, request: Adu) -> None:
        """Add a request whose response turned out to belong to an earlier request."""
        self.open.append(OpenLineRequest(request, 0, 0, waits=False))
        self.open.sort(key=lambda one: one.adu.end_ns)

    def fitting(self, response: Adu) -> list[OpenLineRequest]:
        """Return the requests that a response fits in its form, and in its time if that is known.

        If the response fits none in its time, returns the last one that it fits in its form.
        """
        found = [one for one in self.open if fits(one.adu, response)]
        start_ns = response.start_ns
        in_time = [one for one in found if self.can_take(response.unit, start_ns - one.adu.end_ns)]
        return in_time or found[-1:]

    def take(self, one: OpenLineRequest) -> list[OpenLineRequest]:
        """Take out a request that got its response; return the unit's requests before it.

        These no longer stay open, as a slave answers in order.
        """
        of_unit = self._requests_of_unit(one.adu.unit)
        taken = self._take(of_unit[: of_unit.index(one) + 1])
        return taken[:-1]

    def take_all_of(self, unit: int) -> list[OpenLineRequest]:
        """Take out the requests to a unit that answered a later request."""
        return self._take(self._requests_of_unit(unit)) if self.open else []

    def take_sent_before(self, time_ns: int) -> list[OpenLineRequest]:
        """Take out the requests that ended before `time_ns`."""
        return self._take([one for one in self.open if one.adu.end_ns < time_ns])

    def take_all(self) -> list[OpenLineRequest]:
        taken, self.open = self.open, []
        return taken

    def note_unrequested_response(self, number: int) -> None:
        """Note that a unit has sent a response that belongs to no request."""
        self._times_of_unit(number).silent = 0

    def note_response(self, number: int, taken_ns: int) -> None:
        """Note the time (ns) that a unit took to respond."""
        unit = self._units.get(number)
        if unit is None:
            unit = self._times_of_unit(number)
        unit.silent = 0
        unit.number += 1
        if taken_ns > unit.slowest_ns:
            unit.slowest_ns = taken_ns
        if taken_ns < unit.fastest_ns:
            unit.fastest_ns = taken_ns

    def is_too_early(self, unit: int, taken_ns: int) -> bool:
        """True if a unit never responded in less than twice `taken_ns`.

        An adapter that delivers in blocks makes times shorter or longer by up to BLOCK_NS.
        """
        times = self._times_of_unit(unit)
        is_known = times.number >= ENOUGH_TIMES
        return is_known and max(2 * taken_ns, taken_ns + BLOCK_NS) < times.fastest_ns

    def can_take(self, unit: int, taken_ns: int) -> bool:
        """True if a unit may take `taken_ns` to respond, as far as its times are known."""
        times = self._times_of_unit(unit)
        return times.number < ENOUGH_TIMES or taken_ns <= UNUSUAL * times.slowest_ns

    def _times_of_unit(self, unit: int) -> _Unit:
        found = self._units.get(unit)
        if found is None:
            found = self._units[unit] = _Unit()
        return found

    def _requests_of_unit(self, unit: int) -> list[OpenLineRequest]:
        return [one for one in self.open if one.adu.unit == unit]

    def _take(self, some: list[OpenLineRequest]) -> list[OpenLineRequest]:
        if some:
            self.open = [one for one in self.open if one not in some]
        return some


def has_code(request: Adu, response: Adu) -> bool:
    """True if a response, or exception response, has the unit and the function of a request."""
    return request.unit == response.unit and is_response_code(request.pdu[0], response.pdu[0])


def fits(request: Adu, response: Adu) -> bool:
    """True if a response has the unit of a request and the form that the request asks for."""
    if request.unit != response.unit:
        return False
    expected = ExpectedResponse.of(request.pdu)
    return expected is not None and expected.fits(response.pdu)
