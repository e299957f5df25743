"""Reads back which baud rate a driver has set, as a driver may set another one without an error."""

# The kernel may set a rate that the port supports in place of the wanted one, and stores it in the
# port's settings: an 8250 whose highest rate is 115200 runs at 9600 if 230400 is wanted. Linux
# reports any rate as a number by the ioctl TCGETS2, whose number is the same on x86, ARM and
# RISC-V. On other systems the rate is not known, and no port is refused.

from __future__ import annotations

import fcntl
import struct
import sys

from mbtool.core import LinkError

TOLERANCE = 0.03
"""The largest accepted difference between the real and the wanted baud rate, relative to the wanted
one. Receivers tolerate about 4 %; dividing a UART's clock causes differences of 1 or 2 %."""

_TCGETS2 = 0x802C542A
_TERMIOS2 = struct.Struct("4I20B2I")
"""struct termios2: four sets of flags, line discipline and 19 control characters, two rates in
baud."""


def demand_rate(fd: int, port: str, baud: int) -> None:
    """Raise LinkError if the port's real rate differs from `baud` by more than TOLERANCE.

    `fd` is the descriptor of the open port, `port` its path. Nothing is raised if the system does
    not tell the real rate.
    """
    real = real_rate(fd)
    if real is not None and abs(real - baud) > TOLERANCE * baud:
        raise LinkError(
            f"serial port {port}: its driver does not do {baud} baud, and has set {real}; "
            "is the baud rate right?"
        )


def real_rate(fd: int) -> int | None:
    """The rate in baud that a port has been set to; None if the system does not tell."""
    if sys.platform != "linux":
        return None
    try:
        answer = fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        return None
    rate: int = _TERMIOS2.unpack(answer)[-1]
    return rate or None
