"""Opens a serial port to listen only, and says in one line why it cannot."""

# Nothing is ever written to the port. On POSIX the descriptor itself cannot (posix_serial.py);
# elsewhere pyserial opens the port and this module has no way to write.

from __future__ import annotations

import errno
import os
import sys
from typing import TYPE_CHECKING, Protocol

import serial
from serial.tools import list_ports

from mbtool.core import LinkError, SerialFormat
from mbtool.core.local_ports import Trouble

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.ports.line_errors import ErrorCounts

IDLE_S = 0.05
"""The longest that a read waits."""


class ListeningPort(Protocol):
    """A serial port that can only be read."""

    damaged: Sequence[int]
    """At which places of the last read's bytes the driver found parity or stop bit wrong."""

    def read(self, wait_s: float) -> bytes:
        """What has arrived, at once; after the wait without anything, no bytes.

        Raises LinkError when the port is gone.
        """
        ...

    def counts(self) -> ErrorCounts | None:
        """The driver's error counters; None where it has none."""
        ...

    def tune(self, format_: SerialFormat) -> None:
        """Go on with other line settings; what arrived before is forgotten.

        Raises LinkError.
        """
        ...

    def close(self) -> None: ...


def open_listening(port: str, format_: SerialFormat) -> ListeningPort:
    """Open a port with these line settings. Raises LinkError."""
    try:
        if sys.platform != "win32":
            from mbtool.ports.posix_serial import PosixPort

            return PosixPort(port, format_)
        else:
            return PyserialPort(port, format_)
    except (OSError, ValueError, OverflowError) as error:
        raise explain(port, format_, error) from error


class PyserialPort:
    """A port that pyserial opens and reads: what serves where there is no select for ports."""

    # A wait other than 0 lasts IDLE_S: to change pyserial's timeout sets up the port anew. Of
    # errors on the line pyserial tells nothing.

    damaged: Sequence[int] = ()

    def __init__(self, port: str, format_: SerialFormat) -> None:
        self._name = port
        self._port = serial.Serial(
            port,
            baudrate=format_.baud,
            bytesize=format_.data_bits,
            parity=format_.parity,
            stopbits=format_.stop_bits,
            timeout=IDLE_S,
        )

    def read(self, wait_s: float) -> bytes:
        try:
            if wait_s == 0 and not self._port.in_waiting:
                return b""
            data: bytes = self._port.read(1)
            if data:
                data += self._port.read(self._port.in_waiting)
        except OSError as error:
            raise lost(self._name) from error
        return data

    def counts(self) -> None:
        return None

    def tune(self, format_: SerialFormat) -> None:
        try:
            self._port.baudrate = format_.baud
            self._port.bytesize = format_.data_bits
            self._port.parity = format_.parity
            self._port.stopbits = format_.stop_bits
            self._port.reset_input_buffer()
        except (OSError, ValueError, OverflowError) as error:
            raise explain(self._name, format_, error) from error

    def close(self) -> None:
        self._port.close()


def lost(port: str) -> LinkError:
    """The error of a port that was open and is gone."""
    return LinkError(f"serial port {port}: lost while reading; is it still plugged in?")


def explain(port: str, format_: SerialFormat, error: Exception) -> LinkError:
    """Say why a port could not be opened, and what would be right."""
    # On Windows pyserial keeps the system's error only as text.
    text = str(error)
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or "FileNotFoundError" in text:
        problem = f"is not there; {_ports_here()}"
    elif number in (errno.ENOTTY, errno.EISDIR):
        problem = f"is not a serial port; {_ports_here()}"
    elif number == errno.EIO:
        problem = f"has no hardware behind it; {_ports_here()}"
    elif number in (errno.EACCES, errno.EPERM):
        problem = f"permission denied; {who_may(port)}"
    elif number in (errno.EBUSY, errno.EWOULDBLOCK) or "PermissionError" in text:
        problem = "is in use by another program; end that one first"
    elif number == errno.EINVAL or isinstance(error, ValueError | OverflowError):
        problem = f"its driver does not do {format_}; are baud rate and character format right?"
    else:
        problem = text
    return LinkError(f"serial port {port}: {problem}")


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
        return Trouble("only root may read it; give it to a group of yours with a udev rule")
    return Trouble(f"its group is {group}", f"sudo usermod -aG {group} $USER, then log in again")
