"""What tests of live sources share: waiting with a bound, and a program that opens a source."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from mbtool.core import Chunk

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.sources.inbox import Inbox, Item

PATIENCE_S = 120.0
MASTER_TIMEOUT_NS = 2_000_000_000
"""The longest time in ns that a test's master waits for a response of a slave on this machine."""


def take_until(inbox: Inbox, is_last: Callable[[Item], bool]) -> list[Item]:
    """Items up to and with the first that satisfies; fails when it does not come."""
    items: list[Item] = []
    deadline = time.monotonic() + PATIENCE_S
    while not items or not is_last(items[-1]):
        item = inbox.get(deadline - time.monotonic())
        assert item is not None, f"nothing more after {items[-5:]}"
        items.append(item)
    return items


def take_bytes(inbox: Inbox, count: int) -> list[Chunk]:
    """Chunks until they hold so many bytes."""
    chunks: list[Chunk] = []
    while sum(len(chunk.data) for chunk in chunks) < count:
        last = take_until(inbox, lambda item: isinstance(item, Chunk))[-1]
        assert isinstance(last, Chunk)
        chunks.append(last)
    return chunks


def drain(inbox: Inbox) -> list[Item]:
    """All that is in the inbox."""
    items = []
    while (item := inbox.get(0)) is not None:
        items.append(item)
    return items


def read_exactly(fd: int, count: int) -> bytes:
    """So many bytes of a descriptor; fails when they do not come."""
    data = b""
    while len(data) < count:
        ready, _, _ = select.select([fd], [], [], PATIENCE_S)
        assert ready, f"only {len(data)} of {count} bytes have come"
        data += os.read(fd, count - len(data))
    return data


def stop_marking(port: str) -> None:
    """Have a terminal mark nothing any more, so that what is written can be a driver's marks."""
    import termios

    descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY)
    attributes = termios.tcgetattr(descriptor)
    attributes[0] &= ~termios.PARMRK
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    os.close(descriptor)


def start_program(text: str, *arguments: str) -> subprocess.Popen[str]:
    """Run a Python program whose standard input and output are pipes."""
    return subprocess.Popen(
        [sys.executable, "-c", text, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def wait_for_end(pid_descriptor: int) -> None:
    """Wait until the process of os.pidfd_open() has ended; fails when it does not."""
    try:
        ready, _, _ = select.select([pid_descriptor], [], [], PATIENCE_S)
        assert ready, "the process goes on"
    finally:
        os.close(pid_descriptor)
