"""Line settings and error messages for all classes that open serial ports."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import serial
from serial.tools import list_ports

from mbtool.core import LinkError, SerialFormat
from mbtool.core.local_ports import PortTrouble

if TYPE_CHECKING:
    from mbtool.ports.line_errors import ErrorCounts

IDLE_S = 0.05
"""The longest time that a read of a listening port waits for bytes, in seconds."""

_PTY_FOLDERS = ("/dev/pts/", "/dev/ttys")
"""The beginnings of the paths of pseudo-terminals on Linux and macOS."""


class ListeningPort(Protocol):
    """A serial port that can only be read."""

    damaged: Sequence[int]
    """Indexes of the bytes with a wrong parity or stop bit, in the result of the last read."""

    def read(self, wait_s: float) -> bytes:
        """Return the bytes that have arrived; if there are none, wait until some arrive.

        Returns no bytes if none arrive in `wait_s` seconds (on Windows: in IDLE_S, unless `wait_s`
        is 0). Raises LinkError when the port is gone.
        """
        ...

    def counts(self) -> ErrorCounts | None:
        """Return the driver's error counters; None if the driver has none."""
        ...

    def tune(self, format_: SerialFormat) -> None:
        """Change the line settings, and discard bytes that have arrived and were not yet read.

        Raises LinkError if the driver does not support the settings, or the port is gone.
        """
        ...

    def close(self) -> None: ...


def settings_for(port: str, format_: SerialFormat) -> dict[str, Any]:
    """Return the line settings as arguments of serial.Serial.

    For a pseudo-terminal they are always 8N1, whatever `format_` says. A pseudo-terminal has no
    parity: Linux clears PARENB, and some C libraries then report EINVAL.
    """
    is_pty = os.path.realpath(port).startswith(_PTY_FOLDERS)
    return {
        "baudrate": format_.baud,
        "bytesize": 8 if is_pty else format_.data_bits,
        "parity": "N" if is_pty else format_.parity,
        "stopbits": 1 if is_pty else format_.stop_bits,
    }


def lost(port: str) -> LinkError:
    """Return the error to raise when an open port is gone, as when its adapter is unplugged."""
    return LinkError(f"serial port {port}: lost; is it still plugged in?")


@contextmanager
def explained(port: str, format_: SerialFormat) -> Iterator[None]:
    """Turn errors of opening or setting up a port, inside the `with` block, into LinkError."""
    try:
        yield
    except Exception as error:
        if not isinstance(error, ValueError | OverflowError) and not is_port_error(error):
            raise
        raise explain(port, format_, error) from error


def is_port_error(error: Exception) -> bool:
    """True if an error is an OSError or a termios.error, which is not derived from OSError."""
    return isinstance(error, OSError) or type(error).__module__ == "termios"


def explain(port: str, format_: SerialFormat, error: Exception) -> LinkError:
    """Return an error that says in one line why a port could not be opened, and what to do."""
    number = _error_number(error)
    # On Windows pyserial keeps the system's error only as text.
    text = str(error)
    if isinstance(error, ValueError | OverflowError) or number == errno.EINVAL:
        problem = f"its driver does not do {format_}; are baud rate and character format right?"
    elif number in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or "FileNotFoundError" in text:
        problem = f"is not there; {_line_hint(port)}{_ports_here()}"
    elif number in (errno.ENOTTY, errno.EISDIR):
        problem = f"is not a serial port; {_ports_here()}"
    elif number == errno.EIO:
        problem = f"has no hardware behind it; {_ports_here()}"
    elif number in (errno.EACCES, errno.EPERM):
        problem = f"permission denied; {who_may(port)}"
    elif number in (errno.EBUSY, errno.EWOULDBLOCK) or "PermissionError" in text:
        problem = "is in use by another program; end that one first"
    else:
        problem = f"cannot be opened: {text}"
    return LinkError(f"serial port {port}: {problem}")


def _error_number(error: Exception) -> int | None:
    """Return the errno of the system's error; None if it is unknown.

    If pyserial raised an error of its own, only that error's `__context__` may have the errno.
    """
    for one in (error, error.__context__ if isinstance(error, serial.SerialException) else None):
        if one is not None and one.args and isinstance(one.args[0], int):
            return one.args[0]
    return None


def _line_hint(port: str) -> str:
    """Return a hint for the user that `port` may be an end of a virtual line of `mbtool line`.

    Returns "" for a path inside /dev, where no virtual line has its ends, and on Windows.
    """
    if sys.platform == "win32" or port.startswith("/dev/"):
        return ""
    return f"an end of a virtual line is there while mbtool line {port} runs; "


def _ports_here() -> str:
    ports = sorted(info.device for info in list_ports.comports())
    return f"here are: {', '.join(ports)}" if ports else "there are no serial ports here"


def who_may(port: str) -> PortTrouble:
    """Return the obstacle for a user who may not open a port: who may open it, and, if known, the
    command that gives the user this permission.
    """
    if sys.platform == "win32":
        return PortTrouble("another program may hold it")
    import grp

    try:
        group_id = os.stat(port).st_gid
    except OSError:
        return PortTrouble("a folder on the way to it may not be entered", f"namei -l {port}")
    try:
        group = grp.getgrgid(group_id).gr_name
    except KeyError:
        group = str(group_id)
    if group == "root":
        return PortTrouble("only root may open it; give it to a group of yours with a udev rule")
    return PortTrouble(
        f"its group is {group}", f"sudo usermod -aG {group} $USER, then log in again"
    )
