"""What a line and its adapter do often, learned from the frames heard."""

from __future__ import annotations

from dataclasses import dataclass
from math import log2

_PACE = 1 / 32
"""How much one frame counts: after a few dozen the line's own habit prevails."""
STEADY = 1 / 96
"""How much it counts in the end where what is as rare as one in twenty is to be known well."""
_SLOWER = 31 / 32


class LearnedCost:
    """How often something is seen at a frame, as what it costs to suppose it."""

    __slots__ = ("_bits", "_least", "_most", "_pace", "_slowest", "often")

    def __init__(self, bits: float, limits: tuple[float, float], *, slowest: float = _PACE) -> None:
        """`bits` is what it costs before anything was heard."""
        self._least, self._most = limits
        self.often: float = 2**-bits
        """At how many frames of one it is seen."""
        self._pace, self._slowest = _PACE, slowest
        self._bits: float | None = bits
        """What `bits` is; None where that has changed since somebody asked."""

    def learn(self, seen: bool) -> None:
        """Note one more frame."""
        self.often += (seen - self.often) * self._pace
        if self._pace > self._slowest:
            self._pace *= _SLOWER
        self._bits = None

    @property
    def bits(self) -> float:
        """What it costs to suppose it."""
        if self._bits is None:
            bits = -log2(self.often) if self.often else self._most
            self._bits = min(max(bits, self._least), self._most)
        return self._bits


@dataclass(frozen=True, slots=True)
class LineStatistics:
    """What a line does often at its frames."""

    skip: LearnedCost
    noise: LearnedCost
    glue: LearnedCost
    tear: LearnedCost
    flip: LearnedCost
    """Of damage, that it is one wrong bit and nothing is missing."""


class LatencyStatistics:
    """How long slaves on this line take to answer."""

    __slots__ = ("_heard", "_longest_ns")

    FIRST_NS = 200_000_000
    """Supposed to be the longest while few responses were heard: slow devices take as long."""
    LEAST_NS = 10_000_000
    """No line is supposed to be faster, since an adapter hands over what it heard in blocks."""
    FEW = 16
    WRITE_NS = 20_000_000
    """No device is late that takes as long to write, however fast it reads."""
    RETRY_NS = 60_000_000
    """No master gives up sooner."""
    TIMER_NS = 255_000_000
    """The longest latency timer of an FTDI adapter."""
    MARGIN_OCTAVES = 0.25
    """A response is late when it takes a fifth longer than the longest latency of the line."""

    def __init__(self) -> None:
        self._heard = 0
        self._longest_ns = float(self.LEAST_NS)

    def learn(self, latency_ns: int) -> None:
        """Note one more response. The longest is forgotten slowly."""
        self._heard += 1
        self._longest_ns = max(latency_ns, self._longest_ns * 0.99, self.LEAST_NS)

    def learn_warily(self, latency_ns: int) -> None:
        """The same of what may be none: one alone does no more than double the longest."""
        self.learn(min(latency_ns, 2 * int(self._longest_ns)))

    @property
    def is_known(self) -> bool:
        """Whether enough responses were heard to say."""
        return self._heard >= self.FEW

    def octaves_late(self, silence_ns: int, least_ns: int = 0) -> float:
        """How many doublings a silence is above the longest latency; below 0 for a shorter one.

        `least_ns` may be the longest at least.
        """
        longest_ns = max(self._longest_ns, least_ns)
        if self._heard < self.FEW and longest_ns < self.FIRST_NS:
            # Each response makes what was heard so far count more against what is supposed.
            longest_ns *= (self.FIRST_NS / longest_ns) ** (1 - self._heard / self.FEW)
        return log2(max(silence_ns, 1) / longest_ns)
