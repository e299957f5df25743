"""Opens a serial port to read and write: what a slave and a master speak on."""

# Linux: a pseudo-terminal has neither parity nor 7 bits, and may refuse them; then, and only on
# one, it is opened with 8N1, which makes no difference to what travels.

from __future__ import annotations

import errno
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import serial

from mbtool.core import LinkError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import SerialLink

WRITE_TIMEOUT_S = 1.0

WriteTimeout = serial.SerialTimeoutException
"""Raised where the other end has taken nothing for WRITE_TIMEOUT_S."""


def open_port(link: SerialLink, timeout_s: float) -> serial.Serial:
    """Open a port to read and write; a read waits for so long. Raises LinkError."""
    try:
        return _open_with(link, timeout_s, link.format.data_bits, link.format.parity)
    except serial.SerialException as error:
        if not _is_pseudo_terminal(link.port) or _error_number(error) != errno.EINVAL:
            raise LinkError(f"serial port {link.port}: {_why_not_open(link, error)}") from error
    try:
        return _open_with(link, timeout_s, serial.EIGHTBITS, serial.PARITY_NONE)
    except serial.SerialException as error:
        raise LinkError(f"serial port {link.port}: {_why_not_open(link, error)}") from error


@contextmanager
def port_in_use(link: SerialLink) -> Iterator[None]:
    """Tell what an open port raises as a LinkError."""
    try:
        yield
    except serial.SerialTimeoutException as error:
        raise LinkError(
            f"serial port {link.port}: takes no bytes; is anything at its other end?"
        ) from error
    except Exception as error:
        if not isinstance(error, OSError) and not _is_of_termios(error):
            raise
        raise LinkError(f"serial port {link.port}: lost; is it still plugged in?") from error


def _is_of_termios(error: Exception) -> bool:
    """Whether pyserial let an error of termios pass, which is no OSError, and not on Windows."""
    return type(error).__module__ == "termios"


def _open_with(link: SerialLink, timeout_s: float, data_bits: int, parity: str) -> serial.Serial:
    try:
        return serial.Serial(
            link.port,
            baudrate=link.format.baud,
            bytesize=data_bits,
            parity=parity,
            stopbits=link.format.stop_bits,
            timeout=timeout_s,
            write_timeout=WRITE_TIMEOUT_S,
            exclusive=True,
        )
    except ValueError as error:  # A baud rate that the driver does not know.
        raise serial.SerialException(str(error)) from error
    except Exception as error:
        if not _is_of_termios(error):
            raise
        raise serial.SerialException(*error.args) from error


def _is_pseudo_terminal(port: str) -> bool:
    return Path(port).resolve().parent == Path("/dev/pts")


def _error_number(error: serial.SerialException) -> int | None:
    """What the system said; pyserial keeps it in the error, or in the one that it handles."""
    for one in (error, error.__context__):
        if one is not None and one.args and isinstance(one.args[0], int):
            return one.args[0]
    return None


def _why_not_open(link: SerialLink, error: serial.SerialException) -> str:
    match _error_number(error):
        case errno.ENOENT | errno.ENXIO | errno.ENODEV:
            return "is not there; is it plugged in, and is this its name?"
        case errno.ENOTTY | errno.EISDIR:
            return "is not a serial port"
        case errno.EACCES | errno.EPERM:
            return "permission denied; join the port's group, usually dialout, and log in again"
        case errno.EAGAIN | errno.EBUSY:
            return "is in use by another program; end that one first"
        case errno.EINVAL:
            return f"its driver does not do {link.format}; are baud rate and format right?"
        case _:
            return f"cannot be opened: {error}"
