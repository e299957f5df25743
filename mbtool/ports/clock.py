"""The clocks of live captures, taps and slaves: UTC in nanoseconds since 1970."""

# Somebody may set the system's clock while a recording runs: a person, NTP after a boot without
# network, a GPS receiver. Silences and latencies are differences of times, and a recording has a
# length. So `now_ns` is the system's UTC at one moment plus the time that has passed since. It
# never steps. The moment is the import of this module, or the begin of the run (`begun_run`). A
# child process gets it from its parent, so that both tell the same time.
#
# The time that has passed is that of CLOCK_BOOTTIME where the system has it: unlike the monotonic
# clock it goes on while the machine sleeps. NTP also speeds up and slows down this clock, so it
# drifts from UTC only by steps.

from __future__ import annotations

import os
import time
from contextlib import contextmanager
from threading import Lock
from time import monotonic_ns
from time import time_ns as system_ns  # noqa: TID251 - this is a clock
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["ClockWatch", "begun_run", "monotonic_ns", "now_ns", "share_clock", "steady_clock"]

_AHEAD = "MBTOOL_CLOCK_AHEAD_NS"
"""The environment variable from which a child process takes the clock of its parent."""
_CERTAIN_NS = 50_000
"""Two clocks are compared again if reading both took longer than so many ns."""
_TRIES = 5
STEP_NS = 500_000_000
"""The smallest step of the system's clock, in ns, that is told."""
SLEW_NS = 1_000_000
"""A difference smaller than this, in ns, is no step, but an error of the comparison."""


if hasattr(time, "CLOCK_BOOTTIME"):

    def passed_ns() -> int:
        """The time in ns since the machine was started."""
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

else:
    passed_ns = monotonic_ns


def _measured_ahead_ns() -> int:
    """The system's UTC minus the time that has passed since the machine was started, in ns."""
    tried = []
    for _ in range(_TRIES):
        before_ns = passed_ns()
        utc_ns = system_ns()
        took_ns = passed_ns() - before_ns
        tried.append((took_ns, utc_ns - before_ns - took_ns // 2))
        if took_ns < _CERTAIN_NS:
            break
    return min(tried)[1]


class _RunClock:
    """The clock of this process."""

    lock = Lock()
    ahead_ns = int(os.environ.get(_AHEAD) or _measured_ahead_ns())
    runs = 0
    """Number of runs that are under way in this process."""


def now_ns() -> int:
    """The present time in UTC ns; the top of this file says which."""
    return passed_ns() + _RunClock.ahead_ns


@contextmanager
def begun_run() -> Iterator[None]:
    """While a context is open, `now_ns` counts from the system's clock at the first entry."""
    with _RunClock.lock:
        if not _RunClock.runs:
            _RunClock.ahead_ns = _measured_ahead_ns()
        _RunClock.runs += 1
    try:
        yield
    finally:
        with _RunClock.lock:
            _RunClock.runs -= 1


def share_clock(environment: dict[str, str]) -> dict[str, str]:
    """Add to the environment of a child process what makes its clock tell the same time."""
    return {**environment, _AHEAD: str(_RunClock.ahead_ns)}


class ClockWatch:
    """Compares the system's clock with `now_ns`. Not for several threads."""

    def __init__(self) -> None:
        self.ahead_ns = 0
        """How far the system's clock is ahead of `now_ns`, in ns; 0 for less than SLEW_NS."""
        self._before_ns = 0
        """The same before the last step."""
        self.look()
        self._before_ns = self._told_ns = self.ahead_ns

    def look(self) -> None:
        """Compare the clocks again."""
        ahead_ns = self._measured()
        if abs(ahead_ns - self.ahead_ns) >= SLEW_NS:
            self._before_ns, self.ahead_ns = self.ahead_ns, ahead_ns

    def take_step(self) -> int:
        """Compare, and return by how many ns the clock was set forward (or back: negative).

        0 for less than STEP_NS since the step that was returned before.
        """
        self.look()
        step_ns = self.ahead_ns - self._told_ns
        if abs(step_ns) < STEP_NS:
            return 0
        self._told_ns = self.ahead_ns
        return step_ns

    def from_system(self, system_ns: int, near_ns: int) -> int:
        """The time of `now_ns` for a time of the system's clock that was about `near_ns`.

        If the clock was set since the last look, the time before and the time after may be meant:
        the one nearer to `near_ns` is right, as the times are those of the last moments.
        """
        return min(
            system_ns - self.ahead_ns,
            system_ns - self._before_ns,
            key=lambda at_ns: abs(at_ns - near_ns),
        )

    def _measured(self) -> int:
        return _measured_ahead_ns() - _RunClock.ahead_ns


def steady_clock() -> Callable[[], int]:
    """Return a clock that starts at the present UTC and then follows the monotonic clock.

    It never steps back. A slave uses it to measure silences and delays, which must not change when
    somebody sets the system's clock.
    """
    anchor_ns = time.time_ns() - time.monotonic_ns()  # noqa: TID251 - this is a clock
    return lambda: anchor_ns + time.monotonic_ns()
