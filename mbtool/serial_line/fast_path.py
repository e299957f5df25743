"""The fast path: recognises the next frame of an RTU line where no search is needed."""

# Most bytes of a working line are decided here. A frame is certain if its function tells its
# length, if its CRC is correct at the length of one direction only (or the other direction is far
# less likely), and if the bus state expects it. A silence or one more byte has to follow it. If the
# expected frame is longer than the undecided bytes and can begin with them, they are certainly an
# incomplete frame, and the search waits for the rest.
#
# Requests and responses of 05, 06, 08, 15H and 16H are equal. Without times, a frame that equals
# the pending request is certainly the response if the next frame cannot be the response. A master
# that writes one value in a loop causes many equal frames in a row. They are read as pairs of
# request and response if they are many, or if the frame after the last one shows that their number
# is even.

from __future__ import annotations

from collections.abc import Sequence

from mbtool.core import Direction
from mbtool.core.limits import LAST_UNIT
from mbtool.framing.rtu_lengths import MIN_FRAME, frame_size
from mbtool.modbus.adu import MAX_RTU_ADU, DirectionBy, crc
from mbtool.modbus.functions import ECHOING, EXCEPTION_BIT, READ_BITS
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import (
    FITTING_RESPONSE,
    REQUEST_BY_FORM,
    ROLES,
    SURE,
    UNSURE,
    BusModel,
    Classification,
)
from mbtool.serial_line.bus_state import MAX_PENDING_NS, BusState, confidence_of
from mbtool.serial_line.costs import is_implausible_request, is_padded

_REQUEST_CONFIDENCE = 0.98
"""On a line whose silences do not tell who speaks, a frame that could be a request or a response is
taken for a request only with at least this confidence (0.5 to 1). A mistake would reverse the
directions of all frames after it."""
_RESPONSE_CONFIDENCE = 0.95
"""On a line whose silences do not tell who speaks, a frame that could be a request or a response is
taken for a response only with at least this confidence (0.5 to 1). It is less than for a request,
since the response's request came just before."""
_ONLY = {role: [role] for role in ROLES}
"""For each direction, a list that contains only this direction."""
_FAR_LESS_LIKELY = 10.0
"""If two frames of different length begin at the same byte, the shorter one is ignored if it costs
this many bits more than the longer one."""
_LOOP = 5
"""At least this many equal frames behind the first one are a request that the master repeats in a
loop, and not retries."""
_LONG_RUN = 24
"""If at least this many equal frames follow each other, a master writes one value in a loop, and
the run's end is not awaited to count its frames. It is at most the number of frames that the window
keeps undecided."""
_MAX_COST = costs.REQUEST + costs.NEW_REQUEST
"""The cost, in bits, of a request never heard before. A frame that costs more is left to the
search, unless by its form it can only be a request."""


class FastPath:
    """Tells if the next bytes of a line are certainly a frame, or certainly part of one."""

    def __init__(self, bus_model: BusModel, speaker: Direction | None, max_size: int) -> None:
        """`speaker` is the direction of all frames if only one direction is heard; else None.

        `max_size` is the number of bytes at which the search decides without waiting for a silence.
        """
        self.needed = MIN_FRAME
        """The number of undecided bytes from which on `frame` may find a frame without a silence
        behind it."""
        self._model = bus_model
        self._speaker = speaker
        self._max_size = max_size
        self._is_behind_noise = False
        self._roles = ROLES if speaker is None else (speaker,)
        self._sizes: list[tuple[Direction, int]] = []
        """Each possible direction of the next frame with the frame's size in bytes in that
        direction; empty until its bytes tell the sizes."""
        self._run = b""
        self._run_size = 0
        """The number of undecided bytes that are known to be frames equal to `_run`."""
        self._run_decided = 0
        """The number of decided bytes of the run of equal frames, without its first frame."""

    def restart(self, removed: int, *, behind_noise: bool) -> None:
        """Forget the possible sizes of the next frame, as the first `removed` bytes are decided.

        `behind_noise` is True if the byte before the next frame belongs to no frame.
        """
        if self._run_size > 0:
            self._run_size -= removed
            self._run_decided += removed
        self._is_behind_noise = behind_noise
        self.needed = MIN_FRAME
        self._sizes = []

    def frame(
        self, data: bytes, start_ns: int, burst_over: bool
    ) -> tuple[int, Classification] | None:
        """Return the size and the direction of the frame that begins `data`; None if not certain.

        `start_ns` is the time at which the first byte of `data` began. `burst_over` is True if a
        silence follows `data`.
        """
        sizes = self._sizes or self._measure(data)
        if not sizes or (len(data) < self.needed and not burst_over):
            return None
        head = data[:MAX_RTU_ADU]
        size, roles = self._valid_size(head, sizes, start_ns)
        if not size:
            return None
        if self._speaker is not None:
            return size, Classification(self._speaker, DirectionBy.PORT, 1.0)
        model = self._model
        unit, pdu = head[0], head[1 : size - 2]
        if len(roles) == 1:  # Ordinary polling ends here, so that no cost is computed for it.
            if roles[0] is Direction.REQUEST:
                if self._is_known_request(unit, pdu):
                    return size, REQUEST_BY_FORM
            elif self._is_ordinary_response(unit, pdu, start_ns):
                return size, FITTING_RESPONSE
        elif pdu[0] in ECHOING and (len(model.states) == 1 or self._is_long_loop(data, size)):
            ordinary = self._ordinary_echo(model.states[0][1], unit, pdu, data)
            if ordinary is not None:
                return size, ordinary
        classified = model.classify(unit, pdu, start_ns, roles)
        if self._is_never_decided(unit, pdu, start_ns):
            return size, self._doubtful_classification(unit, pdu, start_ns)
        cost = model.cost(model.state, unit, pdu, classified.direction, start_ns)
        if cost > _MAX_COST and not (
            cost <= _MAX_COST + costs.PREVIOUS_UNANSWERED
            and self._is_next_request(classified, unit, pdu)
        ):
            return None
        if len(roles) > 1 and not self._is_direction_certain(classified, head, size):
            return None
        return size, classified

    def _valid_size(
        self, head: bytes, sizes: list[tuple[Direction, int]], start_ns: int
    ) -> tuple[int, list[Direction]]:
        """Return the size in bytes at which the CRC is correct, and the directions with that size.

        `sizes` are the sizes to try, `head` the next bytes, which began at `start_ns`. The size is
        0 if no CRC is correct. A frame that ends in 00 has a correct CRC one byte shorter too. So
        if two sizes are correct, the longer one counts if the shorter one is far less likely;
        otherwise the size is 0.
        """
        have = len(head)
        valid = []
        for role, size in sizes:
            if size <= have and crc(head[:size]) == 0:
                valid.append((size, role))
        if len(valid) == 1:
            size, role = valid[0]
            return size, _ONLY[role]
        if not valid or valid[0][0] == valid[1][0]:
            return (valid[0][0] if valid else 0), [role for _, role in valid]
        model = self._model
        shorter, longer = (
            model.cost(model.state, head[0], head[1 : size - 2], role, start_ns)
            for size, role in sorted(valid)
        )
        size, role = max(valid)
        is_certain = len(model.states) == 1 and longer + _FAR_LESS_LIKELY <= shorter
        return (size, [role]) if is_certain else (0, [])

    def is_incomplete(self, data: bytes, silences_at: Sequence[int]) -> bool:
        """True if `data` is certainly the incomplete beginning of the frame that is expected.

        `silences_at` are the offsets in `data` of the bytes that have a silence before them: none
        of these may begin a whole frame.
        """
        if self._speaker is not None:
            return False
        sizes = self._sizes or (self._measure(data) if len(data) >= MIN_FRAME else [])
        if not self._model.expects_incomplete(data, dict(sizes)):
            return False
        if any(size <= len(data) and crc(data[:size]) == 0 for _, size in sizes):
            return False
        return not any(self._is_frame(data[offset:]) for offset in silences_at)

    def _is_frame(self, data: bytes) -> bool:
        """True if the bytes begin with a whole frame that has a correct CRC."""
        sizes = [frame_size(data, role) or self._max_size for role in self._roles]
        return any(size <= len(data) and crc(data[:size]) == 0 for size in sizes)

    def _measure(self, data: bytes) -> list[tuple[Direction, int]]:
        """Return each possible direction of the frame that begins `data`, with its size in bytes.

        The list is empty if the bytes do not tell the size in every direction.
        """
        head = data[:MAX_RTU_ADU]
        sizes, longest = [], 0
        for role in self._roles:
            size = frame_size(head, role)
            if size == 0 and role is Direction.REQUEST and head[1] & EXCEPTION_BIT:
                continue  # An exception response. No request has such a function.
            if not size:
                self.needed = len(head) + 1 if size is None else self._max_size
                return []
            if size <= MAX_RTU_ADU:
                sizes.append((role, size))
                longest = size if size > longest else longest
        self.needed = longest + 1 if sizes else self._max_size
        self._sizes = sizes
        return sizes

    def _is_known_request(self, unit: int, pdu: bytes) -> bool:
        """True if this request was heard before, and begins where a request can begin."""
        return (unit, pdu) in self._model.history.requests and self._begins_request(unit, pdu)

    def _begins_request(self, unit: int, pdu: bytes) -> bool:
        """True if the next bytes cannot begin the expected response.

        It is False directly behind bytes that belong to no frame.
        """
        if self._is_behind_noise:
            return False
        for _, state in self._model.states:
            if state.pending is not None and state.pending.is_named_by(unit, pdu[0]):
                return False
        return True

    def _is_next_request(self, classified: Classification, unit: int, pdu: bytes) -> bool:
        """True if a frame is a request, by its form or since no response is like it.

        The request before it may have no response. False behind bytes that belong to no frame.
        """
        if classified is REQUEST_BY_FORM:
            return self._begins_request(unit, pdu)
        is_echo = pdu[0] in ECHOING and not self._model.history.timed
        return is_echo and classified.direction is Direction.REQUEST and not self._is_behind_noise

    def _is_never_decided(self, unit: int, pdu: bytes, start_ns: int) -> bool:
        """True if a frame that equals the one before may be its response, its retry or a new
        request, and no later frame can tell, as times are not known and the unit is silent
        otherwise.
        """
        return not self._model.history.timed and self._model.may_be_retry(unit, pdu, start_ns)

    def _doubtful_classification(self, unit: int, pdu: bytes, start_ns: int) -> Classification:
        """Return the likelier direction of a frame that equals the one before, as doubtful.

        If it is a retry, a request remains without a response.
        """
        model = self._model
        request, response = (model.cost(model.state, unit, pdu, role, start_ns) for role in ROLES)
        pending = model.state.pending
        if pending is not None:
            silent = model.history.silent_bits(model.state, pending)
            request += max(model.history.no_answer.bits - silent, costs.MIN_UNANSWERED)
        confidence = min(confidence_of(abs(request - response)), UNSURE)
        role = Direction.REQUEST if request < response else Direction.RESPONSE
        return Classification(role, DirectionBy.PENDING, confidence, is_final=True)

    def _is_ordinary_response(self, unit: int, pdu: bytes, start_ns: int) -> bool:
        """True if a frame surely costs nothing (`frame_cost`) as a response to the pending request.

        It fits that request, differs from it and is no later than earlier responses. False does not
        mean that it costs something: then its cost is computed.
        """
        model = self._model
        pending, history = model.state.pending, model.history
        if pending is None or unit > LAST_UNIT or pdu == pending.pdu or not pending.fits(unit, pdu):
            return False
        if pdu[0] in READ_BITS and not is_padded(pending.pdu, pdu):
            return False
        waited_ns = start_ns - pending.awaited_from_ns
        if history.trusts_silences and not history.latency.has_taken_as_long(waited_ns):
            return False
        return waited_ns <= MAX_PENDING_NS

    def _ordinary_echo(
        self, state: BusState, unit: int, pdu: bytes, data: bytes
    ) -> Classification | None:
        """Return the direction of a frame that equals its response, if the line is an ordinary one.

        It is a request if no other is pending, and the response if it equals the pending request
        and the frames behind it show that no response is missing. None does not mean that the
        direction is uncertain: then the costs of both directions are computed. `data` are the frame
        and the bytes behind it.
        """
        history, pending, overdue = self._model.history, state.pending, state.overdue
        if not 0 < unit <= LAST_UNIT or history.hears_only_slaves or is_implausible_request(pdu):
            return None
        if pending is not None and pending.unit != unit and not history.timed:
            if state.follows_damage or (overdue is not None and overdue.fits(unit, pdu)):
                return None
            bits = costs.UNREQUESTED_RESPONSE - _MAX_COST - history.no_answer.bits
            confidence = confidence_of(bits)
            return Classification(Direction.REQUEST, DirectionBy.IDLE, confidence, is_final=True)
        if overdue is not None and history.timed:
            return None
        may_be_late = overdue is not None and pending is None and overdue.fits(unit, pdu)
        if may_be_late and not self._are_pairs(data, len(pdu) + 3):
            return None
        if pending is not None:
            is_echo = not history.timed and pending.is_same(unit, pdu)
            silent = history.silent_bits(state, pending) if is_echo else 0.0
            if not is_echo or silent or history.retry.bits < costs.RETRY:
                return None
            size = len(pdu) + 3
            if self._is_response_by_what_follows(data, size):
                return FITTING_RESPONSE
            return self._classification_in_odd_run(Direction.RESPONSE, data, size)
        if state.follows_damage or state.last_ns is None:
            return None
        bits = costs.UNREQUESTED_RESPONSE - costs.REQUEST
        answered = state.answered
        if answered is not None and answered.is_same(unit, pdu):
            if history.trusts_silences:
                return None
            bits -= min(history.repeat.bits, costs.REPEAT_AGAIN if state.is_repeat else bits)
            odd = self._classification_in_odd_run(Direction.REQUEST, data, len(pdu) + 3)
            if odd is not None:
                return odd
        elif state.last_response == pdu:
            return None
        elif (unit, pdu) not in history.requests:
            bits -= costs.NEW_REQUEST
        return Classification(Direction.REQUEST, DirectionBy.IDLE, confidence_of(bits))

    def _is_response_by_what_follows(self, data: bytes, size: int) -> bool:
        """True if the frames behind the first one, which has `size` bytes and equals the pending
        request, show that it is the response and no retry.

        That is so if they cannot be the response to a retry. If they are equal, too, as those of a
        master that writes one value in a loop, they must be many, or come in pairs.
        """
        if self._model.silence_cost(self._model.state):
            return False
        after = data[size : 2 * size]
        if len(after) < 2 or after[:2] != data[:2]:
            return len(after) >= 2
        if len(after) < size:
            return False
        raw = data[:size]
        if after != raw:
            return crc(after) == 0 and data.startswith(after, 2 * size)
        if self._is_long_loop(data, size):
            return True
        count = self._count_ended_loop(data, size)
        return count % 2 == 1

    def _classification_in_odd_run(
        self, role: Direction, data: bytes, size: int
    ) -> Classification | None:
        """Return `role` for a frame of `size` bytes in a run of an odd number of equal frames.

        One request of the run has no response, and nothing tells which. So each is as likely, and
        the later the frame, the less likely are request and response by turns up to it. None if
        the run has an even number of frames, or its end is not heard yet.
        """
        count = self._count_ended_loop(data, size)
        is_request = role is Direction.REQUEST
        if not count or count % 2 != is_request:
            return None
        behind = (count + 1) // 2
        before = (self._run_decided // size + (1 if is_request else 2)) // 2
        by = DirectionBy.IDLE if is_request else DirectionBy.PENDING
        return Classification(role, by, behind / (behind + before), is_final=True)

    def _are_pairs(self, data: bytes, size: int) -> bool:
        """True if an even number of equal frames of `size` bytes follow each other, and another
        frame behind them.
        """
        count = self._count_run(data, data[:size])
        return count % 2 == 0 and not data.startswith(data[count * size : (count + 1) * size])

    def _count_ended_loop(self, data: bytes, size: int) -> int:
        """Return how many frames equal to the first one, of `size` bytes, follow each other.

        0 if more may follow, or if the master does not write one value in a loop, as far as is
        known.
        """
        history, raw = self._model.history, data[:size]
        if history.timed:
            return 0
        count = self._count_run(data, raw)
        is_long = self._run_decided // size + count >= _LOOP
        if history.repeat.bits > costs.REPEAT_AGAIN and not is_long:
            return 0
        is_over = not raw.startswith(data[count * size : (count + 1) * size])
        return count if is_over else 0

    def _is_long_loop(self, data: bytes, size: int) -> bool:
        """True if the next frame, of `size` bytes, is one of many equal ones, and the master is
        known to write one value in a loop.
        """
        history = self._model.history
        is_loop = not history.timed and history.repeat.bits <= costs.REPEAT_AGAIN
        return is_loop and self._count_run(data, data[:size]) >= _LONG_RUN

    def _count_run(self, data: bytes, raw: bytes) -> int:
        """Return how many frames equal to `raw` the bytes begin with."""
        end = self._run_size if self._run == raw and self._run_size > 0 else 0
        if not end:
            self._run_decided = 0
        end -= end % len(raw)
        while data.startswith(raw, end):
            end += len(raw)
        self._run, self._run_size = raw, end
        return end // len(raw)

    def _is_direction_certain(self, classified: Classification, head: bytes, size: int) -> bool:
        """True if the direction of a frame is certain although its form allows both directions.

        `head` are the frame, which has `size` bytes, and bytes behind it.
        """
        if self._model.state.last_ns is None:
            return False  # The frames behind the first one of a capture tell its direction.
        if self._model.history.trusts_silences:
            # If an equal frame follows at once, that frame may be the response and this one a
            # retry.
            behind = head[size : 2 * size]
            is_repeated = behind and head.startswith(behind)
            is_response = classified.direction is Direction.RESPONSE
            return classified.confidence >= SURE and not (is_response and is_repeated)
        if classified.direction is Direction.REQUEST:
            return classified.confidence >= _REQUEST_CONFIDENCE
        # If silences do not tell who speaks, two equal frames may be a request and its echo, or a
        # request and its retry. A third frame with the same unit and function can be the response
        # to the retry, and a long last silence the wait for a missing response. Then the search has
        # to decide.
        return (
            classified.confidence >= _RESPONSE_CONFIDENCE
            and not head.startswith(head[size : size + 2])
            and not self._model.silence_cost(self._model.state)
        )
