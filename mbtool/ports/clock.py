"""The clocks of live captures, taps and slaves: UTC in nanoseconds since 1970."""

# Somebody may set the system's clock while a recording runs: a person, NTP after a boot without
# network, a GPS receiver. Silences and latencies are differences of times, and a recording has a
# length. So `now_ns` is the system's UTC at one moment plus the time that has passed since. It
# never steps. The moment is the import of this module, or the begin of the capture (`begun_run`). A
# child process gets the moment from its parent, so that the clocks of both tell the same time.
#
# The time that has passed is measured with CLOCK_BOOTTIME where the system has it: unlike the
# monotonic clock it goes on while the machine sleeps. NTP speeds up and slows down this clock, too,
# as it does with UTC, so `now_ns` and UTC differ only by the steps of the system's clock.

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from threading import Lock
from time import monotonic_ns
from time import time_ns as system_ns  # noqa: TID251 - this is a clock

__all__ = ["ClockWatch", "begun_run", "monotonic_ns", "now_ns", "share_clock", "steady_clock"]

_AHEAD = "MBTOOL_CLOCK_AHEAD_NS"
"""The environment variable that gives a child process the clock of its parent. Its value is UTC
minus the time since the machine was started, in ns, as the parent measured it."""
_CERTAIN_NS = 50_000
"""To compare UTC with the time since the machine was started, both clocks are read one after the
other. If that took longer than this, in ns, they are read again, at most _TRIES times."""
_TRIES = 5
STEP_NS = 500_000_000
"""The smallest step of the system's clock, in ns, that is reported."""
SLEW_NS = 1_000_000
"""If the difference of the system's clock and `now_ns` changes by less than this, in ns, the change
is taken as an error of measurement, not as a step."""


passed_ns: Callable[[], int] = monotonic_ns
"""Returns the time in ns since the machine was started."""
if hasattr(time, "CLOCK_BOOTTIME"):
    passed_ns = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME)


def _measured_ahead_ns() -> int:
    """The system's UTC minus the time since the machine was started, in ns."""
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
    """The clock of this process: its offset, and the number of captures and slaves that use it."""

    lock = Lock()
    ahead_ns = int(os.environ.get(_AHEAD) or _measured_ahead_ns())
    runs = 0
    """Number of contexts of `begun_run` that are open in this process."""


def now_ns() -> int:
    """The present time in UTC ns, of a clock that does not step when the system's clock is set."""
    return passed_ns() + _RunClock.ahead_ns


@contextmanager
def begun_run() -> Iterator[None]:
    """A context for one run of a capture or slave.

    If no other such context is open, entering it aligns the clock of `now_ns` with the system's.
    """
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
    """Return a child process's environment with the variable that sets its clock as this one.

    The child's `now_ns` then returns the same times as that of this process.
    """
    return {**environment, _AHEAD: str(_RunClock.ahead_ns)}


class ClockWatch:
    """Watches for steps of the system's clock by comparing it with `now_ns`. Not thread-safe."""

    def __init__(self) -> None:
        self.ahead_ns = 0
        """The time, in ns, by which the system's clock was ahead of `now_ns` (negative: behind)
        when this time last changed by SLEW_NS or more."""
        self._before_ns = 0
        """The time, in ns, by which the system's clock was ahead of `now_ns` before its last
        step."""
        self.look()
        self._before_ns = self._told_ns = self.ahead_ns

    def look(self) -> None:
        """Compare the system's clock with `now_ns` again.

        A change below SLEW_NS is taken as an error of measurement and ignored.
        """
        ahead_ns = self._measure_ahead()
        if abs(ahead_ns - self.ahead_ns) >= SLEW_NS:
            self._before_ns, self.ahead_ns = self.ahead_ns, ahead_ns

    def take_step(self) -> int:
        """Return by how many ns the system's clock was set forward (or back: negative).

        Returns 0 if it has changed by less than STEP_NS since the step that was returned last.
        """
        self.look()
        step_ns = self.ahead_ns - self._told_ns
        if abs(step_ns) < STEP_NS:
            return 0
        self._told_ns = self.ahead_ns
        return step_ns

    def from_system(self, system_ns: int, near_ns: int) -> int:
        """Convert `system_ns`, a time stamp of the system's clock, to a time of `now_ns`, in ns.

        `near_ns` is about the time that `now_ns` returned at the same moment. If the system's clock
        was set recently, the time stamp may be from before or after the step. The method computes
        both results and returns the one nearer to `near_ns`.
        """
        return min(
            system_ns - self.ahead_ns,
            system_ns - self._before_ns,
            key=lambda at_ns: abs(at_ns - near_ns),
        )

    def _measure_ahead(self) -> int:
        return _measured_ahead_ns() - _RunClock.ahead_ns


def steady_clock() -> Callable[[], int]:
    """Return a clock that starts at the present UTC and then follows the monotonic clock, in ns.

    The clock never steps back. A slave measures silences and delays with it, which must not change
    when somebody sets the system's clock.
    """
    anchor_ns = time.time_ns() - time.monotonic_ns()  # noqa: TID251 - this is a clock
    return lambda: anchor_ns + time.monotonic_ns()
