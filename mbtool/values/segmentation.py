"""Divides the registers of a range into values, by what every division costs."""

# Every part of a range may be a value: one register, two with an integer, four with a float. Each
# such candidate has a cost in bits. A division is a series of candidates that covers the range. Its
# cost is the sum of the costs of its candidates, and of a cost for each change from one kind to
# another, because values of the same kind are often neighbours. The best division is the cheapest
# one. The likelihood of a candidate is the share of all divisions that contain it, each weighted
# with 2 to the power of its negative cost (the forward-backward algorithm of a semi-Markov chain).
#
# Time and memory: proportional to the number of candidates.

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mbtool.values.word_readings import WordReading

STAYS = 0.6
"""The probability (0 to 1) that the next value has the kind of the one before because the device's
manual lists equal kinds together; else its kind is drawn from the shares of kinds."""


class Kind(StrEnum):
    """What a value takes: how many registers, and what they hold."""

    WORD = "word"
    INT2 = "int of 2"
    FLOAT2 = "float of 2"
    BCD2 = "BCD of 2"
    INT4 = "int of 4"
    FLOAT4 = "float of 4"
    TEXT = "text"


SHARES = {
    Kind.WORD: 0.60,
    Kind.INT2: 0.17,
    Kind.FLOAT2: 0.15,
    Kind.BCD2: 0.005,
    Kind.INT4: 0.02,
    Kind.FLOAT4: 0.035,
    Kind.TEXT: 0.02,
}
"""The share (0 to 1) of values of each kind, before anything is known of the device."""


class Option(NamedTuple):
    """A way to read a candidate, and its cost in bits."""

    reading: WordReading
    cost: float


class Candidate(NamedTuple):
    """A part of a range that may be one value."""

    at: int
    """The index in the range of the number's first register."""
    words: int
    kind: Kind
    options: Sequence[Option]
    cost: float
    """The cost of all options together, in bits."""


class ValuePart(NamedTuple):
    """A candidate that the best division has."""

    candidate: Candidate
    likelihood: float


class Division(NamedTuple):
    """The best division of a range, and the likelihood of every candidate."""

    parts: list[ValuePart]
    likelihoods: list[tuple[Candidate, float]]


def joined_cost(costs: Iterable[float]) -> float:
    """The cost of one of several things: that of a sum of probabilities."""
    some = list(costs)
    least = min(some, default=math.inf)
    if math.isinf(least):
        return least
    return least - math.log2(sum(2.0 ** (least - one) for one in some))


def divide(length: int, candidates: Sequence[Candidate], shares: Mapping[Kind, float]) -> Division:
    """Divide a range of registers.

    `candidates` must have one of one register at each place. `shares` says how frequent each kind
    is in the device; the sum is 1.
    """
    kinds = list(Kind)
    first = {kind: -math.log2(shares[kind]) for kind in kinds}
    steps = {
        (before, kind): -math.log2((1 - STAYS) * shares[kind] + STAYS * (before is kind))
        for before in kinds
        for kind in kinds
    }
    by_start: list[list[Candidate]] = [[] for _ in range(length)]
    for one in candidates:
        by_start[one.at].append(one)

    def entering(kind: Kind, at: int, costs: Sequence[Mapping[Kind, float]]) -> list[float]:
        if at == 0:
            return [first[kind]]
        return [cost + steps[before, kind] for before, cost in costs[at].items()]

    forward: list[dict[Kind, float]] = [{} for _ in range(length + 1)]
    best: list[dict[Kind, float]] = [{} for _ in range(length + 1)]
    from_: list[dict[Kind, tuple[Candidate, Kind | None]]] = [{} for _ in range(length + 1)]
    for at in range(length):
        for one in by_start[at]:
            end, kind = at + one.words, one.kind
            cost = joined_cost(entering(kind, at, forward)) + one.cost
            forward[end][kind] = joined_cost((forward[end].get(kind, math.inf), cost))
            before = min(best[at], key=lambda own: best[at][own] + steps[own, kind], default=None)
            cost = one.cost + (
                first[kind] if before is None else best[at][before] + steps[before, kind]
            )
            if cost < best[end].get(kind, math.inf):
                best[end][kind] = cost
                from_[end][kind] = one, before
    backward: list[dict[Kind, float]] = [dict.fromkeys(kinds, 0.0) for _ in range(length + 1)]
    for at in range(length - 1, 0, -1):
        rest = [(one.kind, one.cost + backward[at + one.words][one.kind]) for one in by_start[at]]
        for before in kinds:
            backward[at][before] = joined_cost(steps[before, kind] + cost for kind, cost in rest)
    total = joined_cost(forward[length].values())
    likelihoods = []
    for one in candidates:
        cost = joined_cost(entering(one.kind, one.at, forward)) + one.cost
        cost += backward[one.at + one.words][one.kind]
        likelihoods.append((one, min(2.0 ** (total - cost), 1.0)))
    known = {id(one): likelihood for one, likelihood in likelihoods}
    parts: list[ValuePart] = []
    at = length
    last = min(best[length], key=lambda own: best[length][own]) if length else None
    while at and last is not None:
        one, last = from_[at][last]
        parts.append(ValuePart(one, known[id(one)]))
        at = one.at
    return Division(parts[::-1], likelihoods)
