"""Limits that several rooms keep to, and the pace of a link."""

from __future__ import annotations

from dataclasses import dataclass

MAX_OPEN_REQUESTS = 256
"""Requests of one link that wait for an answer at once; the oldest is given up beyond that."""

MAX_CLOCK_STEP_NS = 1_000_000_000
"""A time further back than this means that the clock was set back."""

RESPONSE_TIMEOUT_NS = 1_000_000_000
TURNAROUND_NS = 100_000_000
"""Pause after a broadcast (Serial Line V1.02, 2.4.1: typically 100 to 200 ms)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkLimits:
    """The pace that a master keeps on a link. Times in ns."""

    timeout_ns: int = RESPONSE_TIMEOUT_NS
    """The longest wait for a response."""
    one_at_a_time: bool = False
    """True on a serial line and on RTU over TCP: no request while another one waits."""
    pause_ns: int = 0
    """The shortest pause between the last byte heard and the next request."""
    turnaround_ns: int = TURNAROUND_NS
    """The pause after a broadcast, which nobody answers."""
