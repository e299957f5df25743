"""The value of `--link` for a file of serial bytes: a line's settings, without a port."""

#     rtu@19200-8E1      RTU; `rtu` alone means rtu@19200-8E1
#     ascii@9600-7E1     ASCII; `ascii` alone means ascii@9600-7E1

from __future__ import annotations

from dataclasses import dataclass

from mbtool.core.errors import UsageError
from mbtool.core.link_spec import SerialLink
from mbtool.core.serial_format import SerialFormat

_MODES = ("rtu", "ascii")


@dataclass(frozen=True, slots=True)
class LineSettings:
    """The baud rate and character format of a serial line, and its mode: RTU or ASCII."""

    format: SerialFormat
    ascii: bool = False

    def on(self, port: str) -> SerialLink:
        """Return the serial link with this port and these settings."""
        return SerialLink(port, self.format, ascii=self.ascii)

    def __str__(self) -> str:
        return f"{'ascii' if self.ascii else 'rtu'}@{self.format}"


def parse_line(text: str) -> LineSettings:
    """Read `rtu@19200-8E1` or `ascii@9600-7E1`.

    Raises UsageError for any other text, and for settings that the line cannot have.
    """
    mode, at, settings = text.partition("@")
    if mode not in _MODES:
        port = " without a port" if ":" in mode else ""
        raise UsageError(
            f"--link {text!r}: say of the line of a file{port}: rtu@19200-8E1 or ascii@9600-7E1"
        )
    is_ascii = mode == "ascii"
    format_ = SerialFormat.parse(settings) if at else SerialFormat.usual(is_ascii=is_ascii)
    if not is_ascii:
        format_.demand_rtu(f"--link {text!r}", "rtu@19200-8E1")
    return LineSettings(format_, is_ascii)
