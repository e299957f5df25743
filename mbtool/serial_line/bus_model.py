"""Tells requests from responses on a bus where nothing says who speaks; follows the bus state."""

# One tap on a two-wire line hears the master and the slaves alike. The form of a frame and the bus
# state (which request is pending, and what came last: bus_state.py) tell whether the frame is a
# request or a response: frame_costs.py gives the cost of each in bits, and the cheaper one wins.
#
# An adapter may merge several frames, so that all the silences between them appear as one silence
# before the first. That silence does not tell which response was missing. But if it is longer than
# usual on this line, some response was missing: an explanation in which all responses came costs
# more (`silence_cost`).
#
# The search for frames (search.py) asks for the next state of each of its paths. `BusModel` keeps
# the states that are possible after the frames returned so far: several, at most MAX_STATES, after
# an ambiguous frame. It also learns from these frames (line_history.py).

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import msgspec
from msgspec.structs import replace

from mbtool.core import Direction
from mbtool.modbus.adu import RTU_EXTRA_BYTES, DirectionBy
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.modbus.functions import ECHOING, WRITE_SEVERAL
from mbtool.modbus.pdu import pdu_length
from mbtool.serial_line import costs
from mbtool.serial_line.bus_state import (
    ENOUGH_CHANGES,
    NO_RIVAL_CONFIDENCE,
    BusState,
    CostedState,
    PendingRequest,
    bits_of,
    confidence_of,
    most_likely,
)
from mbtool.serial_line.frame_costs import CostParts, frame_cost
from mbtool.serial_line.line_history import ONE_SIDE, LineHistory
from mbtool.serial_line.line_statistics import LatencyStatistics
from mbtool.serial_line.response_timeout import ResponseTimeout

SURE = 0.8
"""A frame is called ambiguous if its confidence (0.5 to 1) is less than this."""
UNSURE = 0.79
"""The confidence (0.5 to 1) of a frame that is found ambiguous is lowered to this, below `SURE`."""

CERTAIN_BY = frozenset((DirectionBy.FORM, DirectionBy.PORT))
ROLES = (Direction.REQUEST, Direction.RESPONSE)


class Classification(msgspec.Struct, frozen=True, gc=False):
    """The direction of a frame, what decided it, and a confidence of 0.5 to 1."""

    direction: Direction
    by: DirectionBy
    confidence: float
    is_final: bool = False
    """True if no later frame can decide the direction, so that the bus state which follows from the
    other direction is not kept."""


_SLOW_NS = LatencyStatistics.MIN_WRITE_NS
"""A frame that equals its request and comes sooner than this, in ns, is surely no retry."""

REQUEST_BY_FORM = Classification(Direction.REQUEST, DirectionBy.FORM, 1.0)
_RESPONSE_BY_FORM = Classification(Direction.RESPONSE, DirectionBy.FORM, 1.0)
FITTING_RESPONSE = Classification(Direction.RESPONSE, DirectionBy.PENDING, 1.0)


class BusModel:
    """Classifies each frame of a line, and follows the bus state."""

    holds_first_frame: ClassVar[bool] = True
    """True if the first frame of a line may wait up to a second for the next one, as its direction
    is in doubt until then."""

    def __init__(self, *, timed: bool = True, response_timeout_ns: int | None = None) -> None:
        """`timed` is False if the bytes have no known times, as in a raw file.

        `response_timeout_ns` is the time (ns) that the master waits before it repeats a request;
        None if it has to be learned.
        """
        self.history = LineHistory(timed=timed)
        self.history.timeout = ResponseTimeout(response_timeout_ns)
        self.states: list[CostedState] = [(0.0, BusState())]
        """The possible bus states, each with its cost in bits above the most likely one, which
        comes first."""
        self._repeated_write: tuple[int, bytes] | None = None
        """The unit and PDU of a write of several values that was the last frame and the one before;
        None if the last frame was anything else."""

    @property
    def state(self) -> BusState:
        """The most likely bus state: which request is pending, and what came last."""
        return self.states[0][1]

    def classify(
        self, unit: int, pdu: bytes, at_ns: int, roles: Sequence[Direction] = ()
    ) -> Classification:
        """Tell the direction of a whole frame whose first byte began at `at_ns`.

        `roles` are the directions that the frame can have by its length; if they are left out, they
        are computed here.
        """
        roles = roles or roles_of(pdu)
        if len(roles) == 1:
            if roles[0] is Direction.RESPONSE:
                pending = self.state.pending_at(at_ns)
                if pending is not None and pending.fits(unit, pdu):
                    return FITTING_RESPONSE
                return _RESPONSE_BY_FORM
            if not self._may_be_whole_echo(unit, pdu):
                return REQUEST_BY_FORM
        request, response = (self._least_cost(unit, pdu, role, at_ns) for role in ROLES)
        if request[0] + request[1] <= response[0] + response[1]:
            best, other, direction, by = request, response, Direction.REQUEST, DirectionBy.IDLE
        else:
            best, other, direction, by = response, request, Direction.RESPONSE, DirectionBy.PENDING
        if best[0] > other[0]:  # Without the silences, the other direction would win.
            by = DirectionBy.TIMING
        return Classification(direction, by, confidence_of(sum(other) - sum(best)))

    def _may_be_whole_echo(self, unit: int, pdu: bytes) -> bool:
        """True if a write of several values equals the pending one: some slaves answer so."""
        if pdu[0] not in WRITE_SEVERAL:
            return False
        return any(one.pending and one.pending.is_same(unit, pdu) for _, one in self.states)

    def cost(self, state: BusState, unit: int, pdu: bytes, role: Direction, at_ns: int) -> float:
        """Return the cost, in bits, of taking a frame for `role` in a bus state.

        `at_ns` is the time at which the first byte of the frame began.
        """
        by_state, by_time = frame_cost(self.history, state, unit, pdu, role, at_ns)
        return by_state + by_time

    def _least_cost(self, unit: int, pdu: bytes, role: Direction, at_ns: int) -> CostParts:
        """Return the least cost of taking a frame for `role` in one of the possible bus states.

        The cost in bits has two parts: the first follows from the bus state, the second from the
        silence before the frame. `at_ns` is the time at which the first byte of the frame began.
        """
        least = math.inf, 0.0
        for bits, state in self.states:
            by_state, by_time = frame_cost(self.history, state, unit, pdu, role, at_ns)
            if bits + by_state + by_time < sum(least):
                least = bits + by_state, by_time
        return least

    def expects(self, state: BusState, unit: int, code: int, size: int, role: Direction) -> bool:
        """True if a frame with this unit, function code and PDU size is expected next.

        `size` is in bytes, 0 if unknown. A response is expected if it can answer the pending
        request. A request is expected if no request is pending and this function was requested of
        this unit before.
        """
        if role is Direction.RESPONSE:
            pending = state.pending
            if pending is None or not pending.is_named_by(unit, code):
                return False
            return not size or code != pending.expected.code or pending.expected.size in (0, size)
        return state.pending is None and (unit, code) in self.history.functions

    def expects_incomplete(self, head: bytes, sizes: Mapping[Direction, int]) -> bool:
        """True if `head` can be the incomplete beginning of the frame that is expected next.

        `sizes` gives, by direction, the size in bytes of the whole frame; it has no entry for a
        direction if `head` does not tell the size yet.
        """
        if len(self.states) > 1:
            return False
        state, have = self.state, len(head)
        role = Direction.REQUEST if state.pending is None else Direction.RESPONSE
        if have == 1:
            unit = head[0]
            pending = state.pending
            return unit in self.history.units if pending is None else unit == pending.unit
        size = sizes.get(role, 0)
        if 0 < size <= have or (not size and have > RTU_EXTRA_BYTES):
            return False
        return self.expects(state, head[0], head[1], size and size - RTU_EXTRA_BYTES, role)

    def silence_cost(self, state: BusState, *, is_last: bool = False) -> float:
        """Return the cost, in bits, of supposing that no response is missing in the last silence.

        Used where an adapter merges frames; the silence is `state.unexplained_silence_ns`.
        `is_last` is True if the window has no frame after that silence.
        """
        if not state.unexplained_silence_ns:
            return 0.0
        doublings = self.history.unexplained_silences.doublings_late(
            state.unexplained_silence_ns, self.history.least_silence_ns
        )
        if doublings <= LatencyStatistics.MARGIN_DOUBLINGS:
            return 0.0
        cost = min(costs.LATE + costs.LATE_PER_DOUBLING * doublings, costs.MAX_LATENESS)
        # An adapter that holds bytes back causes such a silence, too.
        may_be_adapter = state.unexplained_silence_ns <= LatencyStatistics.ADAPTER_TIMER_NS
        return cost / 2 if is_last and may_be_adapter else cost

    def hear(
        self,
        classification: Classification,
        unit: int,
        pdu: bytes,
        start_ns: int,
        end_ns: int,
        inside_ns: int = 0,
    ) -> None:
        """Learn from a frame that the splitter returns, and compute the bus states after it.

        `inside_ns` is the longest silence inside the frame; 0 if its bytes follow one another.
        """
        role, state, history = classification.direction, self.states[0][1], self.history
        is_sure = classification.confidence >= SURE
        if role is Direction.REQUEST:
            if pdu[0] in WRITE_SEVERAL or self._repeated_write is not None:
                self._learn_whole_echo(unit, pdu)
            if history.unasked and classification.by is DirectionBy.FORM:
                history.unasked, history.hears_only_slaves = 0, False
            if is_sure:
                # Ordinary polling teaches nothing here. Skipping it makes decoding 3 % faster.
                if state.pending or state.answered_after_ns > _SLOW_NS or len(self.states) > 1:
                    self._learn_from_outcome(unit, pdu, start_ns)
                by_form = classification.by is DirectionBy.FORM or pdu[0] in WRITE_SEVERAL
                history.learn_request(state, unit, pdu, by_form, start_ns)
        elif state.pending and (
            classification is FITTING_RESPONSE or state.pending.fits(unit, pdu)
        ):
            self._learn_response(state.pending, pdu, start_ns, is_sure)
        elif state.pending is None:
            self._learn_unasked(classification)
        elif state.pending.has_address_of(unit, pdu):
            history.learn_wrong_echo(unit, pdu[0])
        if state.unexplained_silence_ns and state.settles_silence(role, start_ns, inside_ns):
            history.unexplained_silences.learn_capped(state.unexplained_silence_ns)
        by_form = classification.by in CERTAIN_BY
        frame = unit, pdu, role, start_ns, end_ns, inside_ns, by_form
        is_sole = len(self.states) == 1 and classification.confidence >= NO_RIVAL_CONFIDENCE
        if is_sole or classification.is_final:
            self.states = [(0.0, self.next_state(state, *frame))]
            return
        states = self._states_after(*frame)
        other = ROLES[role is Direction.REQUEST]
        may_be_other = other in roles_of(pdu) or self._may_be_whole_echo(unit, pdu)
        if not by_form and may_be_other:
            extra = bits_of(classification.confidence)
            rivals = self._states_after(unit, pdu, other, start_ns, end_ns, inside_ns, by_form)
            states += [(bits + extra, rival) for bits, rival in rivals]
        self.states = most_likely(states)

    def _learn_unasked(self, classification: Classification) -> None:
        """Count a response that nobody requested, if it is one by its form."""
        state, history = self.state, self.history
        is_certain = classification.by is DirectionBy.FORM
        if is_certain and state.answered is None and not state.follows_damage:
            history.unasked = min(history.unasked + 1, ONE_SIDE)
            history.hears_only_slaves = history.unasked == ONE_SIDE

    def _learn_whole_echo(self, unit: int, pdu: bytes) -> None:
        """Learn from a request that a write before it came exactly twice, with no other response.

        The second one may have been the response, as some slaves repeat the whole request.
        """
        repeated, self._repeated_write = self._repeated_write, None
        if repeated is not None and repeated != (unit, pdu):
            self.history.learn_wrong_echo(repeated[0], repeated[1][0])
        pending = self.state.pending
        if pdu[0] in WRITE_SEVERAL and repeated is None and pending and pending.is_same(unit, pdu):
            self._repeated_write = unit, pdu

    def _learn_response(
        self, pending: PendingRequest, pdu: bytes, start_ns: int, is_sure: bool
    ) -> None:
        """Learn from a response that fits the pending request and began at `start_ns`.

        `is_sure` is False if the frame is ambiguous: it may be a retry instead.
        """
        history = self.history
        latency_ns = start_ns - pending.awaited_from_ns
        if pdu[0] in WRITE_SEVERAL:
            self._repeated_write = None
            history.wrong_echoes.pop((pending.unit, pdu[0]), None)
            history.usual_echoes.add((pending.unit, pdu[0]))
        if is_sure and pdu != pending.pdu:
            if history.unanswered or pending.unit not in history.answering:
                history.learn_answer(pending.unit)
        elif (
            is_sure
            and history.trusts_silences
            and latency_ns < LatencyStatistics.MIN_RETRY_NS
            and not history.timeout.is_over_at(latency_ns)
        ):
            if latency_ns > 0:
                history.learn_answer(pending.unit)
            else:  # Merged with the request: it may turn out to be a retry.
                history.unanswered.pop(pending.unit, None)
            if self.state.retries and pending.silence_before_ns:
                history.timeout.learn(pending.silence_before_ns)  # This request was a retry.
        if history.trusts_silences:
            history.learn_latency(pending, pdu, start_ns, is_sure)

    def _learn_from_outcome(self, unit: int, pdu: bytes, start_ns: int) -> None:
        """Learn from a new request if the request before it was answered, and after what time."""
        state = self._state_before(unit, pdu, start_ns)
        if state is None:
            return
        history, answered, latency_ns = self.history, state.answered, state.answered_after_ns
        if state.pending is not None:
            history.learn_no_answer(state.pending.unit)
        elif (
            answered is not None
            and answered.pdu == state.last_response
            and not answered.is_same(unit, pdu)  # If equal, this request may have been a retry.
        ):
            is_slow = history.trusts_silences and latency_ns > _SLOW_NS
            went_on_ns = start_ns - (state.last_ns or start_ns)
            # The previous frame was the response or a retry. After a retry the master would have
            # waited as long again before it sent this request. If it waited less, the frame was the
            # response.
            is_response = went_on_ns < latency_ns * costs.SOONER
            if is_slow and (is_response or history.timeout.is_not_over(latency_ns)):
                history.learn_echo(answered, latency_ns)

    def _state_before(self, unit: int, pdu: bytes, start_ns: int) -> BusState | None:
        """Return the bus state before a request; None if several states are nearly as likely."""
        if len(self.states) == 1:
            return self.state
        costed = [
            (bits + self.cost(state, unit, pdu, Direction.REQUEST, start_ns), state)
            for bits, state in self.states
        ]
        (least, state), (second, _), *_ = sorted(costed, key=lambda one: one[0])
        return state if confidence_of(second - least) >= SURE else None

    def _states_after(
        self,
        unit: int,
        pdu: bytes,
        role: Direction,
        start_ns: int,
        end_ns: int,
        inside_ns: int,
        by_form: bool,
    ) -> list[CostedState]:
        """Return the possible bus states, with costs in bits, after a frame of direction `role`."""
        after = [
            (
                bits + self.cost(state, unit, pdu, role, start_ns),
                self.next_state(state, unit, pdu, role, start_ns, end_ns, inside_ns, by_form),
            )
            for bits, state in self.states
        ]
        least = min(bits for bits, _ in after)
        return [(bits - least, state) for bits, state in after]

    def may_be_reversed(self, start_ns: int) -> bool:
        """True if all requests so far may be responses, and all responses requests.

        That is so until a frame shows by its form that it is a request or a response: of two
        alternating silences, either may be the slave's response time. But the first two frames of a
        capture are taken for a request and its response if the second comes within MIN_WRITE_NS.
        `start_ns` is the time at which the next frame began.
        """
        if not self.history.timed or (state := self.state).direction_known:
            return False
        pending, waited_ns = state.pending, start_ns - (state.last_ns or start_ns)
        if pending is None or pending.silence_before_ns is not None:
            return state.last_ns is not None
        return waited_ns > LatencyStatistics.MIN_WRITE_NS

    def may_be_retry(self, unit: int, pdu: bytes, start_ns: int) -> bool:
        """True if a frame equals the one before it, and nothing tells a response from a retry.

        That is so if the silence before the frame, which began at `start_ns`, does not tell who
        speaks, and no response of the unit has differed from its request. But two equal frames on a
        line with a single unit are taken for a request and its response.
        """
        history = self.history
        if unit in history.answering or pdu[0] not in ECHOING:
            return False
        state = self.state
        if history.shows_master_wait(start_ns - (state.last_ns or 0)):
            return False
        if state.pending is not None:
            is_third = state.is_repeat or state.retries > 0
            may_be_absent = is_third or len(history.units) > 1
            return may_be_absent and state.pending.is_same(unit, pdu)
        return state.answered is not None and state.answered.is_same(unit, pdu)

    def may_be_whole_echo(self, unit: int, pdu: bytes, start_ns: int) -> bool:
        """True if a write of several values that equals the pending one may be its response.

        That is so if the silence before it, which ended at `start_ns`, tells nothing, and the unit
        answers, but has not shown how it answers this function.
        """
        history, pending = self.history, self.state.pending
        if pending is None or not pending.is_same(unit, pdu):
            return False
        if unit not in history.answering or (unit, pdu[0]) in history.usual_echoes:
            return False
        return not history.shows_master_wait(start_ns - pending.awaited_from_ns)

    def may_be_slow(self, unit: int, pdu: bytes, start_ns: int) -> bool:
        """True if a frame that equals the pending request may be a retry or a slow response.

        It is False if this line has shown retries, or a response as slow. Otherwise it is True if
        the frame comes MIN_RETRY_NS or more after the request, when some masters repeat it, but
        within 8 times (SLOW_DOUBLINGS) the longest response time of the line.
        """
        history = self.history
        if not history.trusts_silences or history.timeout.is_known:
            return False
        pending = self.state.pending
        if pending is None:
            return False
        waited_ns = start_ns - pending.awaited_from_ns
        if waited_ns < LatencyStatistics.MIN_RETRY_NS or not pending.is_same(unit, pdu):
            return False
        if history.latency.has_taken_as_long(waited_ns):
            return False
        if history.latency.doublings_late(waited_ns) > costs.SLOW_DOUBLINGS:
            return False
        heard = history.echo_latencies.get((unit, pdu[0]))
        return heard is None or not heard.has_taken_as_long(waited_ns)

    def reset_state(self) -> None:
        """Forget the bus state: the clock was set back, so its times mean nothing any more."""
        self.states = [(0.0, BusState())]

    def hear_damage(self) -> None:
        """Compute the possible bus states after bytes that could not be read."""
        self.states = most_likely((bits, state.after_damage()) for bits, state in self.states)

    def hear_damaged_frame(self, frame: bytes, role: Direction, start_ns: int, end_ns: int) -> None:
        """Compute the possible bus states after a damaged frame. Nothing is learned from it.

        `frame` is the whole frame as it was sent, with the damage repaired. The slave or master
        that it was for may have received the damage too, and ignored the frame.
        """
        after = self._states_after(frame[0], frame[1:-2], role, start_ns, end_ns, 0, False)
        ignored = [
            (bits + costs.NOT_UNDERSTOOD, state.after_damage()) for bits, state in self.states
        ]
        self.states = most_likely([*after, *ignored])

    def next_state(
        self,
        state: BusState,
        unit: int,
        pdu: bytes,
        role: Direction,
        start_ns: int,
        end_ns: int,
        inside_ns: int = 0,
        by_form: bool = False,
    ) -> BusState:
        """Return the bus state after a frame that was heard in `state`.

        The frame was on the line from `start_ns` to `end_ns`. `by_form` is True if by its form the
        frame can only have the direction `role`. `inside_ns` is the longest silence inside it.
        """
        history, silence_ns = self.history, 0
        if history.timed and not history.trusts_silences:
            silence_ns = _unexplained_silence_ns(state, role, start_ns, inside_ns)
        pending, overdue, answered = state.pending, state.overdue, None
        after_ns, retries, is_repeat = 0, 0, False
        if role is Direction.REQUEST:
            overdue = pending and replace(pending, awaited_from_ns=end_ns)
            expected = ExpectedResponse.of(pdu) if unit else None
            if expected is None:  # Nobody responds to a broadcast.
                pending = overdue = None
            else:
                before_ns = None if state.last_ns is None else start_ns - state.last_ns
                is_repeat = state.answered is not None and state.answered.is_same(unit, pdu)
                retries = state.retries + 1 if pending and pending.is_same(unit, pdu) else 0
                pending = PendingRequest(unit, pdu, expected, end_ns, before_ns)
            pdu = b""
        elif pending is None or pending.unit == unit:
            is_repeat = pending is not None and state.is_repeat
            overdue, answered, pending = (overdue if pending else None), pending or overdue, None
            if answered and history.trusts_silences:
                after_ns = start_ns - answered.awaited_from_ns
        changes, known = state.changes, by_form or state.direction_known
        if not known and role is Direction.REQUEST and state.answered is not None:
            is_echo = state.last_response == state.answered.pdu
            changes = min(changes + (is_echo and not is_repeat), ENOUGH_CHANGES)
            known = changes == ENOUGH_CHANGES
        return BusState(
            pending, overdue, answered, after_ns, retries, is_repeat, pdu, False, known, changes,
            end_ns, silence_ns,
        )  # fmt: skip


def roles_of(pdu: bytes) -> tuple[Direction, ...]:
    """Return the directions that a PDU can have by its function and length.

    Both are returned if the PDU fits neither, as one of an unknown function does.
    """
    fitting = tuple(role for role in ROLES if pdu_length(pdu, role) == len(pdu))
    return fitting or ROLES


def _unexplained_silence_ns(state: BusState, role: Direction, start_ns: int, inside_ns: int) -> int:
    """Return the length, in ns, of the last silence before or inside a frame of a line whose
    adapter merges frames.

    It is 0 if the silence was the wait for a response that never came.
    """
    if inside_ns:
        return inside_ns
    if role is Direction.REQUEST and state.answered is None:
        return 0  # The silence was the wait for a response that never came.
    return start_ns - (state.last_ns or start_ns) or state.unexplained_silence_ns
