"""Baud rate and character format, and the times that follow from them."""

# MODBUS over Serial Line V1.02, section 2.5.1.1: frames are parted by at least 3.5 character times,
# characters of one frame by at most 1.5; above 19200 baud both are fixed, at 750 us and 1.750 ms.

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Self

from mbtool.core.errors import UsageError

_PATTERN = re.compile(
    r"(?P<baud>\d{1,8})(?:-(?P<data>[78])(?P<parity>[NEO])(?P<stop>[12]))?", re.ASCII
)

_PARITIES = ("N", "E", "O")

_FIXED_ABOVE_BAUD = 19200
_FIXED_T1_5_NS = 750_000
_FIXED_T3_5_NS = 1_750_000


@dataclass(frozen=True, slots=True)
class SerialFormat:
    """The line settings of a serial port, as in `19200-8E1`."""

    baud: int = 19200
    data_bits: int = 8
    parity: str = "E"
    """N, E or O."""
    stop_bits: int = 1

    def __post_init__(self) -> None:
        if self.baud <= 0:
            raise ValueError(f"baud must be positive, not {self.baud}")
        if self.data_bits not in (7, 8) or self.parity not in _PARITIES:
            raise ValueError(f"{self.data_bits}{self.parity} is no character format")
        if self.stop_bits not in (1, 2):
            raise ValueError(f"stop bits are 1 or 2, not {self.stop_bits}")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `19200-8E1`, or `19200` alone for 8E1, the standard's default.

        Raises UsageError.
        """
        match = _PATTERN.fullmatch(text.upper())
        if match is None or int(match["baud"]) == 0:
            raise UsageError(
                f"line settings {text!r}: write baud, data bits, parity and stop bits, "
                "for example 19200-8E1 or 9600-8N2"
            )
        if match["data"] is None:
            return cls(int(match["baud"]))
        return cls(int(match["baud"]), int(match["data"]), match["parity"], int(match["stop"]))

    @property
    def character_bits(self) -> int:
        """Start bit, data bits, parity bit and stop bits."""
        return 1 + self.data_bits + (self.parity != "N") + self.stop_bits

    @property
    def character_ns(self) -> int:
        """The time one character takes on the line."""
        return self.character_bits * 1_000_000_000 // self.baud

    @property
    def t1_5_ns(self) -> int:
        """The longest silence inside a frame."""
        if self.baud > _FIXED_ABOVE_BAUD:
            return _FIXED_T1_5_NS
        return self.character_bits * 1_500_000_000 // self.baud

    @property
    def t3_5_ns(self) -> int:
        """The shortest silence between frames."""
        if self.baud > _FIXED_ABOVE_BAUD:
            return _FIXED_T3_5_NS
        return self.character_bits * 3_500_000_000 // self.baud

    def __str__(self) -> str:
        return f"{self.baud}-{self.data_bits}{self.parity}{self.stop_bits}"
