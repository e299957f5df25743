"""Values that move over time: what a signal is at a moment, and nothing else."""

# A signal is a function of the time since the slave began: the same moment gives the same value,
# whatever was asked before. Moments are integer nanoseconds from 0 on.
#
#     ramp   from the first value to the last one, then from the first again
#     sine   between the lowest and the highest value, from the middle upwards
#     walk   from the middle, a random step every so often; its steps are normally distributed, and
#            it turns back at the lowest and the highest value
#
# A walk at its n-th step is a sum of n random numbers, but not added up one by one, as a slave that
# is asked once a day could not wait for that. It is a Brownian motion known at 1, 2, 4, 8, ...
# steps; between two known moments the middle one is drawn around the mean of both (Lévy's
# construction), and so on down to step n: about 2 log2(n) draws. Each draw is a hash of the seed
# and of its place, so the order of asking does not matter.

from __future__ import annotations

import math
from dataclasses import dataclass, field
from hashlib import blake2b
from statistics import NormalDist
from typing import Protocol

_NORMAL = NormalDist()
_DRAWS = 1 << 53


class Signal(Protocol):
    """A value that depends on the time alone."""

    @property
    def lowest(self) -> float: ...

    @property
    def highest(self) -> float: ...

    def at(self, moment_ns: int) -> float:
        """The value at a moment since the beginning."""
        ...


@dataclass(frozen=True, slots=True)
class Ramp:
    """A sawtooth; it falls where the last value is the lower one."""

    first: float
    last: float
    period_ns: int

    @property
    def lowest(self) -> float:
        return min(self.first, self.last)

    @property
    def highest(self) -> float:
        return max(self.first, self.last)

    def at(self, moment_ns: int) -> float:
        share = moment_ns % self.period_ns / self.period_ns
        return self.first + (self.last - self.first) * share


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine."""

    lowest: float
    highest: float
    period_ns: int

    def at(self, moment_ns: int) -> float:
        swing = math.sin(2 * math.pi * (moment_ns % self.period_ns) / self.period_ns)
        value = (self.lowest + self.highest) / 2 + (self.highest - self.lowest) / 2 * swing
        return min(max(value, self.lowest), self.highest)


@dataclass(slots=True)
class Walk:
    """A random walk between two values."""

    lowest: float
    highest: float
    step: float
    """The standard deviation of one step."""
    every_ns: int
    seed: str
    _last: tuple[int, float] = field(default=(0, 0.0), repr=False)
    """The place on the way that was asked for last, as the time between two steps is long."""

    def at(self, moment_ns: int) -> float:
        place = moment_ns // self.every_ns
        if place != self._last[0]:
            self._last = place, self._way(place)
        width = self.highest - self.lowest
        way = (width / 2 + self.step * self._last[1]) % (2 * width) if width else 0.0
        return self.lowest + min(way, 2 * width - way)

    def _way(self, place: int) -> float:
        """Where a walk of unit steps without ends is after so many of them."""
        begin, end, way_begin, way_end = 0, 1, 0.0, self._draw(0, 1)
        while end < place:
            way_begin, way_end = way_end, way_end + math.sqrt(end) * self._draw(end, 2 * end)
            begin, end = end, 2 * end
        while place not in (begin, end):
            middle = (begin + end) // 2
            spread = math.sqrt(end - begin) / 2
            way = (way_begin + way_end) / 2 + spread * self._draw(begin, middle)
            if place < middle:
                end, way_end = middle, way
            else:
                begin, way_begin = middle, way
        return way_begin if place == begin else way_end

    def _draw(self, begin: int, at: int) -> float:
        """A normally distributed number that belongs to a place."""
        digest = blake2b(f"{self.seed}/{begin}/{at}".encode(), digest_size=8).digest()
        number = int.from_bytes(digest, "big") >> 11
        return _NORMAL.inv_cdf((number + 0.5) / _DRAWS)
