"""Asks the system to run this process before others, if the user may do so."""

# This is for processes that sleep until a byte arrives, note the time, and sleep again: they need
# little processor time, but need it at once. On Linux, if permitted (root, CAP_SYS_NICE or
# RLIMIT_RTPRIO), they get the real-time class SCHED_RR at its lowest priority: they run before
# every ordinary process and after every other real-time process. Elsewhere nothing changes. A nice
# value of -5 and a shorter time slice made no measurable difference
# (tests/benchmarks/serial_times.py).
#
# Such a process sleeps in select between bytes, so even on a machine with one core it takes little
# time from others. In any case the kernel keeps 5 % of the time for ordinary processes (sched(7)).

from __future__ import annotations

import os
import sys
from contextlib import suppress


def run_promptly() -> None:
    """Ask the system to run this thread before ordinary processes from now on.

    If this is not permitted, nothing changes. Threads and processes that this thread starts later
    have the ordinary priority.
    """
    if sys.platform == "linux":
        policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
        with suppress(OSError):
            lowest = os.sched_get_priority_min(os.SCHED_RR)
            os.sched_setscheduler(0, policy, os.sched_param(lowest))
