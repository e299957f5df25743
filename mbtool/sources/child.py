"""Starts and ends the child processes that read ports and note the time of each byte.

In the main process the decoder is busy, so that reads, and the times noted after them, would be
late.
"""

# A child runs a module of this package and writes to its standard output. Nothing is written to its
# standard input; the parent keeps it open as long as the child must run. When the parent closes it,
# or exits for any reason, the child reads the end of file and exits.
#
# A child has a process group of its own, so that Ctrl-C in the terminal reaches only the parent,
# which then ends its children. The option -P keeps the current folder out of the child's search
# path for modules: a user may have a file serial.py there, which would be imported in place of
# pyserial.
#
# subprocess is used, not multiprocessing: multiprocessing would import the parent's main module
# again, with the whole command line, and start a resource tracker as a second process.

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

from mbtool.core import LinkError
from mbtool.ports.clock import share_clock

# The code below asks the system to run this process before others, if the user may do so.
#
# This is for processes that sleep until a byte arrives, note the time, and sleep again: they need
# little processor time, but need it at once. On Linux, if permitted (root, CAP_SYS_NICE or
# RLIMIT_RTPRIO), they get the real-time class SCHED_RR at its lowest priority: they run before
# every ordinary process and after every other real-time process. Elsewhere nothing changes. A nice
# value of -5 and a shorter time slice made no measurable difference
# (tests/benchmarks/serial_times.py).
#
# Such a process sleeps in select between bytes, so even on a machine with one core it takes little
# time from others. In any case the kernel keeps 5 % of the time for ordinary processes (sched(7)).


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


GRACE_S = 5.0
"""A child that does not end within this time, in seconds, is killed."""


def start_child(module: str, *arguments: str, files: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Run a module of this package as a child, with pipes for its standard input and output.

    The child inherits the file descriptors `files` (not on Windows). Its clock tells the same time
    as the parent's. Raises LinkError if the system starts no more processes.
    """
    try:
        return _start_process(module, *arguments, files=files)
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.ENOMEM):
            raise
        raise LinkError(
            f"a process that this needs cannot be started: {error.strerror}; "
            "`ulimit -u` shows how many processes this user may have"
        ) from error


def _start_process(module: str, *arguments: str, files: Sequence[int]) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-P", "-m", module, *arguments]
    environment = share_clock(dict(os.environ))
    if sys.platform == "win32":
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            env=environment,
            creationflags=subprocess.CREATE_NEW_PROCESS_GROUP,
        )
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
        env=environment,
        process_group=0,
        pass_fds=files,
    )


def tell_to_end(child: subprocess.Popen[bytes]) -> None:
    """Tell a child to end, by closing its standard input. Its output can still be read."""
    if child.stdin is not None:
        child.stdin.close()


def end_child(child: subprocess.Popen[bytes]) -> int:
    """Tell a child to end, kill it if it still runs after GRACE_S, and return its exit status."""
    tell_to_end(child)
    try:
        return child.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        child.kill()
        return child.wait()
    finally:
        if child.stdout is not None:
            child.stdout.close()
