"""Whose turn it may be on a bus, as values: what waits for an answer, and what was answered."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.modbus.expected_response import ExpectedResponse

if TYPE_CHECKING:
    from collections.abc import Iterable

DOUBT = 6.0
"""Bits: what is so much dearer raises no doubt."""
MOST_TURNS = 4
"""How many turns are thought possible at once."""


class PendingRequest(msgspec.Struct, frozen=True, gc=False):
    """A request that has not been answered."""

    unit: int
    pdu: bytes
    expected: ExpectedResponse
    since_ns: int
    """The time of its last byte."""
    before_ns: int | None
    """The silence before it, where something was heard before."""

    def since(self, since_ns: int) -> PendingRequest:
        """The same, as if it had been asked at another time."""
        return PendingRequest(self.unit, self.pdu, self.expected, since_ns, self.before_ns)

    def asks(self, unit: int, pdu: bytes) -> bool:
        """Whether it is this very request."""
        return unit == self.unit and pdu == self.pdu

    def fits(self, unit: int, pdu: bytes) -> bool:
        return unit == self.unit and self.expected.fits(pdu)

    def is_named_by(self, unit: int, code: int) -> bool:
        return unit == self.unit and self.expected.is_named_by(code)


class BusState(msgspec.Struct, frozen=True, gc=False):
    """Who may speak next."""

    waiting: PendingRequest | None = None
    owed: PendingRequest | None = None
    """A request that the master gave up, or whose answer was damaged: it may still come."""
    answered: PendingRequest | None = None
    """The request that the last frame answered."""
    answer: bytes = b""
    """The PDU of the last frame, if that is a response, whether or not it answers any."""
    lost: bool = False
    """Whether damage came before, in which a request may have gone unheard."""
    sure: bool = False
    """Whether a frame was heard that is surely a request, or surely a response."""
    last_ns: int | None = None
    """The time of the last frame's last byte; None at the start of a capture."""
    pause_ns: int = 0
    """On a line whose frames are glued, the last silence heard, if no missing answer explains it:
    it may have been anywhere among the frames glued behind it."""

    def is_of_turn(self, unit: int, code: int) -> bool:
        """Whether the request that was just answered, or is owed an answer, is named so."""
        answered, owed = self.answered, self.owed
        return (answered is not None and answered.is_named_by(unit, code)) or (
            owed is not None and owed.is_named_by(unit, code)
        )

    def foresees(self, unit: int, code: int, size: int) -> bool:
        """Whether just a response of this size of its PDU is due now."""
        waiting = self.waiting
        return waiting is not None and (
            waiting.unit,
            waiting.expected.code,
            waiting.expected.size,
        ) == (unit, code, size)

    def ends_pause(self, role: Direction, start_ns: int, inside_ns: int) -> bool:
        """Whether a frame leaves the last silence to what came before it."""
        if not self.pause_ns or (role is Direction.REQUEST and self.answered is None):
            return False
        return inside_ns > 0 or start_ns - (self.last_ns or start_ns) > 0

    def behind_damage(self) -> BusState:
        """The turn after bytes that could not be read."""
        owed = self.waiting or self.owed
        return BusState(
            None, owed, self.answered, self.answer, lost=True, sure=self.sure, last_ns=self.last_ns
        )


Weighed = tuple[float, BusState]
"""A turn, and by how many bits it is dearer than the likeliest."""


def likeliest(turns: Iterable[Weighed]) -> list[Weighed]:
    """The likeliest turns, each once, the first of them first."""
    kept: list[Weighed] = []
    for bits, turn in sorted(turns, key=lambda one: one[0]):
        if bits < DOUBT and len(kept) < MOST_TURNS and all(turn != one for _, one in kept):
            kept.append((bits, turn))
    return kept


def likelihood(bits: float) -> float:
    """How sure the better of two explanations is that differ by so many bits, 0.5 to 1."""
    return 1 / (1 + math.exp2(-bits))


BEYOND_DOUBT = likelihood(DOUBT)
"""How sure one is beside which no other is kept."""


def bits_of(confidence: float) -> float:
    """By how many bits the better of two explanations is cheaper; the reverse of `likelihood`."""
    return math.log2(confidence / (1 - confidence)) if confidence < 1 else math.inf


def is_like(answer: bytes, other: bytes, request: bytes) -> bool:
    """Whether two PDUs can both be answers to a request."""
    return len(answer) == len(other) and (answer == request) == (other == request)
