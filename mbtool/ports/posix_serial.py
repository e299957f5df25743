"""A serial port of Linux or macOS: read-only to listen, read and write for a serial tap."""

# pyserial can set up a line on every system, also with unusual baud rates, but its open() opens the
# port for writing, too. So the port is opened here, with O_RDONLY, and only pyserial's setup is
# applied to the descriptor (_reconfigure_port of pyserial 3.5 needs only the descriptor and the
# settings).
#
# The kernel itself does two things that no program can prevent. It raises DTR and RTS when a port
# is opened and drops them when it is closed (--dtr and --rts do what is possible after the
# opening). And until a port is raw, its line discipline echoes what arrives: a port that was not
# raw before may send back what arrives between the opening and the next two calls here, which lock
# the port and make it raw, before all other settings.
#
# The port is locked with flock, as pyserial and most terminal programs do, because two readers of
# one port take bytes from each other. The lock stops only programs that use flock, and ends with
# the process. TIOCEXCL, which would stop every other program, is not used.
#
# The driver is asked to mark damaged bytes (line_errors.py), which pyserial cannot do. If it does
# not support that, bytes are read without marks.

from __future__ import annotations

import fcntl
import os
import select
import struct
import sys
import termios
from collections.abc import Sequence
from contextlib import suppress

import serial

from mbtool.core import LinkError, SerialFormat
from mbtool.core.serial_format import ModemLine, ModemLines
from mbtool.ports.line_errors import ErrorCounts, Unmarker
from mbtool.ports.low_latency import LowLatency
from mbtool.ports.real_rate import demand_rate
from mbtool.ports.serial_port import explained, lost, settings_for
from mbtool.ports.serial_records import MAX_DATA

_COUNTERS = struct.Struct("20i")
"""struct serial_icounter_struct of linux/serial.h: 11 counters and room for 9 more."""
_ERROR_COUNTERS = slice(6, 11)
"""The indexes, in the struct's 20 numbers, of the counters frame, overrun, parity, brk and
buf_overrun. `ErrorCounts` has its fields in the same order."""


class PosixPort:
    """A port that can only be read. The constructor raises LinkError if it cannot be opened."""

    _access = os.O_RDONLY

    def __init__(
        self, port: str, format_: SerialFormat, modem_lines: ModemLines | None = None
    ) -> None:
        self._name = port
        self.damaged: Sequence[int] = ()
        self._low_latency: LowLatency | None = None
        with explained(port, format_):
            self._fd = os.open(port, self._access | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            with explained(port, format_):
                _claim(self._fd)
            _set_modem_lines(self._fd, port, modem_lines or ModemLines())
            self._low_latency = LowLatency(self._fd, port)
            self.tune(format_)
        except Exception:
            self.close()
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
            wait_s = 0  # Do not wait: the rest of a mark is there already.

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
        with explained(self._name, format_):
            self._unmarker = _set_up(self._fd, self._name, format_)
        demand_rate(self._fd, self._name, format_.baud)

    def close(self) -> None:
        if self._low_latency is not None:
            self._low_latency.restore()
        os.close(self._fd)


class PassingPort(PosixPort):
    """One of the two ports of a serial tap, whose line was cut in two; it is read and written."""

    _access = os.O_RDWR

    def fileno(self) -> int:
        return self._fd

    def write(self, data: bytes) -> int:
        """Write as many bytes as the driver has room for; return their number.

        Raises LinkError when the port is gone.
        """
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise lost(self._name) from error


def _claim(fd: int) -> None:
    """Lock a port and make it raw, so that it echoes nothing.

    Raises an OSError if another program has locked the port, termios.error if it is no serial port.
    """
    fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    attributes = termios.tcgetattr(fd)
    attributes[0] &= ~(termios.IXON | termios.IXOFF)
    attributes[1] &= ~termios.OPOST
    attributes[3] &= ~(termios.ECHO | termios.ECHONL | termios.ICANON | termios.ISIG)
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _set_modem_lines(fd: int, port: str, wanted: ModemLines) -> None:
    """Do with DTR and RTS what `wanted` says: OFF drops the line now, RAISED does nothing.

    With KEEP for either line, closing the port drops neither. Raises LinkError if the driver cannot
    drop a line now.
    """
    lines = ((wanted.dtr, "DTR", termios.TIOCM_DTR), (wanted.rts, "RTS", termios.TIOCM_RTS))
    if ModemLine.KEEP in (wanted.dtr, wanted.rts):
        attributes = termios.tcgetattr(fd)
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
    for how, name, bit in lines:
        if how is ModemLine.OFF:
            try:
                fcntl.ioctl(fd, termios.TIOCMBIC, struct.pack("i", bit))
            except OSError as error:
                raise LinkError(
                    f"serial port {port}: its driver does not switch {name} off; "
                    f"leave out --{name.lower()} off"
                ) from error


def _set_up(fd: int, port: str, format_: SerialFormat) -> Unmarker | None:
    """Apply the line settings, and discard the bytes that arrived before.

    Returns an Unmarker, which removes the driver's marks, if the driver now marks damaged bytes;
    otherwise None.
    """
    # With this timeout pyserial sets VMIN to 1. So a read fails with EAGAIN if there are no data,
    # and a read that returns no bytes means that the port is gone.
    settings = serial.Serial(inter_byte_timeout=0, **settings_for(port, format_))
    settings.fd = fd
    settings._reconfigure_port(force_update=True)  # type: ignore[attr-defined]
    is_marking = _ask_for_marks(fd)
    if not hasattr(termios, f"B{format_.baud}"):
        # termios has no constant for this baud rate, so pyserial has set it by a special call. On
        # some systems the tcsetattr of _ask_for_marks undoes that, so the call is repeated.
        with suppress(NotImplementedError):
            settings._set_special_baudrate(format_.baud)  # type: ignore[attr-defined]
    termios.tcflush(fd, termios.TCIFLUSH)
    return Unmarker() if is_marking else None


def _ask_for_marks(fd: int) -> bool:
    """Ask the driver to mark damaged bytes and breaks; return True if it does both."""
    unwanted = termios.IGNPAR | termios.IGNBRK | termios.BRKINT | termios.ISTRIP
    attributes = termios.tcgetattr(fd)
    attributes[0] = attributes[0] & ~unwanted | termios.INPCK | termios.PARMRK
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    flags: int = termios.tcgetattr(fd)[0]
    return bool(flags & termios.PARMRK) and not flags & unwanted
