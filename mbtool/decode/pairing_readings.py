"""Weighs the ways in which a connection's responses can belong to its requests."""

# A reading is one way to assign each response to a request, and lost response bytes to the requests
# that they answered. A response can answer a request with its id, unit and function.
# Acknowledgements rule out requests that the slave had not received, and requests that were sent
# after the response had been received. Among requests with the same id, a slave answers the oldest
# first.
#
# The unit of costs is one request that the slave leaves unanswered, or answers after its master has
# given it up: both are rare, and about equally so.
#
# If the capture begins within the connection, its first responses may answer requests sent before
# the capture. A reading has room for at most MAX_BEFORE of these unknown requests. They come before
# all captured requests, so after the first response to a captured request there can be no more of
# them.
#
# Readings that cost MARGIN more than the cheapest one are dropped. If two readings leave the same
# requests waiting, no later ADU can tell them apart: the cheaper one is kept, and the pairs that
# only one of them has are ambiguous.
#
# Memory: at most MAX_READINGS readings, each with the requests that wait and MAX_PASSED earlier
# ones that got no response.

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction
from mbtool.decode.open_requests import SMALLEST_RESPONSE, OpenRequest
from mbtool.modbus.pdu import parse_pdu

if TYPE_CHECKING:
    from mbtool.decode.master_habits import MasterHabits
    from mbtool.decode.stream_progress import AduPlace
    from mbtool.modbus.adu import Adu

LATE = 1.0
"""The cost of a request that its master gives up: the unit of all costs here."""
UNANSWERED = 1.2
"""The cost (in units of LATE) of a request that gets no response before a later request gets its
own. It must exceed 2 * LATE - MARGIN: if the late response to request A comes after request B, and
B is then given up too, this reading costs 2 * LATE and must not be dropped in favour of the reading
in which the response answers B (cost UNANSWERED)."""
UNLIKELY = 0.25
"""Extra cost (in units of LATE) of a response to a given-up request. Only used to choose between
ways to pair that cost about the same."""
MARGIN = 0.9
"""A way to pair (a reading) is dropped if it costs this much more (in units of LATE) than the
cheapest. Less than LATE, so that the responses to pipelined requests are not held back."""
MISFIT = 2.0
"""The cost (in units of LATE) of a response whose form does not fit its request."""
OUT_OF_ORDER = 2.0
"""Extra cost (in units of LATE) of a response to a request when a later request already has its
response."""
UNASKED = 6.0
"""The cost (in units of LATE) of a response that no request asked for. It is high, so that a
response goes to any request that it can answer."""
TOO_EARLY = 1.0
"""Extra cost (in units of LATE) of a response in less than half the shortest latency that responses
with this function code had so far."""
TOO_SLOW = 0.5
"""Extra cost (in units of LATE) of a response that takes longer than `MasterHabits.slow_ns`, if its
request is not given up."""
OTHER_ID = 4.0
"""The cost (in units of LATE) of a response to a request that the capture lacks, although a
captured request with the same id waits."""
NOT_LIKELY = 0.95
"""The cost (in units of LATE) of a response to a request that the capture lacks, if it is doubtful
that this request was sent. More than MARGIN, so that a captured request gets the response if it
can."""

BEFORE = 0.6
"""The cost (in units of LATE) of the first response to a request before the capture, if a captured
request may also get it: few masters pipeline. Less than MARGIN, so that later ADUs decide."""
AGAIN_BEFORE = 0.01
"""The cost (in units of LATE) of each further response to a request before the capture. With BEFORE
it stays below MARGIN for MAX_BEFORE responses."""

MAX_BEFORE = 16
"""The greatest number of responses that may answer requests from before the capture, if the
capture lacks the beginning of their connection."""
MAX_LATE = 4
"""A response may go to one of at most this many given-up requests, the newest ones. With the
request that waits this gives fewer than MAX_READINGS ways to pair, so that no reading of equal cost
is dropped."""
MAX_COPIED = 40 * MAX_BEFORE
"""The most waiting requests in all readings that are made for one response or loss: 40 readings of
16 requests, but LEAST_READINGS of 100. If there are more within MARGIN, the pairs are ambiguous."""
LEAST_READINGS = MAX_LATE + 2
MAX_LOST_RUNS = 16
"""For lost bytes of responses, about this many choices of the requests that they answered are
tried, those with the earliest requests first, as a slave answers in order. More would take too long
in a connection that is not Modbus."""
MAX_READINGS = 20
"""At most this many readings (ways to pair) are kept, the cheapest ones."""
MAX_PASSED = 64
"""At most this many given-up requests of a reading can still get a late response; older ones are
closed."""
MAX_NUMBERS = 1024
"""If a reading remembers the numbers of more requests than this, those of closed requests are
forgotten. At most 320 requests are open, so that this is done rarely."""
MAX_LOST_RESPONSES = 8
"""Lost bytes are taken for at most this many responses. This limits the number of combinations of
response lengths that are tried."""


class PairStep(NamedTuple):
    """One step of a reading: a response, or lost response bytes, and the requests they answer."""

    at_ns: int
    response: Adu | None
    """The response of this step; None if the step is response bytes that the capture lacks."""
    requests: tuple[OpenRequest, ...]
    """The requests that the response, or the lost bytes, answer. Empty if no request asked for the
    response; several only if the capture lacks responses."""
    since_ns: int = 0
    """The time (ns) at which the response before this one was complete; 0 if there was none."""
    is_sure: bool = True
    is_late: bool = False
    """True if the request was given up before the response came."""
    place: AduPlace | None = None
    """The position of the response in the connection; None if unknown."""


class PairOption(NamedTuple):
    """A request that a response may answer, and the cost (in units of LATE) of this choice.

    The request is None if no request asked for the response.
    """

    cost: float
    request: OpenRequest | None

    def likely_cost(self, reading: PairReading) -> float:
        """The cost (in units of LATE) that the option adds to the `likely_cost` of a reading."""
        is_late = self.request is not None and self.request.number in reading.given_up
        return self.cost + UNLIKELY * is_late


REQUEST_BEFORE = OpenRequest(number=0, since_ns=0, adu=None)
"""Stands for each request that was sent before the capture began."""


class PairReading:
    """A reading: one way to join the requests and responses whose pairing is not decided yet."""

    __slots__ = (
        "before",
        "behind_others",
        "cost",
        "gave_up_ns",
        "given_up",
        "newest",
        "passed",
        "steps",
        "used_before",
        "waiting",
    )

    def __init__(
        self,
        waiting: list[OpenRequest],
        passed: list[OpenRequest],
        steps: tuple[PairStep, ...] = (),
        cost: float = 0.0,
        newest: int = 0,
        given_up: Iterable[int] = (),
        behind_others: Iterable[int] = (),
        gave_up_ns: int = 0,
        before: int = 0,
        *,
        used_before: bool = False,
    ) -> None:
        self.waiting = waiting
        """Requests that wait for a response, in the order in which they were sent."""
        self.passed = passed
        """Requests without a response that were sent before an answered request. A late response to
        them may still come."""
        self.steps = steps
        self.cost = cost
        self.newest = newest
        """The highest number of a request that got its response from `waiting` while another
        request had none yet; 0 if there was none. Requests of a connection are counted from 1."""
        self.given_up = set(given_up)
        """The numbers of the requests for whose responses the master waits no longer, or whose
        responses are overdue."""
        self.gave_up_ns = gave_up_ns
        """The time (ns) at which a request was last marked as given up."""
        self.behind_others = set(behind_others)
        """The numbers of the requests that were sent while the master waited for other
        responses."""
        self.before = before
        """The most responses that may still answer requests before the capture."""
        self.used_before = used_before
        """True if a response answers a request before the capture, and a captured request waited
        for its own."""

    @property
    def someone_waits(self) -> bool:
        """True if the master waits for a response to any request."""
        return any(self.awaits(one) for one in reversed(self.waiting))  # The newest most likely.

    def awaits(self, one: OpenRequest) -> bool:
        """True if the master waits for the response to this request."""
        return not (one.number in self.given_up or one.may_not_exist)

    def give_up(self, late: list[OpenRequest]) -> None:
        """Note that the master no longer waits for the responses to the requests `late`."""
        self.given_up.update(one.number for one in late)
        self.cost += LATE * sum(not one.may_be_lost for one in late)

    def forget_closed(self) -> None:
        """Forget the numbers of requests that are closed, once MAX_NUMBERS are remembered."""
        if max(len(self.given_up), len(self.behind_others)) > MAX_NUMBERS:
            numbers = {one.number for one in (*self.passed, *self.waiting)}
            self.given_up &= numbers
            self.behind_others &= numbers

    def has_different_ids(self, habits: MasterHabits) -> bool:
        """True if several requests wait for responses, and each has its own transaction id."""
        ids = [None if one.adu is None else one.adu.transaction_id for one in self.waiting]
        is_known = habits.ids_vary or None not in ids
        return is_known and len(ids) > 1 and len(set(ids)) == len(ids)

    def is_only_answered_by(self, response: Adu, place: AduPlace | None) -> bool:
        """True if only one request has no response yet, and `response` can belong to it.

        `place` is the position of the response in the connection; None if unknown.
        """
        if len(self.waiting) != 1 or self.passed or self.before:
            return False
        (one,) = self.waiting
        return _has_id(one, response) and one.can_get(response, place)

    def copy(self) -> PairReading:
        return PairReading(
            [*self.waiting],
            [*self.passed],
            self.steps,
            self.cost,
            self.newest,
            self.given_up,
            self.behind_others,
            self.gave_up_ns,
            self.before,
            used_before=self.used_before,
        )

    def take(
        self,
        option: PairOption,
        response: Adu,
        habits: MasterHabits,
        since_ns: int,
        place: AduPlace | None = None,
    ) -> None:
        """Assign a response to the request of an option, and add the option's cost.

        `since_ns` is the time at which the response before this one was complete; `place` is the
        position of the response in the connection, None if unknown.
        """
        self.cost += option.cost
        request = option.request
        if request is None:
            self.steps += (PairStep(response.end_ns, response, (), since_ns, place=place),)
            return
        is_late = request.number in self.given_up
        step = PairStep(
            response.end_ns, response, (request,), since_ns, is_late=is_late, place=place
        )
        self.steps += (step,)
        if request is REQUEST_BEFORE:
            self.before -= 1
            self.used_before = self.used_before or bool(self.waiting)
            return
        self.before = 0
        if request in self.passed:
            self.passed.remove(request)
        else:
            self._pass_over(self.waiting.index(request), request, habits)
            self.waiting.remove(request)
            self.newest = max(request.number, self.newest)

    def suppose_lost_responses(self, start: int, count: int, cost: float, at_ns: int) -> None:
        """Suppose that lost bytes answered the requests `waiting[start : start + count]`.

        `cost` (in units of LATE) is added to the reading's cost; `at_ns` is the time at which the
        loss was noticed.
        """
        lost = tuple(self.waiting[start : start + count])
        self.cost += cost
        self.steps += (PairStep(at_ns, None, lost),)
        if count:
            self.before = 0
        elif self.before:
            self.used_before = self.used_before or bool(self.waiting)
            return
        self.passed += [one for one in self.waiting[:start] if one.adu is not None]
        self.waiting = self.waiting[start + count :]
        if any(one.adu is None for one in lost):
            for one in self.waiting:
                # The lost bytes may have answered more, or fewer, requests that the capture lacks.
                one.may_not_exist = one.may_not_exist or not one.exists

    def pass_all(self, habits: MasterHabits) -> None:
        """Move the waiting requests to `passed`, as the capture may lack their responses.

        A late response can still be assigned to them there. A request stays in `waiting` if no lost
        request can have its transaction id.
        """
        kept = [one for one in self.waiting if habits.has_own_id(one, self.waiting)]
        self.passed += [one for one in self.waiting if one.adu is not None and one not in kept]
        self.waiting = kept

    def _pass_over(self, place: int, request: OpenRequest, habits: MasterHabits) -> None:
        earlier = self.waiting[:place]
        captured = [one for one in earlier if one.adu is not None]
        if habits.is_sequential:
            kept = []
        elif request.adu is None:
            kept = earlier if habits.ids_vary else []
        else:  # A slave answers requests with the same transaction id in their order.
            same = request.adu.transaction_id
            kept = [
                one
                for one in earlier
                if (habits.ids_vary if one.adu is None else one.adu.transaction_id != same)
            ]
        left = {one.number for one in kept}
        self.passed += [one for one in captured if one.number not in left]
        self.waiting[:place] = kept


def options(
    reading: PairReading, response: Adu, place: AduPlace | None, habits: MasterHabits
) -> Iterator[PairOption]:
    """Yield the requests of a reading that a response may answer, each with its cost (see LATE).

    `place` is the position of the response in the connection; None if unknown. Behind more options
    than readings can be made of (`most_readings`), only cheaper ones are yielded.
    """
    most, cheap = most_readings(len(reading.waiting)), 0
    if reading.before:
        yield PairOption(_cost_before(response, reading, habits), REQUEST_BEFORE)
    too_late = _too_late(reading, response, place)
    has_id = _CapturedIds(reading, response, habits)
    passed = _PassedOver(reading, response, habits)
    best = UNASKED
    alike = dict.fromkeys(range(4), 0)
    for one in reading.waiting:
        if one.adu is None:
            kind = one.may_not_exist + 2 * (one.number < has_id.last)
            alike[kind] += 1
            if alike[kind] > most + 1:
                passed.add(one)  # Not cheaper than the ones like it before.
                continue
        if _has_id(one, response) and one.can_get(response, place) and one.number not in too_late:
            before = passed.cost_to(one)
            cost = before + _response_cost(one, response, reading, habits, has_id)
            best = min(best, cost)
            yield PairOption(cost, one)
            cheap += cost <= before
            if before > best + MARGIN or cheap > most:
                return
        passed.add(one)
    if best + MARGIN < OUT_OF_ORDER:
        return  # A request in `passed` would cost more.
    for one in reading.passed:
        if _has_id(one, response) and one.can_get(response, place):
            cost = OUT_OF_ORDER + _response_cost(one, response, reading, habits, has_id)
            yield PairOption(cost, one)


def _cost_before(response: Adu, reading: PairReading, habits: MasterHabits) -> float:
    """Return the cost (in units of LATE) of a response to a request before the capture."""
    if not reading.waiting:
        return 0.0
    if _CapturedIds(reading, response, habits).last:
        return OTHER_ID
    cost = AGAIN_BEFORE if reading.used_before else BEFORE
    is_damaged = not response.missing and parse_pdu(response.pdu, Direction.RESPONSE).problem
    return cost + MISFIT if is_damaged else cost


def _too_late(reading: PairReading, response: Adu, place: AduPlace | None) -> set[int]:
    """Return the numbers of the given-up requests that are too old to get this response.

    The newest MAX_LATE given-up requests that the response fits by id, unit and function can get
    it. `place` is the position of the response in the connection; None if unknown.
    """
    late = [
        one for one in reading.waiting if one.number in reading.given_up and one.adu is not None
    ]
    if len(late) > MAX_LATE:
        late = [one for one in late if _has_id(one, response) and one.can_get(response, place)]
    return {one.number for one in late[:-MAX_LATE]}


def _has_id(one: OpenRequest, response: Adu) -> bool:
    return one.adu is None or one.adu.transaction_id == response.transaction_id


class _PassedOver:
    """The costs (in units of LATE) if a later request gets a response and earlier ones do not.

    A slave answers requests with the same transaction id in their order.
    """

    def __init__(self, reading: PairReading, response: Adu, habits: MasterHabits) -> None:
        self._reading, self._habits = reading, habits
        self._transaction_id = response.transaction_id
        self._late = 0
        self._costs = {True: [0.0, 0.0], False: [0.0, 0.0]}
        """By whether the later request was captured: what is lost for good, and what the slave may
        still answer in another order."""

    def add(self, one: OpenRequest) -> None:
        """Pass over one more request."""
        if one.number in self._reading.given_up:
            if self._late == MAX_LATE:
                return
            self._late += 1
        cost = _cost_of_passing(one, self._reading)
        if not cost:
            return
        ids_vary = self._habits.ids_vary
        is_captured = one.adu is not None
        has_id = one.transaction_id == self._transaction_id if is_captured else not ids_vary
        for is_to_captured, is_before in ((True, has_id), (False, not ids_vary)):
            if is_before:
                self._costs[is_to_captured][0] += cost
            elif is_captured and not self._habits.reorders:
                self._costs[is_to_captured][1] += cost

    def cost_to(self, chosen: OpenRequest) -> float:
        same, others = self._costs[chosen.adu is not None]
        return same + min(others, UNANSWERED)


def _cost_of_passing(one: OpenRequest, reading: PairReading) -> float:
    if one.may_be_lost or one.may_not_exist:
        return 0.0
    return UNANSWERED - LATE if one.number in reading.given_up else UNANSWERED


def _response_cost(
    one: OpenRequest,
    response: Adu,
    reading: PairReading,
    habits: MasterHabits,
    has_id: _CapturedIds,
) -> float:
    if one.adu is None:
        if one.number < has_id.last:
            return OTHER_ID
        return NOT_LIKELY if one.may_not_exist else 0.0
    cost = 0.0 if one.fits(response) else MISFIT
    if habits.is_too_early(one.adu.pdu[0], response.start_ns - one.adu.end_ns):
        return cost + TOO_EARLY
    since_ns = max(one.since_ns, habits.got_response_until_ns)
    is_slow = response.start_ns - since_ns > habits.slow_ns(one.function)
    return cost + TOO_SLOW if is_slow and one.number not in reading.given_up else cost


class _CapturedIds:
    """The captured requests with a response's id that no request which the capture lacks can have.

    Looked for when it is first asked.
    """

    def __init__(self, reading: PairReading, response: Adu, habits: MasterHabits) -> None:
        self._reading, self._response, self._habits = reading, response, habits

    @cached_property
    def last(self) -> int:
        """The number of the last one, more than any number if one is awaited; 0 if there is none.

        No lost request with a smaller number gets the response.
        """
        return max(self._numbers(), default=0)

    def _numbers(self) -> Iterator[int]:
        """Give the numbers of these requests; for one that is awaited, more than any other has."""
        habits, reading = self._habits, self._reading
        if not (habits.ids_count_up or habits.ids_vary):
            return  # The master sends one id, so any lost request has it.
        for one in (*reading.waiting, *reading.passed):
            if (
                one.adu is not None
                and one.adu.transaction_id == self._response.transaction_id
                and not one.repeats_lost_id
                and habits.has_own_id(one, reading.waiting)
            ):
                yield one.number if one.number in reading.given_up else sys.maxsize


def may_be_among(lost: int, one: OpenRequest, waiting: list[OpenRequest]) -> bool:
    """True if `lost` missing bytes can be the response to request `one`, alone or with others.

    `waiting` are all waiting requests, `one` among them. The sum of response lengths must be equal
    to `lost`.
    """
    if len(waiting) > MAX_LOST_RESPONSES:
        return True
    sums = {0}
    for other in waiting:
        if other.adu is None:
            return True
        if other is not one:
            sizes = other.response_sizes()
            sums |= {total + size for total in sums for size in sizes}
    sizes = one.response_sizes()
    return not sizes or any(lost - size in sums for size in sizes)


def lost_runs(reading: PairReading, lost: int) -> Iterator[tuple[float, int, int]]:
    """Find waiting requests in a row whose responses can have `lost` bytes in total.

    For each such row, yields the cost of the earlier requests that it passes over (in units of
    LATE), the index in `waiting` of its first request, and the number of its requests. The first
    lost bytes may answer requests before the capture; then the number may be 0.
    """
    cost = 0.0
    waiting = reading.waiting
    if reading.before:
        for count in _counts_below(waiting[:MAX_LOST_RESPONSES], lost):
            yield AGAIN_BEFORE if reading.used_before else BEFORE, 0, count
    found = 0
    for start, first in enumerate(waiting):
        for count in _counts_in(waiting[start : start + MAX_LOST_RESPONSES], lost):
            found += 1
            yield cost, start, count
        cost += _cost_of_passing(first, reading)
        if cost > UNASKED or found >= MAX_LOST_RUNS:
            return


def _counts_in(waiting: list[OpenRequest], lost: int) -> Iterator[int]:
    """Yield each n for which the responses to the first n requests can have `lost` bytes in total.

    A request that the capture lacks has a response of any length from SMALLEST_RESPONSE on.
    """
    sums = {0}
    any_size = 0
    for count, one in enumerate(waiting, 1):
        if one.adu is None:
            any_size += SMALLEST_RESPONSE
        else:
            sizes = one.response_sizes()
            sums = {total + size for total in sums for size in sizes}
        if min(sums, default=lost) + any_size > lost:
            return
        if lost in sums or (any_size and sums):
            yield count


def _counts_below(waiting: list[OpenRequest], lost: int) -> Iterator[int]:
    """Yield 0 and each n for which the responses to the first n requests can have less than `lost`
    bytes, so that the other bytes are at least one response.
    """
    sums = {0}
    for count in range(len(waiting) + 1):
        if not any(total + SMALLEST_RESPONSE <= lost for total in sums):
            return
        yield count
        if count < len(waiting):
            sizes = waiting[count].response_sizes() or (SMALLEST_RESPONSE,)
            sums = {total + size for total in sums for size in sizes}


def without_costly(readings: list[PairReading]) -> list[PairReading]:
    """Return the readings (ways to pair) that cost at most MARGIN more than the cheapest one.

    Of several readings with the same waiting requests only the cheapest one is returned; its pairs
    that the other readings lack become ambiguous. At most MAX_READINGS and `most_readings` are
    returned; the pairs of the cheapest that the dropped ones lack become ambiguous, too.
    """
    limit = min(reading.cost for reading in readings) + MARGIN
    most = min(most_readings(len(readings[0].waiting)), MAX_READINGS)
    kept: dict[tuple[int, ...], PairReading] = {}
    for reading in sorted(readings, key=likely_cost):
        if reading.cost > limit:
            continue
        key = (reading.before, *[one.number for one in reading.waiting])
        if key in kept:
            _mark_differences(kept[key], reading)
        elif len(kept) < most:
            kept[key] = reading
        else:
            _mark_differences(next(iter(kept.values())), reading)
    return [*kept.values()]


def most_readings(waiting: int) -> int:
    """Return how many readings with so many waiting requests are made for one response or loss."""
    return max(MAX_COPIED // max(waiting, MAX_BEFORE), LEAST_READINGS)


def without_pipelined(readings: list[PairReading]) -> list[PairReading]:
    """Return the readings in which a master that never pipelines sends its next request now.

    Only readings that give responses to requests before the capture are left out: these readings
    say that the master always has one request more waiting.
    """
    kept = [one for one in readings if not (one.used_before and one.waiting)]
    return kept or readings


def likely_cost(reading: PairReading) -> float:
    """Return a reading's cost, plus UNLIKELY for each response to a given-up request.

    The reading with the lowest such cost is chosen among readings of about the same cost.
    """
    return reading.cost + UNLIKELY * sum([step.is_late for step in reading.steps])


def _mark_differences(kept: PairReading, other: PairReading) -> None:
    """Mark as unsure each step of the reading `kept` to which the reading `other` gives other
    requests.
    """
    steps = []
    for one, two in zip(kept.steps, other.steps, strict=True):
        if one.requests == two.requests:
            steps.append(one)
            continue
        steps.append(one._replace(is_sure=False) if one.is_sure else one)
        if one.response is None:
            for request in (*one.requests, *two.requests):
                request.may_be_lost = True
    kept.steps = tuple(steps)
