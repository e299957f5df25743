"""A serial port that is opened and read by pyserial, for Windows, where select takes no ports."""

# pyserial opens a port for writing, too, but this class has no method that writes.
#
# A read waits IDLE_S or not at all: for any other timeout, pyserial would set up the port again.
# pyserial does not report which bytes were damaged, nor how many were lost.

from __future__ import annotations

from collections.abc import Sequence

import serial

from mbtool.core import SerialFormat
from mbtool.core.serial_format import ModemLine, ModemLines
from mbtool.ports.serial_port import IDLE_S, explained, lost, settings_for


class PyserialPort:
    """A port that can only be read. The constructor raises LinkError if it cannot be opened."""

    damaged: Sequence[int] = ()

    def __init__(
        self, port: str, format_: SerialFormat, modem_lines: ModemLines | None = None
    ) -> None:
        self._name = port
        lines = modem_lines or ModemLines()
        with explained(port, format_):
            self._port = serial.Serial(timeout=IDLE_S, **settings_for(port, format_))
            self._port.dtr = lines.dtr is not ModemLine.OFF
            self._port.rts = lines.rts is not ModemLine.OFF
            self._port.port = port
            self._port.open()

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
        with explained(self._name, format_):
            self._port.apply_settings(settings_for(self._name, format_))
            self._port.reset_input_buffer()

    def close(self) -> None:
        self._port.close()
