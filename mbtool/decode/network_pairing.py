"""Joins the requests and responses of one TCP connection into transactions, by evidence."""

# A response can belong to a request with the same transaction id, unit and function. Masters may
# pipeline, slaves may respond out of order, and many masters always send the same id. So several
# requests can be possible. These decide:
#
#     acknowledgements   A response is sent after its request was received: its segment acknowledges
#                        the request. A request that acknowledges the response was sent after it.
#     order              Requests with the same id are answered in order.
#     number             Each response has a request. If the capture lacks bytes of responses, these
#                        answered some of the requests. If it lacks bytes of requests, the responses
#                        to these will come.
#     form               The response has the number of values that its request asks for, and
#                        repeats the same fields (address, value).
#     time               When the master sends its next request, it has given up a request that has
#                        waited longer than the slowest response so far took. If the master may
#                        pipeline, the wait must be LATE times as long. A slave rarely answers a
#                        request that was given up, and as rarely leaves another one unanswered.
#
# A response is late if the master never pipelines and has sent its next request before the response
# comes. That request must repeat the first, or must have been sent when the master's usual time-out
# was over.
#
# pairing_readings.py weighs this evidence. A reading is one way to assign responses to requests. A
# transaction is returned as soon as its response can hardly belong to another request. If two
# readings cost about the same, the responses are held back until another ADU or a silence of the
# connection decides: at most MAX_HELD responses, and for at most HOLD_NS. After that the cheapest
# reading is taken, and its transactions are ambiguous.
#
# A slave may respond with another transaction id than the request's. Its response then belongs to
# the only pending request if three conditions are met: the response fits the request; no earlier
# request can still wait for its response, and the capture lacks no bytes; and this slave never
# repeated an id correctly, or acknowledgements show that nothing came between the two. A slave may
# also repeat the id and respond with another unit, as a module that ignores the unit does (it is
# asked as unit FFH, and calls itself 1). Then the response belongs to the only pending request with
# this id if no missing bytes and no other ADU lie between. If the capture begins within the
# connection, ids must have varied before.
#
# A response without a request is unsolicited. But its outcome is not-captured if the capture lacked
# bytes of requests in the TIMEOUT_NS before it, because its request may be among them. If the
# capture begins within the connection, the outcome is not-captured until the first request, and for
# TIMEOUT_NS after the first ADU.
#
# Memory: at most MAX_OPEN_REQUESTS waiting requests, and as many counts of unanswered requests. A
# request beyond that is dropped, and it and its response get the verdict over-limit. If the master
# had given the dropped request up, the outcome of its transaction is no-answer.

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any, TypeVar

import msgspec

from mbtool.core import Direction
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.dropped_requests import DroppedRequests
from mbtool.decode.giving_up import give_up_late, give_up_lost, give_up_repeated, request_key
from mbtool.decode.master_habits import FIRST_LATE_NS, MasterHabits
from mbtool.decode.open_requests import OpenRequest
from mbtool.decode.order_doubt import OrderDoubt
from mbtool.decode.pairing_readings import (
    MARGIN,
    MAX_BEFORE,
    MAX_PASSED,
    REQUEST_BEFORE,
    UNASKED,
    PairOption,
    PairReading,
    PairStep,
    likely_cost,
    lost_runs,
    may_be_among,
    most_readings,
    options,
    without_costly,
    without_pipelined,
)
from mbtool.decode.plain_stretch import NO_LIMITS, PlainLimits, PlainStretch
from mbtool.decode.stream_progress import AduPlace
from mbtool.decode.transactions import (
    Ends,
    capture_ended,
    late,
    no_answer,
    response_not_captured,
    unsolicited,
    with_response,
)
from mbtool.decode.unanswered_counts import UnansweredCounts
from mbtool.decode.unfinished import unfinished_in
from mbtool.modbus.adu import Adu, Skipped, Verdict
from mbtool.modbus.transaction import Outcome, Transaction

_Costed = TypeVar("_Costed", bound=tuple[Any, ...])

TIMEOUT_NS = 60_000_000_000
"""A request that got no response within this time (ns) is closed. Masters wait less, so that a late
response is still paired with its request."""
MAX_HELD = 32
"""At most this many responses of a connection wait until a later ADU shows which requests they
answer."""
HOLD_NS = 3_000_000_000
"""The longest time, in ns, that a response is held back because it may answer one of several
requests. A user who watches a live capture sees its transaction later by up to this time."""
MAX_LOST_REQUESTS = 32
"""A run of lost bytes is taken for at most this many requests."""
MANY_LOSSES = 2
"""The number of losses within NEAR_REQUESTS requests from which on pairs are doubtful."""
NEAR_REQUESTS = 32
"""Losses whose number of requests or responses is not known make the later pairs doubtful if the
capture lacked bytes MANY_LOSSES times within NEAR_REQUESTS requests. For a single such loss, its
length is enough evidence: in simulated plants, no pair is wrong if every twentieth packet is lost.
If every fifth is lost, 0.05 % of the pairs that are not doubtful are wrong (0.3 % with
MANY_LOSSES = 3)."""
ONE_REQUEST = 16
"""A run of fewer lost bytes than this is taken for one request: the shortest request has 8 bytes,
two have 16."""
RECENT_WAITS = 16
"""The number of last waits of a master for a request without a response that are kept."""
ENOUGH_WAITS = 3
"""The number of about equal waits (WAIT_TOLERANCE) from which on they count as the master's
time-out."""
WAIT_TOLERANCE = 0.15
"""Two waits of a master count as equal if they differ by at most this share (0 to 1). ENOUGH_WAITS
equal ones among the last RECENT_WAITS waits show its time-out."""
DOUBTFUL = 0.5
"""The confidence (0 to 1) of a transaction whose response may as well belong to another request."""

_USUAL_REQUEST = 12
"""The size in bytes of the ADU of a read request. The number of lost requests is the number of lost
bytes divided by this."""


class NetworkPairing:
    """Takes the ADUs of one connection in order, returns complete transactions."""

    def __init__(self, ends: Ends, *, joined: bool = False) -> None:
        """`joined` is True if the capture lacks the beginning of the connection."""
        self._ends = ends
        self._joined = joined
        self._lost_ns: int | None = None
        """The last time (ns) at which the capture lacked bytes; None if it lacks none."""
        self._losses: deque[int] = deque(maxlen=MANY_LOSSES)
        """For each of the last times at which the capture lacked bytes, the number of requests
        before it."""
        self._requests_lost_ns: int | None = None
        """The last time (ns) at which the capture lacked requests; None if it lacks none. If the
        capture lacks the beginning of the connection, the time of the first ADU counts."""
        self._readings = [PairReading([], [], before=MAX_BEFORE if joined else 0)]
        self._habits = MasterHabits()
        self._requests = 0
        """The number of requests so far, including those that the capture lacks."""
        self._waits: deque[int] = deque(maxlen=RECENT_WAITS)
        """The last times (ns) from a request without a response to the master's next request."""
        self._unanswered = UnansweredCounts()
        self._dropped = DroppedRequests()
        self.response_is_cut = False
        """True while the splitter holds the start of a response whose end the capture lacks."""
        self._doubt: OrderDoubt | None = None
        """Set while each response may belong to another request than the one that it is paired
        with: after a choice between ways to pair of equal cost, and after a loss of requests or
        responses whose number is not known."""
        self._most_waiting = 1
        """The most requests with the same transaction id that waited at once."""

    def feed(self, adu: Adu, place: AduPlace | None = None) -> list[Transaction]:
        """Take the next ADU, in order of time; return the transactions that it decides."""
        done = self.advance(adu.start_ns)
        if self._joined and self._requests_lost_ns is None:
            self._requests_lost_ns = adu.start_ns
        take = self._respond if adu.direction is Direction.RESPONSE else self._add_request
        take(adu, place, done)
        return done

    def is_at_rest(self, now_ns: int) -> bool:
        """True if no request is pending. Earlier ones may have got no response: `limits` tells.

        False also if `now_ns` is before the last response.
        """
        reading = self._readings[0]
        is_open = len(self._readings) > 1 or reading.waiting or reading.steps or reading.before > 0
        remembers = not self._dropped.is_empty or self._is_doubtful
        return not (is_open or remembers) and self._habits.last_response_ns <= now_ns

    def limits(self) -> PlainLimits:
        """Return which transactions the array decoder must leave to `feed`, if it is at rest."""
        passed = self._readings[0].passed
        if not (passed or self._unanswered):
            return NO_LIMITS
        adus = [(one.adu, one.counts) for one in passed if one.adu is not None]
        keys = [*(request_key(adu) for adu, counts in adus if counts), *self._unanswered]
        return PlainLimits(
            frozenset(bytes([unit]) + pdu for unit, pdu in keys),
            frozenset((adu.transaction_id, adu.unit, adu.pdu[0]) for adu, _ in adus),
            min((one.since_ns for one in passed), default=2**62) + TIMEOUT_NS,
        )

    def pass_plain(self, stretch: PlainStretch) -> None:
        """Note transactions paired by the array decoder (columns/); no request is pending here."""
        self._requests += len(stretch.transaction_ids)
        last_ns = stretch.responses.last_ns
        self._habits.note_plain(stretch.transaction_ids, self._requests, last_ns)
        for function, latencies in stretch.latencies.items():
            self._habits.note_latencies(function, latencies)
        self.response_is_cut = False
        self._doubt = None
        self._settle_loss(stretch.requests.last_ns)

    def note_loss(
        self, direction: Direction, lost: int, at_ns: int, end: int | None = None
    ) -> list[Transaction]:
        """Note at `at_ns` that the capture lacks `lost` bytes of a direction (0: number unknown).

        `end` is the stream position behind the lost bytes; None if unknown. Returns the
        transactions that this decides, such as those of requests whose responses are lost.
        """
        done: list[Transaction] = []
        self._lost_ns = at_ns
        self._losses.append(self._requests)
        if direction is Direction.REQUEST:
            self._requests_lost_ns = at_ns
            waiting = self._readings[0].waiting
            if not (self._habits.pipelines or any(one.is_pipelined for one in waiting)):
                give_up_late(self._readings, self._habits, at_ns, self._habits.late_ns)
                if end is None:  # Their responses may be lost as well.
                    for reading in self._readings:
                        reading.pass_all(self._habits)
            place = None if end is None else AduPlace(end, None)
            for number in range(min(max(lost // _USUAL_REQUEST, 1), MAX_LOST_REQUESTS)):
                self._open(None, place, at_ns, done)
                is_one = place is not None and not (number and lost % _USUAL_REQUEST)
                self._readings[0].waiting[-1].exists = is_one
            if self._is_lossy and (end is None or lost >= ONE_REQUEST):
                self._doubt_order([])
        else:
            self._note_lost_responses(lost, at_ns)
            self._habits.lost_response_ns = at_ns
        self._settle(done)
        return done

    def advance(self, now_ns: int) -> list[Transaction]:
        """Note that no ADU came until `now_ns`; return the transactions that this decides.

        Requests that have waited longer than TIMEOUT_NS are closed without a response.
        """
        done: list[Transaction] = []
        if len(self._readings) > 1:
            give_up_late(self._readings, self._habits, now_ns, self._habits.silence_ns)
            self._settle(done)
            if len(self._readings) > 1 and now_ns - self._readings[0].steps[0].at_ns > HOLD_NS:
                self._decide(done)
        if len(self._readings) == 1:
            (reading,) = self._readings
            for requests in (reading.passed, reading.waiting):
                while requests and now_ns - requests[0].since_ns > TIMEOUT_NS:
                    self._close(requests.pop(0), done)
        return done

    def note_skipped(self, skipped: Skipped) -> list[Transaction]:
        """Take the next bytes that were not decoded; return the transactions that time out."""
        return self.advance(skipped.ts_ns)

    def close(self, end_ns: int | None = None) -> list[Transaction]:
        """End the connection: return the transactions of the requests that got no response.

        `end_ns` is the end of its capture (a response may have come later), None if it closed.
        """
        done: list[Transaction] = []
        unfinished = {id(one): unfinished_in(one, self._habits, end_ns) for one in self._readings}
        for reading in self._readings:
            ended = unfinished[id(reading)]
            reading.give_up(
                [one for one in reading.waiting if reading.awaits(one) and one.number not in ended]
            )
        self._settle(done)
        self._decide(done)
        (reading,) = self._readings
        rest = _open_in(reading)
        self._readings = [PairReading([], [])]
        for one in rest:
            if one.adu is not None and one.number in unfinished[id(reading)]:
                done.append(capture_ended(self._ends, one.adu))
            else:
                self._close(one, done)
        return done

    def _add_request(self, request: Adu, place: AduPlace | None, done: list[Transaction]) -> None:
        is_pipelined = others_wait = False
        if len(self._readings) > 1 or self._readings[0].waiting:
            give_up_late(self._readings, self._habits, request.start_ns, self._habits.late_ns)
            give_up_repeated(self._readings, self._habits, request)
            is_pipelined = all(reading.someone_waits for reading in self._readings)
            waiting = self._readings[0].waiting
            others_wait = is_pipelined and not all(one.adu is None for one in waiting)
            if not others_wait:
                give_up_lost(self._readings, is_sequential=self._habits.is_sequential)
            if self._habits.is_sequential:
                self._readings = without_pipelined(self._readings)
            self._settle(done)
        elif self._doubt is not None:
            since_ns = request.start_ns - self._habits.last_response_ns
            is_quiet = since_ns > self._habits.silence_ns(request.pdu[0])
            if is_quiet or not (self._doubt.is_of_choice or self._habits.has_pipelined):
                self._doubt = None
        waiting = self._readings[0].waiting
        repeats = (
            bool(waiting)
            and self._requests_lost_ns is not None
            and self._habits.repeats_id(request.transaction_id)
            and any(one.adu is None for one in waiting)
        )
        self._habits.note_request(request.transaction_id, others_wait=others_wait)
        self._open(request, place, request.end_ns, done, is_pipelined=is_pipelined)
        one = self._readings[0].waiting[-1]
        one.repeats_lost_id = repeats

    def _open(
        self,
        request: Adu | None,
        place: AduPlace | None,
        at_ns: int,
        done: list[Transaction],
        *,
        is_pipelined: bool = False,
    ) -> None:
        if len(self._readings[0].waiting) >= MAX_OPEN_REQUESTS:
            self._drop_oldest(at_ns, done)
        self._requests += 1
        one = OpenRequest(
            number=self._requests,
            since_ns=at_ns,
            adu=request,
            place=place,
            is_pipelined=is_pipelined,
            counts=request is not None and not request.missing,
        )
        if self._readings[0].waiting:
            self._note_next(self._readings[0].waiting[-1], request, at_ns)
        for reading in self._readings:
            if reading.waiting and reading.someone_waits:
                reading.behind_others.add(one.number)
            reading.waiting.append(one)
            reading.forget_closed()
        is_more = len(self._readings[0].waiting) > self._most_waiting
        if is_more and not self._habits.ids_count_up:
            self._most_waiting = max(self._same_id(one), self._most_waiting)
        if self._doubt is not None:
            self._doubt.note_request(one)

    def _same_id(self, request: OpenRequest) -> int:
        """Return how many waiting requests have the transaction id of one of them."""
        waiting = self._readings[0].waiting
        if not self._habits.ids_vary:
            return len(waiting)
        if request.adu is None:
            return sum([one.adu is None for one in waiting])
        same = request.adu.transaction_id
        return sum([one.adu is not None and one.adu.transaction_id == same for one in waiting])

    def _drop_oldest(self, now_ns: int, done: list[Transaction]) -> None:
        """Remove the oldest of too many waiting requests, and add its transaction to `done`."""
        self._decide(done)
        oldest = self._readings[0].waiting.pop(0)
        if oldest.adu is None or (
            self._habits.is_sequential and oldest.number in self._readings[0].given_up
        ):
            self._close(oldest, done)
            return
        self._dropped.note(oldest.adu, now_ns)
        done.append(response_not_captured(self._ends, oldest.adu, (Verdict.OVER_LIMIT,)))

    def _respond(self, response: Adu, place: AduPlace | None, done: list[Transaction]) -> None:
        if self._dropped.take_response(response):
            self._respond_to_dropped(response, done)
            return
        first = self._readings[0]
        is_only_one = len(self._readings) == 1
        since_ns = self._habits.last_response_ns
        if is_only_one and first.is_only_answered_by(response, place):
            # Usually one request waits. This shortcut makes pairing an ADU take 8 instead of 13 us.
            one = first.waiting.pop()
            self._habits.last_response_ns = response.end_ns
            done.append(self._answered_transaction(response, one, since_ns, place))
            return
        overlaps = len(first.waiting) > 1 and sum(first.awaits(one) for one in first.waiting) > 1
        found: list[tuple[float, PairReading, PairOption]] = []
        for reading in self._readings:
            best, *others = self._options(reading, response, place, is_only_one=is_only_one)
            cost = likely_cost(reading)
            found += [(cost + option.likely_cost(reading), reading, option) for option in others]
            found.append((cost + best.likely_cost(reading), reading, best))
        taken = _likeliest(found, most_readings(len(first.waiting)))
        self._readings = []
        for _, reading, option in taken:
            other = reading.copy() if len(taken) > 1 else reading
            other.take(option, response, self._habits, since_ns, place)
            if len(taken) < len(found):
                other.steps = (*other.steps[:-1], other.steps[-1]._replace(is_sure=False))
            self._readings.append(other)
        self._habits.last_response_ns = response.end_ns
        self._settle(done)
        if overlaps and len(self._readings) == 1:
            self._habits.note_overlap()

    def _respond_to_dropped(self, response: Adu, done: list[Transaction]) -> None:
        self._decide(done)
        verdicts = (*response.verdicts, Verdict.OVER_LIMIT)
        over_limit = msgspec.structs.replace(response, verdicts=verdicts)
        done.append(unsolicited(self._ends, over_limit, Outcome.NOT_CAPTURED))
        self._habits.last_response_ns = response.end_ns

    def _options(
        self, reading: PairReading, response: Adu, place: AduPlace | None, *, is_only_one: bool
    ) -> list[PairOption]:
        found = [*options(reading, response, place, self._habits)]
        is_before = all(option.request is REQUEST_BEFORE for option in found)
        if found and is_before and is_only_one:
            one = self._request_with_other_id(reading, response, place)
            if one is not None and one.transaction_id == response.transaction_id:
                if self._habits.ids_vary:
                    return [PairOption(0.0, one)]
                one.may_be_lost = True  # This may be its response.
        if found:
            limit = min(option.cost for option in found) + MARGIN
            return [option for option in found if option.cost <= limit]
        if (
            is_only_one
            and (one := self._request_with_other_id(reading, response, place)) is not None
        ):
            return [PairOption(0.0, one)]
        return [PairOption(UNASKED, None)]

    def _request_with_other_id(
        self, reading: PairReading, response: Adu, place: AduPlace | None
    ) -> OpenRequest | None:
        """Return the request that a response with another id answers; None if that is doubtful.

        It is doubtful if an earlier request may have no response yet: a slave that is late
        acknowledges a new request with the response to an earlier one.
        """
        requests = [*reading.passed, *reading.waiting]
        if len(requests) > 1 and self._habits.ids_vary:
            same = response.transaction_id
            requests = [one for one in requests if one.transaction_id == same]
        if len(requests) != 1:
            return None
        (one,) = requests
        is_same_id = one.transaction_id == response.transaction_id
        if not one.can_get(response, place, with_other_unit=is_same_id):
            return None
        if is_same_id:  # Then the units differ.
            is_next = place is None or one.is_next_to(response, place)
            is_sure = is_next and reading.awaits(one) and not one.may_be_lost
            return one if is_sure and one.fits(response) else None
        began_before = self._joined and not self._habits.has_answered
        if began_before or self._is_near_loss(self._lost_ns, response):
            return None
        is_doubtful = self._habits.has_matching_ids or one.may_be_lost or not reading.awaits(one)
        if is_doubtful and not one.is_next_to(response, place):
            return None
        return one if one.fits(response) else None

    @staticmethod
    def _is_near_loss(lost_ns: int | None, response: Adu) -> bool:
        """True if a response may answer a request from the time at which the capture lost bytes."""
        return lost_ns is not None and response.start_ns - lost_ns <= TIMEOUT_NS

    def _note_lost_responses(self, lost: int, at_ns: int) -> None:
        runs: list[tuple[float, float, int, int, PairReading]] = []
        is_counted = True
        for reading in self._readings:
            found = [
                (reading.cost + cost, cost, start, count, reading)
                for cost, start, count in self._lost_runs(reading, lost)
            ]
            if not found:
                is_counted &= reading.has_different_ids(self._habits)
                open_ = _open_in(reading)
                for one in open_:
                    one.may_be_lost |= not lost or may_be_among(lost, one, open_)
                found = [(reading.cost, 0.0, 0, 0, reading)]
            runs += found
        limit = min(total for total, *_ in runs) + MARGIN
        is_counted = is_counted and sum(total <= limit for total, *_ in runs) == 1
        if self._is_lossy and not is_counted:
            self._doubt_order(_open_in(self._readings[0]), others_answered=self._doubt is None)
        if len(runs) == 1 and not runs[0][3]:
            return
        runs = [run for run in runs if run[0] <= limit]
        taken = _likeliest(runs, most_readings(len(self._readings[0].waiting)))
        self._readings = []
        for _, cost, start, count, reading in taken:
            if len(taken) < len(runs):
                for one in reading.waiting[: max(start + count for *_, start, count, _ in runs)]:
                    one.may_be_lost = True
            other = reading.copy()
            other.suppose_lost_responses(start, count, cost, at_ns)
            self._readings.append(other)

    def _doubt_order(self, open_: list[OpenRequest], *, others_answered: bool = False) -> None:
        """Doubt the order anew after a loss; a doubt that a choice began stays one."""
        was_of_choice = self._doubt is not None and self._doubt.is_of_choice
        self._doubt = OrderDoubt(open_, others_answered=others_answered, is_of_choice=was_of_choice)

    def _lost_runs(self, reading: PairReading, lost: int) -> Iterator[tuple[float, int, int]]:
        """Find the waiting requests whose responses can be `lost` bytes, as `lost_runs` does.

        Finds none if all ids differ: then the ids of later responses show which ones are lost.
        """
        if not reading.has_different_ids(self._habits):
            yield from lost_runs(reading, lost)

    def _settle(self, done: list[Transaction]) -> None:
        """Drop costly ways to pair. If only one is left, add its transactions to `done`."""
        if len(self._readings) > 1:
            self._readings = without_costly(self._readings)
        first = self._readings[0]
        if len(self._readings) == 1:
            self._emit_transactions(first.steps, done)
            first.steps = ()
        elif len(first.steps) > MAX_HELD:
            self._decide(done)

    def _decide(self, done: list[Transaction]) -> None:
        """Keep the cheapest way to pair. Pairs that another remaining way lacks are ambiguous."""
        if not self._habits.has_pipelined:
            self._readings = without_pipelined(self._readings)
        best, *others = sorted(self._readings, key=likely_cost)
        steps = best.steps
        for other in others:
            steps = tuple(
                one if one.requests == two.requests else one._replace(is_sure=False)
                for one, two in zip(steps, other.steps, strict=True)
            )
        self._readings = [best]
        best.steps = ()
        self._emit_transactions(steps, done)
        if others:
            self._doubt = OrderDoubt(_open_in(best), is_of_choice=True)

    def _emit_transactions(self, steps: tuple[PairStep, ...], done: list[Transaction]) -> None:
        (reading,) = self._readings
        for step in steps:
            if step.response is not None:
                done.append(self._transaction_of(step.response, step))
                self._mark_others_answerable(step.response, step)
                continue
            for one in step.requests:
                if one.adu is not None:
                    done.append(response_not_captured(self._ends, one.adu))
        while len(reading.passed) > MAX_PASSED:
            self._close(reading.passed.pop(0), done)

    def _mark_others_answerable(self, response: Adu, step: PairStep) -> None:
        """Note that open requests may have got `response`, if that is not known for a loss."""
        is_lost = bool(step.requests) and step.requests[0].adu is None
        is_doubtful = not step.is_sure or self._is_doubtful
        if not (is_lost or (is_doubtful and self._is_near_loss(self._lost_ns, response))):
            return
        (reading,) = self._readings
        for one in (*reading.passed, *reading.waiting):
            is_same_id = one.transaction_id == response.transaction_id
            if is_same_id and one.can_get(response, step.place):
                one.may_be_answered = True

    def _transaction_of(self, response: Adu, step: PairStep) -> Transaction:
        if not step.requests:
            outcome = Outcome.UNSOLICITED
            if self._may_lack_request_of(response):
                outcome = Outcome.NOT_CAPTURED
            return unsolicited(self._ends, response, outcome)
        return self._answered_transaction(
            response,
            step.requests[0],
            step.since_ns,
            step.place,
            is_sure=step.is_sure,
            is_late=step.is_late,
        )

    def _may_lack_request_of(self, response: Adu) -> bool:
        """True if the capture may lack the request of a response that no captured one asked for."""
        if not self._requests:
            return self._joined
        return self._is_near_loss(self._requests_lost_ns, response)

    def _answered_transaction(
        self,
        response: Adu,
        one: OpenRequest,
        since_ns: int,
        place: AduPlace | None,
        *,
        is_sure: bool = True,
        is_late: bool = False,
    ) -> Transaction:
        """Make the transaction of request `one`; the previous response ended at `since_ns`."""
        if one.adu is None:
            return unsolicited(self._ends, response, Outcome.NOT_CAPTURED)
        verdicts: tuple[Verdict, ...] = ()
        if one.adu.transaction_id == response.transaction_id:
            self._habits.has_matching_ids |= self._habits.ids_vary
        else:
            verdicts = (Verdict.OTHER_TRANSACTION_ID,)
        if one.adu.unit != response.unit:
            verdicts += (Verdict.OTHER_UNIT,)
        if self._doubt is not None:
            self._doubt.exclude_shifts(response, place, one, self._most_waiting)
            is_sure = is_sure and not self._is_doubtful
        if not is_sure:
            verdicts += (Verdict.AMBIGUOUS,)
        elif response.start_ns >= one.adu.end_ns and not is_late:
            latency_ns = response.start_ns - max(one.adu.end_ns, since_ns)
            self._habits.note_latency(one.adu.pdu[0], latency_ns)
        if is_sure and not is_late:
            self._habits.note_answered(one.number)
            self._settle_loss(one.adu.start_ns)
        retries, confidence = self._take_retries(one), 1.0 if is_sure else DOUBTFUL
        done = with_response(self._ends, one.adu, response, retries, verdicts, confidence)
        return late(done) if self._was_given_up(one) else done

    def _settle_loss(self, answered_ns: int) -> None:
        """Forget the last loss if no response to a request from before it can come any more.

        Slaves respond in order. So none can come once the slave has responded to a request that was
        sent after the loss, if the master never has two requests open.
        """
        habits = self._habits
        if self._lost_ns is None or habits.has_pipelined or habits.reorders:
            return
        if answered_ns > self._lost_ns:
            self._lost_ns = None

    @property
    def _is_lossy(self) -> bool:
        """True if the capture lacked bytes MANY_LOSSES times within the last NEAR_REQUESTS."""
        losses = self._losses
        return len(losses) == MANY_LOSSES and self._requests - losses[0] <= NEAR_REQUESTS

    @property
    def _is_doubtful(self) -> bool:
        """True if responses may belong to other requests than those that they are paired with.

        If ids count up, each request has an id of its own. A master that never pipelined has one
        request open, whatever the number of lost ones.
        """
        doubt, habits = self._doubt, self._habits
        if doubt is None:
            return False
        if not doubt.is_of_choice and (habits.ids_count_up or not habits.has_pipelined):
            return False
        if doubt.is_settled(self._most_waiting):
            self._doubt = None
        return self._doubt is not None

    def _was_given_up(self, one: OpenRequest) -> bool:
        """True if the master sent its next request because it no longer waited for this one."""
        if one.next_ns is None or not self._habits.is_sequential:
            return False
        waited_ns = one.next_ns - one.since_ns
        if waited_ns < FIRST_LATE_NS:
            return False
        equal = [
            each for each in self._waits if abs(each - waited_ns) <= WAIT_TOLERANCE * waited_ns
        ]
        return one.is_repeated or len(equal) >= ENOUGH_WAITS

    def _note_next(self, one: OpenRequest, request: Adu | None, at_ns: int) -> None:
        """Note that a request was sent at `at_ns` (UTC ns) while `one` had no response."""
        one.next_ns = at_ns
        if request is not None and one.adu is not None:
            one.is_repeated = request_key(request) == request_key(one.adu)
        if at_ns - one.since_ns >= FIRST_LATE_NS:
            self._waits.append(at_ns - one.since_ns)

    def _take_retries(self, answered: OpenRequest) -> int:
        """Count the unanswered requests that `answered` repeats; no later request counts them."""
        (reading,) = self._readings
        if not (self._unanswered or reading.passed or reading.waiting):
            return 0
        assert answered.adu is not None
        key = request_key(answered.adu)
        retries = self._unanswered.take(answered.adu)
        for requests in (reading.passed, reading.waiting):
            for earlier in requests:
                if earlier.number > answered.number:
                    break
                if earlier.counts and earlier.adu is not None and request_key(earlier.adu) == key:
                    earlier.counts = False
                    retries += not earlier.may_be_lost
        return retries

    def _close(self, one: OpenRequest, done: list[Transaction]) -> None:
        """Add the transaction of request `one` without response, if it was captured, to `done`."""
        if one.adu is None:
            return
        is_excused = one.may_be_lost or one.may_be_answered or one.adu.missing > 0
        if is_excused or self.response_is_cut:
            done.append(response_not_captured(self._ends, one.adu))
            return
        retries = self._unanswered.add(one.adu) if one.counts else 0
        done.append(no_answer(self._ends, one.adu, retries))


def _open_in(reading: PairReading) -> list[OpenRequest]:
    """Return the requests of a reading that have no response, in the order of their sending."""
    return sorted((*reading.passed, *reading.waiting), key=lambda one: one.number)


def _likeliest(found: list[_Costed], most: int) -> list[_Costed]:
    """Return the cheapest of some ways to pair, at most `most`, in the given order.

    The first field of each is its cost.
    """
    if len(found) <= most:
        return found
    cheapest = sorted(range(len(found)), key=lambda place: found[place][0])[:most]
    return [found[place] for place in sorted(cheapest)]
