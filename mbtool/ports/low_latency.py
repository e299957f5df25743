"""Makes a Linux driver deliver bytes at once while a port is open, and restores its settings."""

# Two settings of drivers delay bytes, so that the ends of frames are timed late:
#
#     ASYNC_LOW_LATENCY   a flag of the port (TIOCSSERIAL). With it, ftdi_sio sets the adapter's
#                         latency timer to 1 ms; without, to the timer's own value, often 16 ms.
#                         It changes nothing on an 8250.
#     rx_trig_bytes       of an 8250: how many bytes its FIFO collects. Only root may change it.
#
# Both settings outlast the closing of the port, so `restore` puts the old ones back; if the process
# is killed, they are not put back. A setting that the driver or the permissions do not allow stays
# unchanged; `mbtool links` reports it.

from __future__ import annotations

import fcntl
import os
import struct
import sys
import termios
from contextlib import suppress
from pathlib import Path

_SETTINGS = struct.Struct("18i")
"""struct serial_struct of linux/serial.h, 72 bytes; the flags are its fifth int."""
_FLAGS_AT = 4
_LOW_LATENCY = 1 << 13
_AT_ONCE = "1"


class LowLatency:
    """Makes the driver of one port deliver bytes at once, and restores its old settings."""

    def __init__(self, fd: int, port: str, root: Path = Path("/")) -> None:
        """Make the driver deliver bytes at once: set the flag ASYNC_LOW_LATENCY, and rx_trig_bytes
        to 1.

        A setting that the driver or the permissions do not allow stays as it is. `fd` is the file
        descriptor of the open port, `port` its path, and `root` the folder that contains /sys. Does
        nothing on other systems than Linux.
        """
        self._fd = fd
        name = os.path.basename(os.path.realpath(port))
        self._trigger = root / "sys/class/tty" / name / "rx_trig_bytes"
        self._trigger_was = ""
        self._flag_was = True
        if sys.platform == "linux":
            with suppress(OSError):
                self._flag_was = self._set_flag(is_on=True)
            with suppress(OSError, UnicodeDecodeError):
                was = self._trigger.read_text(encoding="ascii").strip()
                if was != _AT_ONCE:
                    self._trigger.write_text(_AT_ONCE, encoding="ascii")
                    self._trigger_was = was

    def restore(self) -> None:
        """Put back the old settings. Call this while the port is still open."""
        with suppress(OSError):
            if not self._flag_was:
                self._set_flag(is_on=False)
        with suppress(OSError):
            if self._trigger_was:
                self._trigger.write_text(self._trigger_was, encoding="ascii")

    def _set_flag(self, *, is_on: bool) -> bool:
        """Set or clear the port's flag ASYNC_LOW_LATENCY; return its old state. Raises OSError."""
        answer = fcntl.ioctl(self._fd, termios.TIOCGSERIAL, bytes(_SETTINGS.size))
        values = list(_SETTINGS.unpack(answer))
        was = bool(values[_FLAGS_AT] & _LOW_LATENCY)
        if was != is_on:
            values[_FLAGS_AT] ^= _LOW_LATENCY
            fcntl.ioctl(self._fd, termios.TIOCSSERIAL, _SETTINGS.pack(*values))
        return was
