"""Finds out which baud rate a driver really set; it may set another one without an error."""

# The kernel rounds to a rate that the port has, and stores that in the port's settings: an 8250
# that ends at 115200 makes 9600 of 230400. Linux tells any rate as a number by TCGETS2; the number
# of that call is the same on x86, ARM and RISC-V. Elsewhere nothing is known, and nothing refused.

from __future__ import annotations

import fcntl
import struct
import sys

from mbtool.core import LinkError

TOLERANCE = 0.03
"""Receivers bear a rate that is wrong by some 4 %; dividers of clocks are off by 1 or 2 %."""

_TCGETS2 = 0x802C542A
_TERMIOS2 = struct.Struct("4I20B2I")
"""struct termios2: four sets of flags, line discipline and 19 characters, two rates."""


def demand_rate(fd: int, port: str, baud: int) -> None:
    """Raise LinkError if the port runs at another rate than `baud`."""
    real = real_rate(fd)
    if real is not None and abs(real - baud) > TOLERANCE * baud:
        raise LinkError(
            f"serial port {port}: its driver does not do {baud} baud, and has set {real}; "
            "is the baud rate right?"
        )


def real_rate(fd: int) -> int | None:
    """The rate of a port in baud; None if the system does not tell."""
    if sys.platform != "linux":
        return None
    try:
        answer = fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        return None
    rate: int = _TERMIOS2.unpack(answer)[-1]
    return rate or None
