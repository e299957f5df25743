"""Decides after what time a slave that plays a recording sends each response."""

# A recorded latency is divided by the rate of playing (recorded time divided by real time); a fixed
# latency is in real time.
#
# Some responses are not recorded, but made from the register image or by a simulated device. Unless
# the latency is fixed, they get the median of the latencies that the recording has for the unit and
# function, or one drawn from these.

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from mbtool.replay.recording import Recording


class LatencyModel(Protocol):
    """Decides how long the player waits before it sends a response."""

    @property
    def is_recorded_time(self) -> bool:
        """True if the latency is in recorded time, so that the player must divide it by the rate of
        playing.
        """
        ...

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        """Return the latency (ns) of a response of this unit to this function code.

        `own_ns` is the latency of that response in the recording; None if the response is not
        recorded.
        """
        ...


class RecordedLatency:
    """Gives each recorded response its own latency; any other gets the median recorded for its unit
    and function.
    """

    is_recorded_time = True

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        return self._recording.latency_ns(unit, function) if own_ns is None else own_ns


class FixedLatency:
    """Gives all responses the same latency, in real time."""

    is_recorded_time = False

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        return self._latency_ns


class SampledLatency:
    """Gives each response, recorded or not, a latency drawn at random from those recorded for its
    unit and function.
    """

    is_recorded_time = True

    def __init__(self, recording: Recording, chance: Callable[[], float]) -> None:
        """`chance` returns a random number from 0 up to, but not including, 1 at each call."""
        self._recording = recording
        self._chance = chance

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        seen = self._recording.latencies(unit, function)
        return seen[int(self._chance() * len(seen))] if seen else 0
