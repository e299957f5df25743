"""What `--link` says of a file: the line that its serial bytes were heard on, without a port."""

#     rtu@19200-8E1      RTU; `rtu` alone is 19200-8E1
#     ascii@9600-7E1     ASCII; `ascii` alone is 9600-7E1

from __future__ import annotations

from dataclasses import dataclass

from mbtool.core.errors import UsageError
from mbtool.core.link_spec import SerialLink
from mbtool.core.serial_format import SerialFormat

_DEFAULTS = {"rtu": SerialFormat(), "ascii": SerialFormat(9600, 7, "E", 1)}


@dataclass(frozen=True, slots=True)
class LineSettings:
    """How characters went over a line, and whether they were RTU or ASCII."""

    format: SerialFormat
    ascii: bool = False

    def on(self, port: str) -> SerialLink:
        """A serial link with these settings."""
        return SerialLink(port, self.format, ascii=self.ascii)

    def __str__(self) -> str:
        return f"{'ascii' if self.ascii else 'rtu'}@{self.format}"


def parse_line(text: str) -> LineSettings:
    """Read `rtu@19200-8E1` or `ascii@9600-7E1`. Raises UsageError."""
    mode, at, settings = text.partition("@")
    if mode not in _DEFAULTS:
        port = " without a port" if ":" in mode else ""
        raise UsageError(
            f"--link {text!r}: say of the line of a file{port}: rtu@19200-8E1 or ascii@9600-7E1"
        )
    format_ = SerialFormat.parse(settings) if at else _DEFAULTS[mode]
    if mode == "rtu" and format_.data_bits != 8:  # Serial Line V1.02, 2.5.1.
        raise UsageError(f"--link {text!r}: RTU needs 8 data bits, for example rtu@19200-8E1")
    return LineSettings(format_, ascii=mode == "ascii")
