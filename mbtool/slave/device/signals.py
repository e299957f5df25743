"""Values that change over time, each computed from the time since the slave's first request."""

# Times are integer nanoseconds from 0 on.
#
#     ramp    rises (or falls) evenly from the first value to the last, then begins again
#     sine    swings between the lowest and the highest value and begins in the middle, rising
#     steps   shows one value after the other, each for the same time, then begins again
#     walk    begins in the middle and takes a random step at regular times; the size of a step is
#             normally distributed, and the walk turns back at the lowest and the highest value
#
# Ramp, sine and steps depend on the time alone. A walk is computed step by step from its seed, so
# the same seed gives the same walk. If more than MAX_STEPS steps are due since the last request,
# only MAX_STEPS of them are computed, so that a response is delayed by at most about 50 ms.

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Protocol

MAX_STEPS = 100_000


class Signal(Protocol):
    """A value that changes over time."""

    @property
    def lowest(self) -> float: ...

    @property
    def highest(self) -> float: ...

    def at(self, moment_ns: int) -> float:
        """Return the value at `moment_ns`, in ns since the first request.

        No call may have an earlier moment than the call before it.
        """
        ...


@dataclass(frozen=True, slots=True)
class Ramp:
    """A sawtooth from `first` to `last`; it falls if `last` is the lower one."""

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
    """A sine wave between `lowest` and `highest`; one swing takes `period_ns`."""

    lowest: float
    highest: float
    period_ns: int

    def at(self, moment_ns: int) -> float:
        swing = math.sin(2 * math.pi * (moment_ns % self.period_ns) / self.period_ns)
        value = (self.lowest + self.highest) / 2 + (self.highest - self.lowest) / 2 * swing
        return min(max(value, self.lowest), self.highest)


@dataclass(frozen=True, slots=True)
class Steps:
    """A signal that has each of several values for `every_ns`, in turn."""

    values: Sequence[float]
    every_ns: int

    @property
    def lowest(self) -> float:
        return min(self.values)

    @property
    def highest(self) -> float:
        return max(self.values)

    def at(self, moment_ns: int) -> float:
        return self.values[moment_ns // self.every_ns % len(self.values)]


@dataclass(slots=True)
class Walk:
    """A random walk between two values."""

    lowest: float
    highest: float
    step: float
    """Standard deviation of one step, in the unit of the value."""
    every_ns: int
    seed: str
    _random: Random = field(init=False, repr=False)
    _value: float = field(init=False, repr=False)
    _number: int = field(init=False, default=0, repr=False)
    """The number of the step that `_value` belongs to: the moment of the last call of `at`, divided
    by `every_ns`. Steps that were left out because of MAX_STEPS count."""

    def __post_init__(self) -> None:
        self._random = Random(self.seed)
        self._value = (self.lowest + self.highest) / 2

    def at(self, moment_ns: int) -> float:
        number = moment_ns // self.every_ns
        for _ in range(min(number - self._number, MAX_STEPS)):
            self._value = self._turned_back(self._value + self._random.gauss(0, self.step))
        self._number = max(number, self._number)
        return self._value

    def _turned_back(self, value: float) -> float:
        """Return the value, brought back into the range of the walk if it is outside.

        It lies as far inside the limit that it has crossed as it was outside.
        """
        width = self.highest - self.lowest
        if not width:
            return self.lowest
        distance = (value - self.lowest) % (2 * width)
        return min(
            max(self.lowest + min(distance, 2 * width - distance), self.lowest), self.highest
        )
