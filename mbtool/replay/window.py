"""Which part of a recording is played."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A part of a recording, counted from its first request or byte; all of it by default.

    What begins at its end is the next part's, so parts one behind the other have each request once.
    """

    start_ns: int = 0
    end_ns: int | None = None

    def __contains__(self, place_ns: int) -> bool:
        return self.start_ns <= place_ns and (self.end_ns is None or place_ns < self.end_ns)

    def __str__(self) -> str:
        start = f"from {self.start_ns / 1e9:g} s"
        return f"{start} on" if self.end_ns is None else f"{start} to {self.end_ns / 1e9:g} s"
