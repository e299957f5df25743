"""Tells when the bytes that a socket hands out had arrived, by the kernel's own time stamps."""

# A process that gets no processor for a while reads late. The kernel (Linux) notes when the segment
# with the last of the bytes arrived, however late they are read. Other systems and TLS do not tell:
# there, bytes count as having arrived when they are read.

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
