"""Whose turn it is on a bus where nothing says who speaks."""

# One tap on a two-wire line hears the master and the slaves alike. What a frame is follows from its
# form and from the request that waits for an answer: an answer names the request's unit and
# function, and fits its quantity or echoes its address. Without such a request a frame that has
# the form of a request is one. Requests and answers of 05, 06, 08, 15H and 16H look alike, so there
# only the turn decides, and the silences: masters wait longer for an answer than slaves take. Some
# answers of 01, 02, 14H and 17H are as long as a request, too. One that could be none, or none that
# this line has heard, is the answer that waits to be heard, however late it is.
#
# Where an adapter hands over several frames at once, all silences among them come out as one before
# them. Then a silence does not tell which answer was late, but a longer one than is usual here says
# that some answer was missing: an explanation in which none is pays for it (pause_cost).
#
# A `BusState` is a value (turn.py), so that the search for frames (tiling.py) can suppose one.
# `BusModel` keeps what the turn may be by now, since a frame in doubt leaves more than one, and
# what the line has taught: bounded by MOST_TURNS turns, MAX_KNOWN requests and each function of
# each unit.

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.modbus.adu import DirectionBy
from mbtool.modbus.adu_bytes import RTU_EXTRA_BYTES
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.modbus.functions import ECHOING, EXCEPTION_BIT, FUNCTIONS, NEVER_ECHOED, READ_BITS
from mbtool.modbus.pdu import parse_pdu, pdu_length
from mbtool.modbus.register_access import keeps_limits
from mbtool.serial_line import costs
from mbtool.serial_line.bus_state import (
    BEYOND_DOUBT,
    BusState,
    PendingRequest,
    Weighed,
    bits_of,
    is_like,
    likeliest,
    likelihood,
)
from mbtool.serial_line.line_statistics import LatencyStatistics, LearnedCost
from mbtool.serial_line.plausibility import is_odd_request, is_odd_response, is_padded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

TURN_NS = 1_000_000_000
"""How long a request waits for its answer before the turn goes back to the master.

Serial Line V1.02, 2.4.1, gives 1 s to several seconds as the usual response timeout.
"""
MAX_KNOWN = 1024
"""Requests remembered; beyond that the one unheard longest is forgotten."""
SURE = 0.8
"""A confidence below which a frame is called ambiguous."""

CERTAIN = frozenset((DirectionBy.FORM, DirectionBy.PORT))
ROLES = (Direction.REQUEST, Direction.RESPONSE)
MAX_UNIT = 247
"""The largest address of a slave (Serial Line V1.02, 2.2)."""


class Classification(msgspec.Struct, frozen=True, gc=False):
    """What a frame is taken for."""

    direction: Direction
    by: DirectionBy
    confidence: float


_REQUEST_BY_FORM = Classification(Direction.REQUEST, DirectionBy.FORM, 1.0)
_RESPONSE_BY_FORM = Classification(Direction.RESPONSE, DirectionBy.FORM, 1.0)
_ANSWER = Classification(Direction.RESPONSE, DirectionBy.PENDING, 1.0)


class BusModel:
    """Judges each frame of a line by the turn, and keeps the turn."""

    def __init__(self, *, timed: bool = True) -> None:
        """`timed` says whether the bytes' times are known."""
        self.trusts_silences = timed
        """Whether silences here tell who speaks: not without times, nor where frames are glued."""
        self.likely: list[Weighed] = [(0.0, BusState())]
        """What the turn may be, the likeliest first."""
        self._known: dict[tuple[int, bytes], None] = {}
        self._asked: set[tuple[int, int]] = set()
        """Units with the functions that they were asked."""
        self._units: set[int] = set()
        self._timed = timed
        self._latency = LatencyStatistics()
        self._pauses = LatencyStatistics()
        """The silences among glued frames in which no answer was missing."""
        self._again = LearnedCost(costs.ASKED_AGAIN, costs.ASKED_AGAIN_LIMITS)
        self._repeated = LearnedCost(costs.REPEATED, costs.REPEATED_LIMITS)

    @property
    def turn(self) -> BusState:
        """The likeliest."""
        return self.likely[0][1]

    def judge(
        self, unit: int, pdu: bytes, at_ns: int, roles: Sequence[Direction] = ()
    ) -> Classification:
        """Say what a whole frame is. `at_ns` is the time of its first byte.

        `roles` are those whose form it has, where that is known already.
        """
        roles = roles or roles_of(pdu)
        if len(roles) == 1:
            if roles[0] is Direction.RESPONSE:
                waiting = self._waiting(self.turn, at_ns)
                if waiting is not None and waiting.fits(unit, pdu):
                    return _ANSWER
                return _RESPONSE_BY_FORM
            return _REQUEST_BY_FORM
        request, response = (self._least_cost(unit, pdu, role, at_ns) for role in ROLES)
        if request[0] + request[1] <= response[0] + response[1]:
            best, other, direction, by = request, response, Direction.REQUEST, DirectionBy.IDLE
        else:
            best, other, direction, by = response, request, Direction.RESPONSE, DirectionBy.PENDING
        if best[0] > other[0]:  # Without the silences it would be the other one.
            by = DirectionBy.TIMING
        return Classification(direction, by, likelihood(sum(other) - sum(best)))

    def weigh(self, turn: BusState, unit: int, pdu: bytes, role: Direction, at_ns: int) -> float:
        """What it costs to take a frame for this, in bits."""
        by_turn, by_time = self._cost(turn, unit, pdu, role, at_ns)
        return by_turn + by_time

    def _least_cost(
        self, unit: int, pdu: bytes, role: Direction, at_ns: int
    ) -> tuple[float, float]:
        """What it costs under the turn that speaks most for it: by the turn, and by the silence."""
        least = math.inf, 0.0
        for bits, turn in self.likely:
            by_turn, by_time = self._cost(turn, unit, pdu, role, at_ns)
            if bits + by_turn + by_time < sum(least):
                least = bits + by_turn, by_time
        return least

    def expects(self, turn: BusState, unit: int, code: int, size: int, role: Direction) -> bool:
        """Whether a frame that begins so, of a PDU of this size (0: unknown), is due now."""
        if role is Direction.RESPONSE:
            waiting = turn.waiting
            if waiting is None or not waiting.is_named_by(unit, code):
                return False
            return not size or code != waiting.expected.code or waiting.expected.size in (0, size)
        return turn.waiting is None and (unit, code) in self._asked

    def awaits(self, head: bytes, sizes: Mapping[Direction, int]) -> bool:
        """Whether a frame that has begun so, and is to be so long as each, is what is due now.

        Where `sizes` has nothing, its bytes do not say yet.
        """
        if len(self.likely) > 1:
            return False
        turn, have = self.turn, len(head)
        role = Direction.REQUEST if turn.waiting is None else Direction.RESPONSE
        if have == 1:
            unit = head[0]
            return unit in self._units if turn.waiting is None else unit == turn.waiting.unit
        size = sizes.get(role, 0)
        if 0 < size <= have or (not size and have > RTU_EXTRA_BYTES):
            return False
        return self.expects(turn, head[0], head[1], size and size - RTU_EXTRA_BYTES, role)

    def was_asked(self, unit: int, pdu: bytes) -> bool:
        """Whether a request was heard before."""
        return (unit, pdu) in self._known

    def has_asked(self, head: bytes) -> bool:
        """Whether a unit was asked anything, or with a second byte for a function.

        That may be an exception's.
        """
        if len(head) == 1:
            return head[0] in self._units
        return len(head) == 2 and (head[0], head[1] & ~EXCEPTION_BIT) in self._asked

    def pause_cost(self, turn: BusState, *, is_last: bool = False) -> float:
        """What it costs that in the last silence no answer was missing.

        `is_last` says that nothing is heard behind it as yet.
        """
        if not turn.pause_ns:
            return 0.0
        octaves = self._pauses.octaves_late(turn.pause_ns)
        late = costs.LATE + costs.LATE_PER_OCTAVE * octaves
        if octaves <= LatencyStatistics.MARGIN_OCTAVES:
            return 0.0
        cost = min(late, costs.MOST_FOR_LATENESS)
        # An adapter that waits for more before it hands over makes such a silence, too.
        return cost / 2 if is_last and turn.pause_ns <= LatencyStatistics.TIMER_NS else cost

    def hear(
        self,
        judgement: Classification,
        unit: int,
        pdu: bytes,
        start_ns: int,
        end_ns: int,
        inside_ns: int = 0,
    ) -> None:
        """Note a frame that was given out, and learn from it.

        `inside_ns` is the longest silence in it.
        """
        role, turn, is_sure = judgement.direction, self.turn, judgement.confidence >= SURE
        if role is Direction.REQUEST and is_sure:
            self._remember(unit, pdu)
            if turn.answered is not None:
                self._again.learn(turn.answered.asks(unit, pdu))
            if judgement.by is DirectionBy.FORM:  # Nothing but a repetition would look like one.
                waiting = turn.waiting
                self._repeated.learn(waiting is not None and waiting.asks(unit, pdu))
        elif role is Direction.RESPONSE and self.trusts_silences:
            waiting = turn.waiting
            if waiting is not None and waiting.fits(unit, pdu):
                latency_ns = start_ns - waiting.since_ns
                if pdu != waiting.pdu and is_sure:
                    self._latency.learn(latency_ns)
                elif latency_ns < LatencyStatistics.RETRY_NS:  # Otherwise it may have been a retry.
                    self._latency.learn_warily(latency_ns)
        if turn.ends_pause(role, start_ns, inside_ns):
            self._pauses.learn_warily(turn.pause_ns)
        by_form = judgement.by in CERTAIN
        spoken = unit, pdu, role, start_ns, end_ns, inside_ns, by_form
        if len(self.likely) == 1 and judgement.confidence >= BEYOND_DOUBT:
            self.likely = [(0.0, self.follow(turn, *spoken))]
            return
        turns = self._turns_after(*spoken)
        other = ROLES[role is Direction.REQUEST]
        if not by_form and other in roles_of(pdu):
            dearer = bits_of(judgement.confidence)
            rivals = self._turns_after(unit, pdu, other, start_ns, end_ns, inside_ns, by_form)
            turns += [(bits + dearer, rival) for bits, rival in rivals]
        self.likely = likeliest(turns)

    def _turns_after(
        self,
        unit: int,
        pdu: bytes,
        role: Direction,
        start_ns: int,
        end_ns: int,
        inside_ns: int,
        sure: bool,
    ) -> list[Weighed]:
        """What the turn may be after a frame that is a request, or a response."""
        after = [
            (
                bits + self.weigh(turn, unit, pdu, role, start_ns),
                self.follow(turn, unit, pdu, role, start_ns, end_ns, inside_ns, sure),
            )
            for bits, turn in self.likely
        ]
        least = min(bits for bits, _ in after)
        return [(bits - least, turn) for bits, turn in after]

    def begin_anew(self) -> None:
        """Forget whose turn it was: the clock was set back."""
        self.likely = [(0.0, BusState())]

    def heard_damage(self) -> None:
        """Note bytes that could not be read."""
        self.likely = likeliest((bits, turn.behind_damage()) for bits, turn in self.likely)

    def heard_damaged(self, frame: bytes, role: Direction, start_ns: int, end_ns: int) -> None:
        """Note a damaged frame by what it was when it was sent. Nothing is learned from it.

        Whom it was for may have heard the damage, too: then it came to nothing.
        """
        after = self._turns_after(frame[0], frame[1:-2], role, start_ns, end_ns, 0, sure=False)
        unheard = [(bits + costs.UNHEARD, turn.behind_damage()) for bits, turn in self.likely]
        self.likely = likeliest([*after, *unheard])

    def follow(
        self,
        turn: BusState,
        unit: int,
        pdu: bytes,
        role: Direction,
        start_ns: int,
        end_ns: int,
        inside_ns: int = 0,
        sure: bool = False,
    ) -> BusState:
        """The turn after a frame."""
        waiting, sure = turn.waiting, sure or turn.sure
        pause_ns = self._pause_ns(turn, role, start_ns, inside_ns)
        if role is Direction.REQUEST:
            expected = ExpectedResponse.of(pdu) if unit else None  # Nobody answers a broadcast.
            if expected is None:
                return BusState(sure=sure, last_ns=end_ns, pause_ns=pause_ns)
            before_ns = None if turn.last_ns is None else start_ns - turn.last_ns
            request = PendingRequest(unit, pdu, expected, end_ns, before_ns)
            owed = waiting and waiting.since(end_ns)
            return BusState(
                waiting=request, owed=owed, sure=sure, last_ns=end_ns, pause_ns=pause_ns
            )
        owed, answered = turn.owed, None
        if waiting is None or waiting.unit == unit:
            owed, answered, waiting = (owed if waiting else None), waiting or owed, None
        return BusState(waiting, owed, answered, pdu, sure=sure, last_ns=end_ns, pause_ns=pause_ns)

    def _pause_ns(self, turn: BusState, role: Direction, start_ns: int, inside_ns: int) -> int:
        """The last silence after a frame, if it is not explained."""
        if self.trusts_silences or not self._timed:
            return 0
        if inside_ns:
            return inside_ns
        if role is Direction.REQUEST and turn.answered is None:
            return 0  # None has answered what came before: that is what the silence was.
        return start_ns - (turn.last_ns or start_ns) or turn.pause_ns

    def _cost(
        self, turn: BusState, unit: int, pdu: bytes, role: Direction, at_ns: int
    ) -> tuple[float, float]:
        """What it costs to take a frame for this, by the turn and by the silence before it."""
        waiting = self._waiting(turn, at_ns)
        odd = costs.UNLIKELY_UNIT if unit > MAX_UNIT else 0.0
        if role is Direction.REQUEST:
            cost, by_time = self._request_cost(turn, waiting, unit, pdu, at_ns)
            if self._is_just_asked_for(turn.waiting, unit, pdu):
                cost += costs.FITS_AS_ANSWER
        else:
            cost, by_time = self._response_cost(turn, waiting, unit, pdu, at_ns)
        return cost + odd, by_time if self.trusts_silences else 0.0

    def _request_cost(
        self, turn: BusState, waiting: PendingRequest | None, unit: int, pdu: bytes, at_ns: int
    ) -> tuple[float, float]:
        cost = costs.REQUEST
        if is_odd_request(pdu):
            cost += costs.ODD_REQUEST
        same = waiting is not None and waiting.asks(unit, pdu)
        answered = turn.answered
        again = answered is not None and answered.asks(unit, pdu)
        if again:
            is_told = self.trusts_silences and turn.owed is None
            cost += 0.0 if is_told else self._again.bits
        elif turn.answer == pdu and (answered.unit == unit if answered else pdu[0] not in ECHOING):
            cost += costs.REQUEST_LIKE_ANSWER
        if not (same or again or (unit, pdu) in self._known):
            cost += costs.NEW_REQUEST
            request = parse_pdu(pdu, Direction.REQUEST)
            if pdu[0] in FUNCTIONS and request.problem is None and not keeps_limits(request):
                cost += costs.MALFORMED
        if waiting is None:
            return cost, 0.0
        owed = turn.owed
        if same and owed is not None and owed.asks(unit, pdu):
            cost += costs.REPEATED_AGAIN
        else:
            cost += self._repeated.bits if same else costs.UNANSWERED
        latency = self._latency
        is_early = latency.is_known and latency.octaves_late(at_ns - waiting.since_ns) < 0
        return cost, costs.EARLY_REPEAT if is_early else 0.0

    def _response_cost(
        self, turn: BusState, waiting: PendingRequest | None, unit: int, pdu: bytes, at_ns: int
    ) -> tuple[float, float]:
        if unit == 0:
            return costs.STRAY_ANSWER + costs.MALFORMED, 0.0
        if turn.waiting is not None and turn.waiting.fits(unit, pdu):
            return self._answer_cost(turn.waiting, pdu, at_ns, turn.sure)
        odd = costs.MALFORMED if is_odd_response(pdu) else 0.0
        if waiting is not None and waiting.is_named_by(unit, pdu[0]):
            return costs.WRONG_ANSWER + odd, 0.0
        owed = turn.owed
        if owed is not None and pdu == owed.pdu and pdu[0] in NEVER_ECHOED:
            owed = None  # The read that comes again: see _answer_cost.
        if owed is not None and at_ns - owed.since_ns <= TURN_NS and owed.fits(unit, pdu):
            is_elsewhere = waiting is not None and not waiting.asks(owed.unit, owed.pdu)
            late = costs.LATE_ELSEWHERE if is_elsewhere else costs.LATE_ANSWER
            is_second = turn.answered is not None and turn.answered.pdu == owed.pdu
            if is_second and not is_like(pdu, turn.answer, owed.pdu):
                late += costs.UNLIKE_ANSWERS
            return late, 0.0
        is_exception = pdu[0] & EXCEPTION_BIT
        if turn.lost and is_exception and (unit, pdu[0] ^ EXCEPTION_BIT) not in self._asked:
            odd += costs.UNASKED
        if waiting is None and (turn.lost or turn.last_ns is None):
            return (costs.ANSWER_WHEN_LOST if turn.lost else costs.ANSWER_AT_START) + odd, 0.0
        return costs.STRAY_ANSWER + odd, 0.0

    def _answer_cost(
        self, waiting: PendingRequest, pdu: bytes, at_ns: int, sure: bool
    ) -> tuple[float, float]:
        silence_ns = at_ns - waiting.since_ns
        is_echo = pdu == waiting.pdu
        octaves = self._latency.octaves_late(
            silence_ns, LatencyStatistics.WRITE_NS if is_echo else 0
        )
        late = costs.LATE + costs.LATE_PER_OCTAVE * octaves
        most = costs.MOST_FOR_LATE_ECHO if is_echo else costs.MOST_FOR_LATENESS
        by_time = min(late, most) if octaves > LatencyStatistics.MARGIN_OCTAVES else 0.0
        if by_time and self._is_just_asked_for(waiting, waiting.unit, pdu):
            by_time = 0.0
        if is_echo and pdu[0] in NEVER_ECHOED:
            # A read of 17 to 24 bits from 0300H to 03FFH has the form of its own answer.
            return costs.ECHO_OF_A_READ, by_time
        if pdu[0] in READ_BITS and not is_padded(waiting.pdu, pdu):
            return costs.MALFORMED, by_time
        if is_echo and pdu[0] not in ECHOING:
            return costs.ECHO_OF_UNKNOWN, by_time or costs.ECHO_IN_TIME
        before_ns = waiting.before_ns
        if is_echo and not sure and before_ns and silence_ns > 2 * before_ns:
            by_time += costs.BACKWARDS
        return costs.ANSWER, by_time

    def _is_just_asked_for(self, waiting: PendingRequest | None, unit: int, pdu: bytes) -> bool:
        """Whether a frame of a request's length is what one waits for, and hardly a request."""
        if waiting is None or pdu == waiting.pdu or not waiting.fits(unit, pdu):
            return False
        if pdu[0] not in FUNCTIONS or pdu_length(pdu, Direction.REQUEST) != len(pdu):
            return False
        if is_odd_request(pdu) or not keeps_limits(parse_pdu(pdu, Direction.REQUEST)):
            return True
        if (unit, pdu) in self._known or waiting.expected.size != len(pdu):
            return False
        # The same quantity from the same 256 addresses: the next request of the master's list.
        is_alike = (pdu[1], pdu[3:5]) == (waiting.pdu[1], waiting.pdu[3:5])
        return not is_alike and (pdu[0] not in READ_BITS or is_padded(waiting.pdu, pdu))

    def _waiting(self, turn: BusState, at_ns: int) -> PendingRequest | None:
        waiting = turn.waiting
        if waiting is None or at_ns - waiting.since_ns > TURN_NS:
            return None
        return waiting

    def _remember(self, unit: int, pdu: bytes) -> None:
        self._asked.add((unit, pdu[0]))
        self._units.add(unit)
        self._known.pop((unit, pdu), None)
        self._known[unit, pdu] = None
        if len(self._known) > MAX_KNOWN:
            del self._known[next(iter(self._known))]


def roles_of(pdu: bytes) -> tuple[Direction, ...]:
    """The directions whose form a whole PDU has; both where no table says."""
    fitting = tuple(role for role in ROLES if pdu_length(pdu, role) == len(pdu))
    return fitting or ROLES
