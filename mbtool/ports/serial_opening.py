"""Opens serial ports: to listen, for a serial tap, and for a master or a slave."""

# A port opened to listen is never written to. On POSIX its descriptor is read-only
# (posix_serial.py); elsewhere pyserial opens it, and the class has no way to write
# (portable_serial.py).

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import serial

from mbtool.core import LinkError, SerialFormat, SerialLink
from mbtool.ports.serial_port import ListeningPort, explained, is_port_error, lost, settings_for

if TYPE_CHECKING:
    from mbtool.core.serial_format import ModemLines
    from mbtool.ports.posix_serial import PassingPort

WRITE_TIMEOUT_S = 1.0

WriteTimeout = serial.SerialTimeoutException
"""Raised by a write to a port that takes no bytes for WRITE_TIMEOUT_S."""


def open_listening(
    port: str, format_: SerialFormat, modem_lines: ModemLines | None = None
) -> ListeningPort:
    """Open a port that can only be read. Raises LinkError if that fails.

    `modem_lines` says what is done with DTR and RTS; None leaves them to the kernel.
    """
    if sys.platform != "win32":
        from mbtool.ports.posix_serial import PosixPort

        return PosixPort(port, format_, modem_lines)
    else:
        from mbtool.ports.portable_serial import PyserialPort

        return PyserialPort(port, format_, modem_lines)


def open_passing(
    port: str, format_: SerialFormat, modem_lines: ModemLines | None = None
) -> PassingPort:
    """Open one of the two ports of a serial tap, whose line was cut in two, to read and write it.

    `modem_lines` says what is done with DTR and RTS; None leaves them to the kernel. Raises
    LinkError if the port cannot be opened, and always on Windows.
    """
    if sys.platform != "win32":
        from mbtool.ports.posix_serial import PassingPort

        return PassingPort(port, format_, modem_lines)
    else:
        raise LinkError("a serial tap needs Linux or macOS")


def open_port(link: SerialLink, timeout_s: float) -> serial.Serial:
    """Open a port for a master or a slave; a read of it waits at most `timeout_s` seconds.

    Raises LinkError if the port cannot be opened or its driver refuses the settings.
    """
    with explained(link.port, link.format):
        port = serial.Serial(
            link.port,
            timeout=timeout_s,
            write_timeout=WRITE_TIMEOUT_S,
            exclusive=True,
            **settings_for(link.port, link.format),
        )
    if sys.platform != "win32":
        from mbtool.ports.real_rate import demand_rate

        try:
            demand_rate(port.fileno(), link.port, link.format.baud)
        except LinkError:
            port.close()
            raise
    return port


@contextmanager
def port_in_use(link: SerialLink) -> Iterator[None]:
    """Turn errors of reads and writes of an open port, inside the `with` block, into LinkError."""
    try:
        yield
    except WriteTimeout as error:
        raise LinkError(
            f"serial port {link.port}: takes no bytes; is anything at its other end?"
        ) from error
    except Exception as error:
        if not is_port_error(error):
            raise
        raise lost(link.port) from error
