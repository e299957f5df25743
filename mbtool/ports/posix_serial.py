"""A serial port of Linux or macOS, opened read-only; a tap's, which passes on, for both."""

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
# The driver is asked to mark damaged bytes (marks.py), which pyserial cannot. Where the terminal
# does not take that wish, bytes are read as they come.
#
# A pseudo-terminal has no parity and always 8 bits: Linux clears PARENB, and some C libraries then
# report EINVAL. On one, the line settings are not asked for at all, beside the baud rate.

from __future__ import annotations

import fcntl
import os
import select
import struct
import sys
import termios
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import serial

from mbtool.ports.line_errors import ErrorCounts
from mbtool.ports.marks import Unmarker
from mbtool.ports.serial_port import explain, lost
from mbtool.ports.serial_records import MAX_DATA

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.core import SerialFormat

_PTY_FOLDERS = ("/dev/pts/", "/dev/ttys")
"""Linux, macOS."""

_COUNTERS = struct.Struct("20i")
"""struct serial_icounter_struct of linux/serial.h: 11 counters and room for 9 more."""
_ERROR_COUNTERS = slice(6, 11)
"""frame, overrun, parity, brk, buf_overrun: the order of `ErrorCounts`."""


class PosixPort:
    """A port that can only be read. Opening raises OSError, ValueError, OverflowError."""

    _access = os.O_RDONLY

    def __init__(self, port: str, format_: SerialFormat) -> None:
        self._name = port
        self._fd = os.open(port, self._access | os.O_NOCTTY | os.O_NONBLOCK)
        self.damaged: Sequence[int] = ()
        try:
            with _termios_errors_as_os_errors():
                self._unmarker = _set_up(self._fd, port, format_)
        except Exception:
            os.close(self._fd)
            raise

    def read(self, wait_s: float) -> bytes:
        self.damaged = ()
        while True:
            ready, _, _ = select.select([self._fd], [], [], wait_s)
            data = self._read() if ready else b""
            if self._unmarker is None:
                return data
            if not data:
                return self._unmarker.flush()
            heard, self.damaged = self._unmarker.feed(data)
            if heard:
                return heard
            wait_s = 0  # The rest of an escape is there already, or it is none.

    def _read(self) -> bytes:
        try:
            data = os.read(self._fd, MAX_DATA)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise lost(self._name) from error
        if not data:
            raise lost(self._name)
        return data

    def counts(self) -> ErrorCounts | None:
        if sys.platform != "linux":
            return None
        try:
            answer = fcntl.ioctl(self._fd, termios.TIOCGICOUNT, bytes(_COUNTERS.size))
        except OSError:
            return None
        return ErrorCounts(*_COUNTERS.unpack(answer)[_ERROR_COUNTERS])

    def tune(self, format_: SerialFormat) -> None:
        try:
            with _termios_errors_as_os_errors():
                self._unmarker = _set_up(self._fd, self._name, format_)
        except (OSError, ValueError, OverflowError) as error:
            raise explain(self._name, format_, error) from error

    def close(self) -> None:
        os.close(self._fd)


class PassingPort(PosixPort):
    """An end of a cut line: a port that a tap reads and writes. Opens as `PosixPort`."""

    _access = os.O_RDWR

    def fileno(self) -> int:
        return self._fd

    def write(self, data: bytes) -> int:
        """Send what the driver has room for, and say how much. Raises LinkError."""
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise lost(self._name) from error


def _set_up(fd: int, port: str, format_: SerialFormat) -> Unmarker | None:
    """Make the line settings; what is given takes out the marks, where there are any."""
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
    is_marking = _ask_for_marks(fd)
    if not hasattr(termios, f"B{format_.baud}"):
        # Such a rate is made beside termios, and what else is set takes it back on some systems.
        with suppress(NotImplementedError):
            settings._set_special_baudrate(format_.baud)  # type: ignore[attr-defined]
    termios.tcflush(fd, termios.TCIFLUSH)
    return Unmarker() if is_marking else None


def _ask_for_marks(fd: int) -> bool:
    """Have damaged bytes marked and breaks kept; whether the terminal will."""
    unwanted = termios.IGNPAR | termios.IGNBRK | termios.BRKINT | termios.ISTRIP
    attributes = termios.tcgetattr(fd)
    attributes[0] = attributes[0] & ~unwanted | termios.INPCK | termios.PARMRK
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    flags: int = termios.tcgetattr(fd)[0]
    return bool(flags & termios.PARMRK) and not flags & unwanted


@contextmanager
def _termios_errors_as_os_errors() -> Iterator[None]:
    try:
        yield
    except termios.error as error:  # Which is no OSError, but is made like one.
        raise OSError(*error.args) from error
