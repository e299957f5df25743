"""Simulates the averaging and scaling of an analog input over time (FA3 modules)."""

# A simulated input keeps its value until it is set again. A real module converts the input every
# CONVERSION_NS, and makes one of these of the converted values, as the channel's setting says:
#
#     sampling   each value as it is
#     period     the mean of each period; a period is a time or a number of conversions
#     moving     the mean of the last N conversions, N from the setting
#
# Here, a mean is computed from the input's values and how long each of them lasted; this gives the
# same result as averaging the conversions. There is no result before the first period, or the first
# N conversions, are complete. Fractions are cut off, as in the manual's example of scaling, where
# 37.5 becomes 37.
#
# Memory: a moving mean keeps the last MAX_STEPS changes of the input. If its window begins earlier
# than the oldest of them, it uses that change's value for the time before.

from __future__ import annotations

from collections import deque
from typing import Protocol

FULL_SCALE = 16000
CONVERSION_NS = 1_000_000
"""Time in ns between two conversions of a channel. Assumed: the manual does not state it."""
MAX_STEPS = 1024

_LOWEST, _HIGHEST = -0x8000, 0x7FFF


class Processing(Protocol):
    """Computes the value that masters read from the values of an input.

    No call may have an earlier time than the call before it.
    """

    def feed(self, value: int, now_ns: int) -> None:
        """Set the input to this value from `now_ns` on."""

    def result(self, now_ns: int) -> int | None:
        """Return the computed value at `now_ns`, or None before the first mean is complete."""


class Sampling:
    """Returns the input's present value, without averaging."""

    def __init__(self) -> None:
        self._value: int | None = None

    def feed(self, value: int, now_ns: int) -> None:
        self._value = value

    def result(self, now_ns: int) -> int | None:
        return self._value


class PeriodMean:
    """Averages the input over periods of equal length that follow each other without a gap.

    Its result is the mean of the last complete period.
    """

    def __init__(self, period_ns: int, value: int, now_ns: int) -> None:
        self._period_ns = period_ns
        self._value = value
        self._begun_ns = self._known_ns = now_ns
        self._sum = 0
        """The sum of value times duration in ns, from the period's begin to `_known_ns`."""
        self._mean: int | None = None

    def feed(self, value: int, now_ns: int) -> None:
        self._advance(now_ns)
        self._value = value

    def result(self, now_ns: int) -> int | None:
        self._advance(now_ns)
        return self._mean

    def _advance(self, now_ns: int) -> None:
        periods, into_ns = divmod(now_ns - self._begun_ns, self._period_ns)
        if not periods:
            self._sum += self._value * (now_ns - self._known_ns)
        else:
            rest_ns = self._begun_ns + self._period_ns - self._known_ns
            ended = self._sum + self._value * rest_ns
            self._mean = cut(ended, self._period_ns) if periods == 1 else self._value
            self._begun_ns = now_ns - into_ns
            self._sum = self._value * into_ns
        self._known_ns = now_ns


class MovingMean:
    """Averages the input over the last `window_ns` nanoseconds."""

    def __init__(self, window_ns: int, value: int, now_ns: int) -> None:
        self._window_ns = window_ns
        self._begun_ns = now_ns
        self._steps: deque[tuple[int, int]] = deque([(now_ns, value)], maxlen=MAX_STEPS)
        """The changes of the input: the time in ns, and the value from that time on."""

    def feed(self, value: int, now_ns: int) -> None:
        if value != self._steps[-1][1]:
            self._steps.append((now_ns, value))

    def result(self, now_ns: int) -> int | None:
        first_ns = now_ns - self._window_ns
        if first_ns < self._begun_ns:
            return None
        while len(self._steps) > 1 and self._steps[1][0] <= first_ns:
            self._steps.popleft()
        total, until_ns = 0, now_ns
        for since_ns, value in reversed(self._steps):
            total += value * (until_ns - max(since_ns, first_ns))
            until_ns = since_ns
        if until_ns > first_ns:  # The changes before were dropped.
            total += self._steps[0][1] * (until_ns - first_ns)
        return cut(total, self._window_ns)


def scaled(value: int, lower: int, upper: int) -> int:
    """Scale a digital value: 0 becomes `lower`, FULL_SCALE (16000) becomes `upper`.

    If `lower` and `upper` are equal, the value is returned unchanged.
    """
    if lower == upper:
        return value
    return limited(cut(lower * FULL_SCALE + value * (upper - lower), FULL_SCALE))


def cut(dividend: int, divisor: int) -> int:
    """Return `dividend` / `divisor`, rounded towards 0 (// would round down: -7 / 2 is -3 here)."""
    quotient = abs(dividend) // divisor
    return quotient if dividend >= 0 else -quotient


def limited(value: int) -> int:
    """Return the number nearest to `value` that a signed register can hold."""
    return min(max(value, _LOWEST), _HIGHEST)
