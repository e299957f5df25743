"""What all ways to open a serial port share: the line settings, and one set of errors."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import serial
from serial.tools import list_ports

from mbtool.core import LinkError, SerialFormat
from mbtool.core.local_ports import Trouble

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.ports.line_errors import ErrorCounts

IDLE_S = 0.05
"""The longest that a read of a listening port waits."""

_PTY_FOLDERS = ("/dev/pts/", "/dev/ttys")
"""Where Linux and macOS have pseudo-terminals."""


class ListeningPort(Protocol):
    """A serial port that can only be read."""

    damaged: Sequence[int]
    """The positions, in the last read's bytes, of those with a wrong parity or stop bit."""

    def read(self, wait_s: float) -> bytes:
        """Give what has arrived, at once; if nothing comes within the wait, no bytes.

        Raises LinkError when the port is gone.
        """
        ...

    def counts(self) -> ErrorCounts | None:
        """The driver's error counters; None if it has none."""
        ...

    def tune(self, format_: SerialFormat) -> None:
        """Change the line settings, and forget what arrived before. Raises LinkError."""
        ...

    def close(self) -> None: ...


def settings_for(port: str, format_: SerialFormat) -> dict[str, Any]:
    """The line settings as pyserial's arguments.

    A pseudo-terminal has no parity and always 8 bits: Linux clears PARENB, and some C libraries
    then report EINVAL. So no others are asked of it.
    """
    is_pty = os.path.realpath(port).startswith(_PTY_FOLDERS)
    return {
        "baudrate": format_.baud,
        "bytesize": 8 if is_pty else format_.data_bits,
        "parity": "N" if is_pty else format_.parity,
        "stopbits": 1 if is_pty else format_.stop_bits,
    }


def lost(port: str) -> LinkError:
    """The error of a port that was open and is gone."""
    return LinkError(f"serial port {port}: lost; is it still plugged in?")


@contextmanager
def explained(port: str, format_: SerialFormat) -> Iterator[None]:
    """Turn what opening or setting up a port raises into a LinkError."""
    try:
        yield
    except Exception as error:
        if not isinstance(error, ValueError | OverflowError) and not is_port_error(error):
            raise
        raise explain(port, format_, error) from error


def is_port_error(error: Exception) -> bool:
    """True for what the system says of a port: termios.error is no OSError."""
    return isinstance(error, OSError) or type(error).__module__ == "termios"


def explain(port: str, format_: SerialFormat, error: Exception) -> LinkError:
    """Say in one line why a port could not be opened, and what would be right."""
    number = _error_number(error)
    # On Windows pyserial keeps the system's error only as text.
    text = str(error)
    if isinstance(error, ValueError | OverflowError) or number == errno.EINVAL:
        problem = f"its driver does not do {format_}; are baud rate and character format right?"
    elif number in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or "FileNotFoundError" in text:
        problem = f"is not there; {_ports_here()}"
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
    """The system's error number; pyserial may keep it only in the error that it handled."""
    for one in (error, error.__context__ if isinstance(error, serial.SerialException) else None):
        if one is not None and one.args and isinstance(one.args[0], int):
            return one.args[0]
    return None


def _ports_here() -> str:
    ports = sorted(info.device for info in list_ports.comports())
    return f"here are: {', '.join(ports)}" if ports else "there are no serial ports here"


def who_may(port: str) -> Trouble:
    """Who may open a port, and how to become one of them."""
    if sys.platform == "win32":
        return Trouble("another program may hold it")
    import grp

    try:
        group_id = os.stat(port).st_gid
    except OSError:
        return Trouble("a folder on the way to it may not be entered", f"namei -l {port}")
    try:
        group = grp.getgrgid(group_id).gr_name
    except KeyError:
        group = str(group_id)
    if group == "root":
        return Trouble("only root may open it; give it to a group of yours with a udev rule")
    return Trouble(f"its group is {group}", f"sudo usermod -aG {group} $USER, then log in again")
