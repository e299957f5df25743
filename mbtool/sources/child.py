"""Starts and ends the processes that keep time by themselves."""

# A child runs a module of this package and speaks through its standard input and output. Its input
# carries nothing: it is open for as long as the child shall run. When the parent closes it, or dies
# in whatever way, the child reads the end of file and ends.
#
# A child has a process group of its own, so that Ctrl-C in the terminal reaches the parent alone,
# which ends its children in order. It looks for modules where the installation has them; with
# -P not in the current folder, where a user may well keep a serial.py.
#
# subprocess instead of multiprocessing: spawning imports the parent's main module again, the whole
# command line with it, and a resource tracker comes along as a second process.

from __future__ import annotations

import subprocess
import sys

GRACE_S = 5.0
"""How long a child may take to end before it is killed."""


def start_child(module: str, *arguments: str) -> subprocess.Popen[bytes]:
    """Run a module of this package; its standard input and output are pipes, unbuffered."""
    command = [sys.executable, "-P", "-m", module, *arguments]
    if sys.platform == "win32":
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            creationflags=subprocess.CREATE_NEW_PROCESS_GROUP,
        )
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, process_group=0
    )


def tell_to_end(child: subprocess.Popen[bytes]) -> None:
    """Close the child's input. Its output may still hold what it has to say."""
    if child.stdin is not None:
        child.stdin.close()


def see_off(child: subprocess.Popen[bytes]) -> int:
    """Wait until the child has ended, or kill it after a grace; its exit status."""
    tell_to_end(child)
    try:
        return child.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        child.kill()
        return child.wait()
    finally:
        if child.stdout is not None:
            child.stdout.close()
