"""Starts and ends child processes, which time bytes undisturbed by the busy main process."""

# A child runs a module of this package and writes to its standard output. Nothing is written to its
# standard input. The parent keeps this open as long as the child shall run; when the parent closes
# it, or ends in any way, the child reads the end of file and ends.
#
# A child has a process group of its own, so that Ctrl-C in the terminal reaches only the parent,
# which then ends its children. -P keeps the current folder out of the child's search path for
# modules: a user may have a serial.py there.
#
# subprocess is used, not multiprocessing: that would import the parent's main module again, with
# the whole command line, and start a resource tracker as a second process.

from __future__ import annotations

import subprocess
import sys

GRACE_S = 5.0
"""How long a child may take to end before it is killed, in seconds."""


def start_child(module: str, *arguments: str) -> subprocess.Popen[bytes]:
    """Run a module of this package as a child, with pipes for its standard input and output."""
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
    """Tell a child to end, by closing its standard input. Its output can still be read."""
    if child.stdin is not None:
        child.stdin.close()


def end_child(child: subprocess.Popen[bytes]) -> int:
    """Tell a child to end, and kill it if it has not ended after GRACE_S.

    Returns its exit status.
    """
    tell_to_end(child)
    try:
        return child.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        child.kill()
        return child.wait()
    finally:
        if child.stdout is not None:
            child.stdout.close()
