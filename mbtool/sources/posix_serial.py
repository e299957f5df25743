"""A serial port of Linux or macOS, opened read-only."""

# pyserial knows how to set up a line on every system, odd baud rates included, but opens a port for
# writing. So the descriptor is opened here, with O_RDONLY, and pyserial's setup is applied to it
# (_reconfigure_port of pyserial 3.5 needs nothing but the descriptor and the settings). What its
# open() does beyond that is left out on purpose: it sets DTR and RTS, which make some RS-485
# adapters talk.
#
# The port is locked with flock, as pyserial and most terminal programs do. The lock is advisory and
# ends with the process. It keeps out only a second reader, and two readers of one port steal each
# other's bytes. TIOCEXCL, which would keep out everyone, is not used.
#
# A pseudo-terminal has no parity and always 8 bits: Linux clears PARENB, and some C libraries then
# report EINVAL. On one, the line settings are not asked for at all, beside the baud rate.

from __future__ import annotations

import fcntl
import os
import select
import termios
from contextlib import suppress
from typing import TYPE_CHECKING

import serial

from mbtool.sources.serial_port import lost
from mbtool.sources.serial_records import MAX_DATA

if TYPE_CHECKING:
    from mbtool.core import SerialFormat

_PTY_FOLDERS = ("/dev/pts/", "/dev/ttys")
"""Linux, macOS."""


class PosixPort:
    """A port that can only be read. Opening raises OSError, ValueError, OverflowError."""

    def __init__(self, port: str, format_: SerialFormat) -> None:
        self._name = port
        self._fd = os.open(port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            _set_up(self._fd, port, format_)
        except Exception as error:
            os.close(self._fd)
            if isinstance(error, termios.error):  # Which is no OSError, but is made like one.
                raise OSError(*error.args) from error
            raise

    def read(self, wait_s: float) -> bytes:
        ready, _, _ = select.select([self._fd], [], [], wait_s)
        if not ready:
            return b""
        try:
            data = os.read(self._fd, MAX_DATA)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise lost(self._name) from error
        if not data:
            raise lost(self._name)
        return data

    def close(self) -> None:
        os.close(self._fd)


def _set_up(fd: int, port: str, format_: SerialFormat) -> None:
    termios.tcgetattr(fd)  # Tells by its errno what is no serial port; pyserial's error has none.
    fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    is_pty = os.path.realpath(port).startswith(_PTY_FOLDERS)
    settings = serial.Serial(
        baudrate=format_.baud,
        bytesize=8 if is_pty else format_.data_bits,
        parity="N" if is_pty else format_.parity,
        stopbits=1 if is_pty else format_.stop_bits,
        # With VMIN 1 a read without data says EAGAIN, and an empty one that the port is gone.
        inter_byte_timeout=0,
    )
    settings.fd = fd
    settings._reconfigure_port(force_update=True)  # type: ignore[attr-defined]
    with suppress(OSError, ValueError, NotImplementedError):
        settings.set_low_latency_mode(True)
    termios.tcflush(fd, termios.TCIFLUSH)
