"""What a serial line has shown so far: its requests, its response times, and its repetitions."""

# Bounded: MAX_REQUESTS requests, and at most one entry for each function of each unit.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.serial_line import costs
from mbtool.serial_line.line_statistics import LatencyStatistics, LearnedCost

if TYPE_CHECKING:
    from mbtool.serial_line.bus_state import BusState, PendingRequest

MAX_REQUESTS = 1024
"""How many requests of a line are remembered; beyond that, the one heard least recently is
forgotten."""


class LineHistory:
    """What earlier frames of a line have shown; the cost of a frame depends on it."""

    def __init__(self, *, timed: bool) -> None:
        """`timed` is False if the bytes' times are not known."""
        self.timed = timed
        self.trusts_silences = timed
        """True if silences tell who speaks; False without times or if the adapter merges frames."""
        self.latency = LatencyStatistics()
        self.unexplained_silences = LatencyStatistics()
        """The silences between merged frames in which no response was missing."""
        self.repeat = LearnedCost(costs.REPEAT_AFTER_RESPONSE, costs.REPEAT_AFTER_RESPONSE_LIMITS)
        self.retry = LearnedCost(costs.RETRY, costs.RETRY_LIMITS)
        self.requests: dict[tuple[int, bytes], None] = {}
        """Unit and PDU of the requests heard, in the order in which they were last heard."""
        self.functions: set[tuple[int, int]] = set()
        """Each unit and function code that a request has named together."""
        self.units: set[int] = set()

    def has_function(self, head: bytes) -> bool:
        """True if a request has named the unit, and the function if given, that begin a frame.

        `head` is the unit, or the unit and the function code, also that of an exception response.
        """
        if len(head) == 1:
            return head[0] in self.units
        return len(head) == 2 and (head[0], head[1] & ~EXCEPTION_BIT) in self.functions

    def learn_request(self, state: BusState, unit: int, pdu: bytes, by_form: bool) -> None:
        """Learn from a request that came in a bus state.

        `by_form` is True if by its form the frame cannot be a response.
        """
        self.functions.add((unit, pdu[0]))
        self.units.add(unit)
        self.requests.pop((unit, pdu), None)
        self.requests[unit, pdu] = None
        if len(self.requests) > MAX_REQUESTS:
            del self.requests[next(iter(self.requests))]
        if state.answered is not None:
            self.repeat.learn(state.answered.is_same(unit, pdu))
        if by_form:  # Otherwise a response may have been taken for a retry.
            pending = state.pending
            self.retry.learn(pending is not None and pending.is_same(unit, pdu))

    def learn_latency(
        self, pending: PendingRequest, pdu: bytes, start_ns: int, is_sure: bool
    ) -> None:
        """Learn how long the slave took to answer `pending`; its response began at `start_ns`.

        `is_sure` is True if the frame is surely a response.
        """
        latency_ns = start_ns - pending.awaited_from_ns
        if pdu != pending.pdu and is_sure:
            self.latency.learn(latency_ns)
        elif latency_ns < LatencyStatistics.MIN_RETRY_NS:  # Otherwise it may have been a retry.
            self.latency.learn_capped(latency_ns)
