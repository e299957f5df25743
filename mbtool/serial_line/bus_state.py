"""The bus state of a serial line: the pending request, an overdue one, and what came last."""

# A bus state is an immutable value, so that the search can suppose one for each of its paths
# (explanations of the bytes), and compare them. bus_model.py computes the state that follows a
# frame.

from __future__ import annotations

import math
from collections.abc import Iterable

import msgspec
from msgspec.structs import replace

from mbtool.core import Direction
from mbtool.modbus.expected_response import ExpectedResponse

DOUBT_BITS = 6.0
"""An explanation that costs at least this many bits more than the best one is ignored: it is true
once in 65 times."""
MAX_PENDING_NS = 1_000_000_000
"""A request is pending for at most this time, in ns; after that the master may send again. Serial
Line V1.02, 2.4.1, gives 1 s to several seconds as the usual response timeout."""
ENOUGH_CHANGES = 3
"""The directions count as known once this many requests differed from the response before them,
where that response had repeated its own request; see `BusState.changes`."""
MAX_STATES = 4
"""The most bus states that are considered possible at once."""


class PendingRequest(msgspec.Struct, frozen=True, gc=False):
    """A request that has no response so far."""

    unit: int
    pdu: bytes
    expected: ExpectedResponse
    awaited_from_ns: int
    """The time, in ns, at which the wait for the response began: the end of this request or, if the
    master has given it up, the end of the request sent after it."""
    silence_before_ns: int | None
    """The silence before this request, in ns; None for the first frame of a capture."""

    def is_same(self, unit: int, pdu: bytes) -> bool:
        """True if a frame's unit and PDU equal this request's."""
        return unit == self.unit and pdu == self.pdu

    def has_address_of(self, unit: int, pdu: bytes) -> bool:
        """True if unit, function and address of a frame equal this request's."""
        return unit == self.unit and pdu[:3] == self.pdu[:3]

    def fits(self, unit: int, pdu: bytes) -> bool:
        """True if a frame can be the response to this request, or its exception response."""
        return unit == self.unit and self.expected.fits(pdu)

    def is_named_by(self, unit: int, code: int) -> bool:
        """True if a response with this unit and code can answer this request.

        `code` is a function code, with the exception bit in an exception response.
        """
        return unit == self.unit and self.expected.is_named_by(code)


class BusState(msgspec.Struct, frozen=True, gc=False):
    """The pending request and the last frame of a serial line, which tell who may speak next."""

    pending: PendingRequest | None = None
    overdue: PendingRequest | None = None
    """The request that the master gave up, or whose response was damaged, so that its response may
    still come late; None without such a request."""
    answered: PendingRequest | None = None
    """The request that the last frame answered; None if the last frame is no answer to a known
    request."""
    answered_after_ns: int = 0
    """The time, in ns, from the end of the answered request to the start of its response; 0 if
    silences do not tell who speaks."""
    retries: int = 0
    """The number of requests directly before the pending one that equal it and had no response."""
    is_repeat: bool = False
    """True if the request that is pending or was just answered equals the request before it, and
    that earlier request had a response."""
    last_response: bytes = b""
    """The PDU of the last frame if that was a response, to a known request or not; else empty."""
    follows_damage: bool = False
    """True if damaged bytes came last. They may have held a request."""
    direction_known: bool = False
    """True if some earlier frame, by its form, could only be a request or only a response, or if
    there were ENOUGH_CHANGES `changes`."""
    changes: int = 0
    """The number of times, up to ENOUGH_CHANGES, that a request followed a response which repeated
    its request, and differed from it. If requests and responses were mixed up, the differing frame
    would be the response to that response."""
    last_ns: int | None = None
    """The time at which the last frame ended, in ns; None at the start of a capture."""
    unexplained_silence_ns: int = 0
    """The length, in ns, of the last silence that was not the wait for a missing response. Used
    only when the adapter merges frames: then it is unknown between which frames the silence was."""

    def pending_at(self, at_ns: int) -> PendingRequest | None:
        """The request that is pending at a time in ns.

        None if there is none, or if it has waited more than MAX_PENDING_NS.
        """
        pending = self.pending
        if pending is None or at_ns - pending.awaited_from_ns > MAX_PENDING_NS:
            return None
        return pending

    def has_recent_request(self, unit: int, code: int) -> bool:
        """True if the request just answered, or the one given up, has this unit and function."""
        return any(one.is_named_by(unit, code) for one in (self.answered, self.overdue) if one)

    def awaits_exactly(self, unit: int, code: int, size: int) -> bool:
        """True if the pending request's normal response has this unit, function and PDU size."""
        pending = self.pending
        if pending is None:
            return False
        expected = pending.expected
        return (pending.unit, expected.code, expected.size) == (unit, code, size)

    def settles_silence(self, role: Direction, start_ns: int, inside_ns: int) -> bool:
        """True if a frame changes `unexplained_silence_ns`, the last silence without a known cause.

        It does if there is a silence before the frame, which began at `start_ns`, or inside it; the
        longest one inside is `inside_ns`. A request after an unanswered request changes nothing:
        the missing response explains the silence before it.
        """
        if not self.unexplained_silence_ns or (role is Direction.REQUEST and self.answered is None):
            return False
        return inside_ns > 0 or start_ns - (self.last_ns or start_ns) > 0

    def after_damage(self) -> BusState:
        """Return the bus state that follows this one after bytes that could not be read."""
        overdue = self.pending or self.overdue
        return replace(
            self, pending=None, overdue=overdue, follows_damage=True, unexplained_silence_ns=0
        )


CostedState = tuple[float, BusState]
"""The extra cost of a bus state over the most likely one, in bits, and the bus state."""


def most_likely(states: Iterable[CostedState]) -> list[CostedState]:
    """Return the different states whose extra cost is below DOUBT_BITS, the cheapest first, at most
    MAX_STATES.
    """
    kept: list[CostedState] = []
    for bits, state in sorted(states, key=lambda one: one[0]):
        if bits < DOUBT_BITS and len(kept) < MAX_STATES and all(state != one for _, one in kept):
            kept.append((bits, state))
    return kept


def confidence_of(bits: float) -> float:
    """Return the probability (0.5 to 1) of the cheaper of two explanations whose costs differ by
    `bits`.
    """
    return 1 / (1 + math.exp2(-bits))


NO_RIVAL_CONFIDENCE = confidence_of(DOUBT_BITS)
"""If the direction of a frame has at least this confidence (0.5 to 1), the bus state that would
follow from the other direction is not kept."""


def bits_of(confidence: float) -> float:
    """Return the number of bits by which the costs of two explanations differ if the cheaper one
    has this confidence (0.5 to 1).

    It is the inverse of `confidence_of`; infinite for a confidence of 1.
    """
    return math.log2(confidence / (1 - confidence)) if confidence < 1 else math.inf
