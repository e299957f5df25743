"""Defines the part of a recording that is played."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A part of a recording: its beginning and end, in ns from the first request, or from the first
    byte of a recording played on a serial line. By default the whole recording.

    The end is not included, so that a request at the border of two ranges is only in the second.
    """

    start_ns: int = 0
    end_ns: int | None = None

    def __contains__(self, position_ns: int) -> bool:
        return self.start_ns <= position_ns and (self.end_ns is None or position_ns < self.end_ns)

    def __str__(self) -> str:
        start = f"from {self.start_ns / 1e9:g} s"
        return f"{start} on" if self.end_ns is None else f"{start} to {self.end_ns / 1e9:g} s"
