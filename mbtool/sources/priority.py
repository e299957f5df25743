"""Asks the system to let this process run before others, as far as it is allowed to."""

# For processes that sleep until a byte arrives, take the time, and sleep again: they need little,
# but at once. Linux, where it is permitted (root, CAP_SYS_NICE, RLIMIT_RTPRIO): the real-time class
# SCHED_RR at its lowest priority, which goes before every ordinary process and behind every other
# real-time one. Elsewhere nothing changes. A nice value of -5 and a shorter time slice were tried
# too (tests/benchmarks/serial_times.py) and made no difference that could be told from chance.
#
# On a machine with one core such a process takes no more than its work needs, as it sleeps in
# select. If it did not, the kernel would still leave ordinary processes 5 % of the time (sched(7)).

from __future__ import annotations

import os
import sys
from contextlib import suppress


def run_promptly() -> None:
    """Go before ordinary processes, or stay as it is where that is not permitted.

    What this process starts later, threads too, is ordinary again.
    """
    if sys.platform == "linux":
        policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
        with suppress(OSError):
            lowest = os.sched_get_priority_min(os.SCHED_RR)
            os.sched_setscheduler(0, policy, os.sched_param(lowest))
