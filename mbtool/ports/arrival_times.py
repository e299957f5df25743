"""Tells when bytes arrived that a process reads late, for lack of processor time."""

# Of a TCP connection the kernel (Linux) notes when the segment with the last of the bytes arrived.
# Other systems and TLS do not tell: there, bytes count as having arrived when they are read.
#
# Of a serial port nobody notes it. But bytes that are there at once when one looks may have come
# right after one looked before, and bytes that one waited for have come before the wait was over.

from __future__ import annotations

import socket
import ssl
import struct
import sys
import time

_SO_TIMESTAMPNS = 35
"""SO_TIMESTAMPNS of Linux, which is also the type of its control message (asm-generic/socket.h)."""
_TIMESPEC = struct.Struct("@ll")
MOST_LATE_NS = 10_000_000_000
"""A time stamp that seems older than this, in ns, is not used: the clock was probably set."""


class SerialArrivals:
    """Times of arrival of the bytes of a serial port, not later than they can be."""

    def __init__(self, character_ns: int) -> None:
        self._character_ns = character_ns
        self._looked_ns: int | None = None
        """When the last read ended; None before the first one."""

    def arrived_ns(self, size: int, begin_ns: int, wait_ns: int, now_ns: int) -> int:
        """When the last of `size` bytes arrived that a read from `begin_ns` to `now_ns` gave.

        `wait_ns` is how long the read would have waited; 0 if there were bytes at its beginning.
        """
        last_ns, self._looked_ns = self._looked_ns, now_ns
        if not size:
            return now_ns
        if wait_ns:
            return min(now_ns, begin_ns + wait_ns)
        return now_ns if last_ns is None else min(now_ns, last_ns + size * self._character_ns)


def note_arrivals(connected: socket.socket) -> None:
    """Ask the kernel for the times of arrival, where it knows them."""
    if sys.platform == "linux" and not isinstance(connected, ssl.SSLSocket):
        connected.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def receive(connected: socket.socket, size: int) -> tuple[bytes, int]:
    """Read at most `size` bytes; return them, and when they arrived by the monotonic clock, in ns.

    Raises what `recv` raises.
    """
    if sys.platform != "linux" or isinstance(connected, ssl.SSLSocket):
        return connected.recv(size), time.monotonic_ns()
    data, messages, _, _ = connected.recvmsg(size, socket.CMSG_SPACE(_TIMESPEC.size))
    now_ns = time.monotonic_ns()
    clock_ns = time.time_ns()  # noqa: TID251 - the time stamps are of this clock
    for level, kind, content in messages:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS):
            late_ns = clock_ns - _stamp_ns(content)
            return data, now_ns - (late_ns if 0 < late_ns <= MOST_LATE_NS else 0)
    return data, now_ns


def _stamp_ns(content: bytes) -> int:
    seconds, nanoseconds = _TIMESPEC.unpack(content[: _TIMESPEC.size])
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
