"""How long an answer takes that a recording gives."""

# A latency is in recorded time, which the rate of the clock divides, or as it is. An answer that
# was made up, from the register image or by a device, has none of its own: it gets what its unit
# and function usually took.

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.replay.recording import Recording


class LatencyModel(Protocol):
    """Says how long the answer to a request takes."""

    @property
    def is_recorded_time(self) -> bool:
        """Whether the clock's rate divides it."""
        ...

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        """The latency of an answer; `own_ns` is the recorded one's own, where there is one."""
        ...


class RecordedLatency:
    """Each answer takes as long as it took, or the median of its unit and function."""

    is_recorded_time = True

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        return self._recording.latency_ns(unit, function) if own_ns is None else own_ns


class FixedLatency:
    """Each answer takes equally long."""

    is_recorded_time = False

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        return self._latency_ns


class SampledLatency:
    """Each answer takes as long as some recorded one of its unit and function, drawn by chance."""

    is_recorded_time = True

    def __init__(self, recording: Recording, chance: Callable[[], float]) -> None:
        """`chance` gives numbers from 0 to less than 1."""
        self._recording = recording
        self._chance = chance

    def ns(self, unit: int, function: int, own_ns: int | None) -> int:
        seen = self._recording.latencies(unit, function)
        return seen[int(self._chance() * len(seen))] if seen else 0
