"""Estimates when bytes arrived if the process, for lack of processor time, reads them late."""

# For a TCP connection, the kernel (Linux) notes when the segment with the last of the bytes
# arrived. Other systems, and connections with TLS, do not give this time: there, the time of the
# read counts.
#
# For a serial port, nothing notes the time. If a read finds bytes at once, they may have come right
# after the read before. If a read has to wait for bytes, they came before its longest wait was
# over.

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
"""A kernel's time stamp that seems older than this, in ns, is not used: somebody has probably set
the system's clock between the arrival and the read."""


class SerialArrivals:
    """Estimates when the bytes of a serial port arrived, even if the process read them late.

    Without the estimate, a delay of this process would look like a silence on the line.
    """

    def __init__(self, character_ns: int) -> None:
        self._character_ns = character_ns
        self._empty_ns: int | None = None
        """The last time in ns at which the port certainly had no unread byte; None before the first
        read."""

    def arrived_ns(self, size: int, begin_ns: int, wait_ns: int, now_ns: int) -> int:
        """Return the time at which the last of the `size` bytes arrived that one read of the port
        returned.

        For a read without bytes (`size` 0), return the time up to which the line was silent. The
        read began at `begin_ns` and ended at `now_ns`. `wait_ns` is the longest time that the read
        could wait for a byte; 0 means that it did not wait. All times are in ns.
        """
        if wait_ns or not size:
            arrived_ns = begin_ns + wait_ns
        elif self._empty_ns is None:
            arrived_ns = now_ns
        else:
            arrived_ns = self._empty_ns + size * self._character_ns
        arrived_ns = min(arrived_ns, now_ns)
        self._empty_ns = max(arrived_ns, begin_ns)
        return arrived_ns


def note_arrivals(connected: socket.socket) -> None:
    """Ask the kernel to note when the bytes of a TCP connection arrive.

    Does nothing on other systems than Linux, and for a connection with TLS.
    """
    if sys.platform == "linux" and not isinstance(connected, ssl.SSLSocket):
        connected.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def receive(connected: socket.socket, size: int) -> tuple[bytes, int]:
    """Read at most `size` bytes; return them, and the time (ns of the monotonic clock) at which
    they arrived.

    Without a kernel's time stamp (see `note_arrivals`) the second value is the time of the read.
    Raises the errors of `socket.recv`.
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
