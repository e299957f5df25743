"""The history of a serial line: the requests, response times and repetitions heard so far."""

# Memory: at most MAX_REQUESTS requests, and for each function of each unit one entry in each of
# `functions`, `echo_latencies`, `wrong_echoes` and `usual_echoes`.

from __future__ import annotations

from math import log2
from typing import TYPE_CHECKING

from mbtool.modbus.functions import ECHOING, EXCEPTION_BIT
from mbtool.serial_line import costs
from mbtool.serial_line.line_statistics import LatencyStatistics, LearnedCost
from mbtool.serial_line.response_timeout import ResponseTimeout

if TYPE_CHECKING:
    from mbtool.serial_line.bus_state import BusState, PendingRequest

MAX_REQUESTS = 1024
"""At most this many requests of a line are remembered; beyond that, the one heard least recently is
forgotten."""

KNOWN_HEAD = 4
"""The least number of bytes (unit, function and address) by which the beginning of a frame is
compared with the requests heard before."""
PAUSE_GROWTH = 1.01
"""Each pause (the silence from a response to the next request) makes the shortest pause on record
1 % longer, so that one unusually short pause is forgotten."""
ONE_SIDE = 3
"""Once this many responses in a row came that nobody requested, only the slaves are heard.
`unasked` counts them. A capture begins with a count of 1."""
ENOUGH_PAUSES = 16
"""After this many pauses the shortest pause of the line counts as known."""


class LineHistory:
    """The facts learned from earlier frames of a line; the cost of a frame depends on them."""

    def __init__(self, *, timed: bool) -> None:
        """`timed` is False if the bytes have no known times, as in a raw file."""
        self.timed = timed
        self.trusts_silences = timed
        """True if silences tell who speaks. False if the bytes have no known times, or if the
        adapter merges frames."""
        self.least_silence_ns = 0
        """A silence up to this length, in ns, is usual on any line of this baud rate."""
        self.hears_silences = False
        """True once a silence of t3.5 was heard between two frames or inside one."""
        self.merges_briefly = False
        """True if the adapter merges frames, but never holds bytes back until a retry: a request
        and its retry come as two bursts."""
        self.may_merge_long = False
        """True if the adapter merges frames, and may hold bytes back until a retry: then a silence
        before a frame may be the adapter's."""
        self.latency = LatencyStatistics()
        self.timeout = ResponseTimeout()
        self.echo_latencies: dict[tuple[int, int], LatencyStatistics] = {}
        """By unit and function, the longest response time of writes whose response equals the
        request. In many devices a write takes longer than a read."""
        self.all_echo_latencies = LatencyStatistics()
        """The longest response time of all writes in `echo_latencies` together."""
        self.unanswered: dict[int, int] = {}
        """By unit, the number of requests in a row that had no response."""
        self.answering: set[int] = set()
        """The units that sent a response which cannot have been a retry of the request."""
        self.shortest_pause_ns = 0.0
        """The shortest recent silence, in ns, from a response to the next request."""
        self.pauses = 0
        """The number of silences from a response to the next request that were heard."""
        self.unexplained_silences = LatencyStatistics()
        """The longest silence before frames that the adapter merged, learned from silences in which
        no response was missing."""
        self.repeat = LearnedCost(costs.REPEAT_AFTER_RESPONSE, costs.REPEAT_AFTER_RESPONSE_LIMITS)
        self.retry = LearnedCost(costs.RETRY, costs.RETRY_LIMITS)
        self.no_answer = LearnedCost(costs.PREVIOUS_UNANSWERED, costs.PREVIOUS_UNANSWERED_LIMITS)
        self.rewrite = LearnedCost(costs.REWRITE, costs.REWRITE_LIMITS)
        self.wrong_echoes: dict[tuple[int, int], int] = {}
        """By unit and function, the number of responses that were probably wrong echoes, up to
        costs.WRONG_ECHOES. A wrong echo repeats another value than the request, or, of 0FH and 10H,
        the whole request."""
        self.usual_echoes: set[tuple[int, int]] = set()
        """The pairs of unit and function, 0FH or 10H, that had a response of the usual form."""
        self.requests: dict[tuple[int, bytes], None] = {}
        """Unit and PDU of the requests heard, in the order in which they were last heard."""
        self.functions: set[tuple[int, int]] = set()
        """The pairs of unit and function code that some request has had."""
        self.units: set[int] = set()
        self.unasked = 1
        """The number of responses, certain by their form, that nobody requested and that had no
        damaged bytes before them, since the last request that was certain by its form."""
        self.hears_only_slaves = False
        """True if only the slaves are heard, as on one pair of a four-wire line: ONE_SIDE responses
        were `unasked`."""

    @property
    def may_hear_only_slaves(self) -> bool:
        """True if the only frames that are certain by their form are responses."""
        return 1 < self.unasked < ONE_SIDE

    def has_function(self, head: bytes) -> bool:
        """True if some request had the unit, and the function, with which a frame begins.

        `head` is the frame's first byte (then only the unit is compared) or its first two bytes.
        The function code may be that of an exception response.
        """
        if len(head) == 1:
            return head[0] in self.units
        return len(head) == 2 and (head[0], head[1] & ~EXCEPTION_BIT) in self.functions

    def begins_request(self, head: bytes) -> bool:
        """True if a request that was heard before begins with `head`, up to its address."""
        if len(head) < KNOWN_HEAD or not self.has_function(head[:2]):
            return False
        unit, begin = head[0], head[1:]
        return any(pdu.startswith(begin[: len(pdu)]) for one, pdu in self.requests if one == unit)

    def shows_master_wait(self, waited_ns: int) -> bool:
        """True if `waited_ns` between two frames tells how long the master waited.

        If it is 0, an adapter has merged the two, and may have held them back for long.
        """
        if not self.trusts_silences:
            return False
        return self.hears_silences if waited_ns > 0 else self.merges_briefly

    def master_still_waits(self, waited_ns: int) -> bool | None:
        """True if a master surely still waits for a response `waited_ns` after its request.

        False if it may have sent a retry. None if silences do not tell who speaks on this line.
        """
        if not self.trusts_silences:
            return None
        if self.timeout.is_known:
            return self.timeout.is_not_over(waited_ns)
        if waited_ns < LatencyStatistics.MIN_RETRY_NS:
            return True
        return None if self.may_merge_long else False

    def silent_bits(self, state: BusState, pending: PendingRequest) -> float:
        """The cost, in bits, of supposing that a unit answers `pending` after it was silent lately.

        The cost grows with the number of requests in a row that the unit did not answer.
        SILENT_UNIT is added if silences do not tell who speaks, the response to this function
        equals its request, and other units have answered but this unit never has (not even the
        request before, which `pending` repeats).
        """
        unit, bits = pending.unit, self.unanswered_bits(pending.unit)
        is_known = unit in self.answering or state.is_repeat
        if self.trusts_silences or is_known or pending.pdu[0] not in ECHOING:
            return bits
        return bits + costs.SILENT_UNIT if self.answering else bits

    def unanswered_bits(self, unit: int) -> float:
        """The cost, in bits, of supposing that a unit answers that left the last requests of it
        unanswered.
        """
        unanswered = self.unanswered.get(unit, 0)
        return log2(1 + unanswered) if unanswered else 0.0

    def learn_request(
        self, state: BusState, unit: int, pdu: bytes, by_form: bool, start_ns: int
    ) -> None:
        """Learn from a request that came in a bus state. Its first byte began at `start_ns`.

        `by_form` is True if by its form the request cannot be a response.
        """
        request, requests = (unit, pdu), self.requests
        if request in requests:
            del requests[request]  # It moves to the end.
        else:
            self.functions.add((unit, pdu[0]))
            self.units.add(unit)
        requests[request] = None
        if len(requests) > MAX_REQUESTS:
            del requests[next(iter(requests))]
        is_unanswered = state.pending is not None and not state.pending.is_same(unit, pdu)
        if is_unanswered or not self.no_answer.is_at_rest:
            self.no_answer.learn(is_unanswered)
        if pdu[0] in ECHOING and (before := state.answered or state.pending) is not None:
            self.rewrite.learn(before.has_address_of(unit, pdu) and before.pdu != pdu)
        if state.answered is not None:
            is_repeat = state.answered.is_same(unit, pdu)
            if is_repeat or not self.repeat.is_at_rest:
                self.repeat.learn(is_repeat)
            pause_ns = start_ns - (state.last_ns or start_ns)
            known_ns = self.shortest_pause_ns * PAUSE_GROWTH if self.pauses else pause_ns
            self.shortest_pause_ns = pause_ns if pause_ns < known_ns else known_ns
            self.pauses += 1
        if by_form:  # Otherwise the frame may be a response.
            pending = state.pending
            is_retry = pending is not None and pending.is_same(unit, pdu)
            if is_retry or not self.retry.is_at_rest:
                self.retry.learn(is_retry)
            if is_retry and pending is not None and self.trusts_silences:
                waited_ns = start_ns - pending.awaited_from_ns
                if waited_ns >= LatencyStatistics.MIN_RETRY_NS:  # An earlier one is a copy.
                    self.timeout.learn(waited_ns)

    def learn_latency(
        self, pending: PendingRequest, pdu: bytes, start_ns: int, is_sure: bool
    ) -> None:
        """Learn how long a slave took to answer `pending`; the response began at `start_ns`.

        `pdu` is the response's PDU. `is_sure` is True if it is surely a response and no retry.
        """
        latency_ns = start_ns - pending.awaited_from_ns
        if pdu != pending.pdu and is_sure:
            self.latency.learn(latency_ns)
        elif latency_ns < LatencyStatistics.MIN_RETRY_NS:  # A later one may have been a retry.
            self.latency.learn_capped(latency_ns)

    def learn_echo(self, answered: PendingRequest, latency_ns: int) -> None:
        """Learn that a slave took `latency_ns` for a response that equals the request `answered`.

        The frame after this response has shown that the response was no retry.
        """
        key = answered.unit, answered.pdu[0]
        self.echo_latencies.setdefault(key, LatencyStatistics()).learn(latency_ns)
        self.all_echo_latencies.learn(latency_ns)

    def learn_wrong_echo(self, unit: int, function: int) -> None:
        """Note a response that was probably a wrong echo, of a unit that also answers otherwise."""
        if unit not in self.answering:
            return
        times = self.wrong_echoes.get((unit, function), 0) + 1
        self.wrong_echoes[unit, function] = min(times, costs.WRONG_ECHOES)

    def learn_answer(self, unit: int) -> None:
        """Note that a unit has answered, by a response that cannot be a retry."""
        self.answering.add(unit)
        self.unanswered.pop(unit, None)

    def learn_no_answer(self, unit: int) -> None:
        """Note that a request to a unit had no response."""
        self.unanswered[unit] = self.unanswered.get(unit, 0) + 1
