"""Averaging and scaling of an analog input, as arithmetic over time."""

# An input holds what it was set to until it is set again. A module converts it every
# CONVERSION_NS, and gives out, by the kind of processing:
#
#     sampling   each value as it is
#     period     the mean of one period after the other (a time, or a count of conversions)
#     moving     the mean of the last so many conversions
#
# The mean is taken over time, which is what the mean of many conversions comes to. There is no
# value before the first period, or the first window, is full. Fractions are cut off, as in the
# manual's example of scaling, where 37.5 becomes 37.
#
# A moving mean holds at most MAX_STEPS changes of the input; of more, the oldest are forgotten, and
# the value behind them is taken to have stood there before.

from __future__ import annotations

from collections import deque
from typing import Protocol

FULL_SCALE = 16000
CONVERSION_NS = 1_000_000
"""From one conversion of a channel to the next; the chapter does not state it."""
MAX_STEPS = 1024

_LOWEST, _HIGHEST = -0x8000, 0x7FFF


class Processing(Protocol):
    """What becomes of an input. Times never step back."""

    def feed(self, value: int, now_ns: int) -> None:
        """The input holds this value now; until now it held what it held before."""

    def result(self, now_ns: int) -> int | None:
        """What is given out now, or None before the first value is complete."""


class Sampling:
    """Each value as it is."""

    def __init__(self) -> None:
        self._value: int | None = None

    def feed(self, value: int, now_ns: int) -> None:
        self._value = value

    def result(self, now_ns: int) -> int | None:
        return self._value


class PeriodMean:
    """The mean of each whole period."""

    def __init__(self, period_ns: int, value: int, now_ns: int) -> None:
        self._period_ns = period_ns
        self._value = value
        self._begun_ns = self._known_ns = now_ns
        self._sum = 0
        """Value times ns from the period's beginning to what is known."""
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
    """The mean of the time just passed."""

    def __init__(self, window_ns: int, value: int, now_ns: int) -> None:
        self._window_ns = window_ns
        self._begun_ns = now_ns
        self._steps: deque[tuple[int, int]] = deque([(now_ns, value)], maxlen=MAX_STEPS)
        """Since when the input has held which value."""

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
        if until_ns > first_ns:  # Steps were forgotten.
            total += self._steps[0][1] * (until_ns - first_ns)
        return cut(total, self._window_ns)


def scaled(value: int, lower: int, upper: int) -> int:
    """A digital value on the scale from `lower`, which stands for 0, to `upper` for FULL_SCALE.

    Limits that are equal make no scale: the value stays.
    """
    if lower == upper:
        return value
    return limited(cut(lower * FULL_SCALE + value * (upper - lower), FULL_SCALE))


def cut(dividend: int, divisor: int) -> int:
    """A quotient without its fraction."""
    quotient = abs(dividend) // divisor
    return quotient if dividend >= 0 else -quotient


def limited(value: int) -> int:
    """The nearest number that a register can hold."""
    return min(max(value, _LOWEST), _HIGHEST)
