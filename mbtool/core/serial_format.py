"""Baud rate and character format of a serial line, and the times that follow from them."""

# MODBUS over Serial Line V1.02, section 2.5.1.1: between two frames the line is silent for at least
# 3.5 character times (t3.5), between two characters of a frame for at most 1.5 (t1.5). Above 19200
# baud both are fixed: t1.5 is 750 us, t3.5 is 1.750 ms. Some devices differ (CHINO LT830: a t3.5 of
# 28 bit times), so the user can give both:
#
#     9600-8E1,t3.5=28bits
#     19200-8N2,t1.5=1ms,t3.5=5ms
#
# If only t3.5 is given and is shorter than the standard's t1.5, t1.5 is set to the given t3.5.

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import StrEnum
from typing import Self

from mbtool.core.errors import UsageError

# The code below defines the length of a silence on a line, in bit times, character times, ms or us
# (28bits, 5ms).
#
# The duration of a bit or a character depends on the line's baud rate and character format. So a
# silence keeps the unit in which it was given: 28 bit times stay 28 bit times at 9600 and at 19200
# baud.

_PATTERN = re.compile(r"(?P<amount>\d{1,12}(?:\.\d{1,3})?) ?(?P<unit>bits|chars|ms|us)", re.ASCII)

MAX_NS = 1_000_000_000
"""The longest silence that a user can give, in ns; no line needs a longer one between two
frames."""


class SilenceUnit(StrEnum):
    """The unit in which the length of a silence is given."""

    BITS = "bits"
    CHARACTERS = "chars"
    MILLISECONDS = "ms"
    MICROSECONDS = "us"


@dataclass(frozen=True, slots=True)
class Silence:
    """The length of a silence: an amount and its unit."""

    amount: Decimal
    unit: SilenceUnit

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `28bits`, `3.5chars`, `5ms` or `750us`. Raises UsageError for other forms and 0."""
        match = _PATTERN.fullmatch(text.strip().lower())
        if match is None:
            raise UsageError(
                f"silence {text!r}: write a number and bits, chars, ms or us, "
                "for example 28bits or 5ms"
            )
        made = cls(Decimal(match["amount"]), SilenceUnit(match["unit"]))
        # The real length is checked when the baud rate is known.
        if not 0 < made.ns(baud=1_000_000, character_bits=1) <= MAX_NS:
            raise UsageError(f"silence {text!r}: it must be longer than 0 and at most 1 s")
        return made

    def ns(self, baud: int, character_bits: int) -> int:
        """The length in ns on a line with this baud rate and this number of bits in a character."""
        match self.unit:
            case SilenceUnit.BITS:
                return int(self.amount * 1_000_000_000 / baud)
            case SilenceUnit.CHARACTERS:
                return int(self.amount * character_bits * 1_000_000_000 / baud)
            case SilenceUnit.MILLISECONDS:
                return int(self.amount * 1_000_000)
            case SilenceUnit.MICROSECONDS:
                return int(self.amount * 1_000)

    def __str__(self) -> str:
        amount = f"{self.amount:f}"
        if "." in amount:
            amount = amount.rstrip("0").rstrip(".")
        return f"{amount}{self.unit}"


# The code below defines the states of DTR and RTS of a port that is opened to listen.
#
# When a port is opened, the kernel raises DTR and RTS, and when it is closed, drops both; no
# program can prevent the raising. Some RS-485 adapters send, or are powered, while one of them is
# raised.


class ModemLine(StrEnum):
    """The state of DTR, or of RTS, while a port is open to listen, and after it is closed."""

    RAISED = "raised"
    """The line is raised while the port is open, and dropped when the port is closed: the kernel
    does so by itself."""
    KEEP = "keep"
    """The line is raised, and not dropped when the port is closed. Drivers can do this only for DTR
    and RTS together."""
    OFF = "off"
    """The line is dropped right after the port is opened."""


@dataclass(frozen=True, slots=True)
class ModemLines:
    """The states of DTR and of RTS while a port is open to listen, and after it is closed."""

    dtr: ModemLine = ModemLine.RAISED
    rts: ModemLine = ModemLine.RAISED

    def __str__(self) -> str:
        return f"{self.dtr},{self.rts}"

    @classmethod
    def parse(cls, text: str) -> ModemLines:
        """Read the text that str() returns, such as `raised,off`: first DTR, then RTS."""
        dtr, _, rts = text.partition(",")
        return cls(ModemLine(dtr), ModemLine(rts))


_SERIAL_FORMAT_PATTERN = re.compile(
    r"(?P<baud>\d{1,8})(?:-(?P<data>[78])(?P<parity>[NEO])(?P<stop>[12]))?", re.ASCII
)

MIN_BAUD, MAX_BAUD = 50, 4_000_000
"""The lowest and the highest baud rate that a user may give. They are the lowest and the highest
rates for which termios has a constant, B50 and B4000000."""

_PARITIES = ("N", "E", "O")

_FIXED_ABOVE_BAUD = 19200
_FIXED_T1_5_NS = 750_000
_FIXED_T3_5_NS = 1_750_000

_T1_5 = "t1.5"
_T3_5 = "t3.5"


@dataclass(frozen=True, slots=True)
class SerialFormat:
    """The line settings of a serial port, as in `19200-8E1`."""

    baud: int = 19200
    data_bits: int = 8
    parity: str = "E"
    """The parity: N (none), E (even) or O (odd)."""
    stop_bits: int = 1
    t1_5: Silence | None = None
    """The t1.5 that the user gave; None means the standard's t1.5. `t3_5` means the same for
    t3.5."""
    t3_5: Silence | None = None

    def __post_init__(self) -> None:
        if self.baud <= 0:
            raise ValueError(f"baud must be positive, not {self.baud}")
        if self.data_bits not in (7, 8) or self.parity not in _PARITIES:
            raise ValueError(f"{self.data_bits}{self.parity} is no character format")
        if self.stop_bits not in (1, 2):
            raise ValueError(f"stop bits are 1 or 2, not {self.stop_bits}")
        for name, given in ((_T1_5, self.t1_5), (_T3_5, self.t3_5)):
            if given is not None and not 0 < self._silence_ns(given) <= MAX_NS:
                raise ValueError(f"{name} is more than 0 and at most {MAX_NS // 10**9} s")
        if self.t1_5 is not None and self._silence_ns(self.t1_5) > self.t3_5_ns:
            raise ValueError(
                f"t1.5 of {self.t1_5} is longer than t3.5, {self.t3_5 or f'{self.t3_5_ns} ns'}"
            )

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `19200-8E1`, or `19200` alone, which means 19200-8E1; silences may follow.

        The silences are t1.5 and t3.5, as in `19200-8E1,t3.5=5ms`. Raises UsageError if `text` is
        anything else, or if a value is out of its range.
        """
        settings, *silences = text.split(",")
        line = cls._parse_settings(settings)
        given: dict[str, Silence] = {}
        for each in silences:
            name, equals, silence = each.partition("=")
            if not equals or name.lower() not in (_T1_5, _T3_5):
                raise UsageError(
                    f"line settings {text!r}: {each!r} is neither t1.5=SILENCE nor t3.5=SILENCE, "
                    "for example 9600-8E1,t3.5=28bits"
                )
            given[name.lower()] = Silence.parse(silence)
        return line.with_silences(given.get(_T1_5), given.get(_T3_5))

    def with_silences(self, t1_5: Silence | None, t3_5: Silence | None) -> Self:
        """Return the same line settings with another t1.5 and t3.5; None keeps the present value.

        Raises UsageError if a silence is 0 or longer than 1 s, or if t1.5 is longer than t3.5.
        """
        try:
            return replace(self, t1_5=t1_5 or self.t1_5, t3_5=t3_5 or self.t3_5)
        except ValueError as error:
            raise UsageError(f"line settings {self}: {error}") from None

    @classmethod
    def _parse_settings(cls, text: str) -> Self:
        match = _SERIAL_FORMAT_PATTERN.fullmatch(text.upper())
        if match is None:
            raise UsageError(
                f"line settings {text!r}: write baud, data bits, parity and stop bits, "
                "for example 19200-8E1 or 9600-8N2"
            )
        if not MIN_BAUD <= int(match["baud"]) <= MAX_BAUD:
            raise UsageError(
                f"line settings {text!r}: no port has {match['baud']} baud; write {MIN_BAUD} to "
                f"{MAX_BAUD}, for example 19200-8E1"
            )
        if match["data"] is None:
            return cls(int(match["baud"]))
        return cls(int(match["baud"]), int(match["data"]), match["parity"], int(match["stop"]))

    @property
    def character_bits(self) -> int:
        """The number of bits of a character: start bit, data bits, parity bit and stop bits."""
        return 1 + self.data_bits + (self.parity != "N") + self.stop_bits

    @property
    def character_ns(self) -> int:
        """The time that one character takes on the line, in ns."""
        return self.character_bits * 1_000_000_000 // self.baud

    @property
    def t1_5_ns(self) -> int:
        """The longest silence that may occur inside a frame, in ns."""
        if self.t1_5 is not None:
            return self._silence_ns(self.t1_5)
        return min(self._standard_ns(3, _FIXED_T1_5_NS), self.t3_5_ns)

    @property
    def t3_5_ns(self) -> int:
        """The shortest silence that may occur between two frames, in ns."""
        if self.t3_5 is not None:
            return self._silence_ns(self.t3_5)
        return self._standard_ns(7, _FIXED_T3_5_NS)

    @property
    def has_fixed_silences(self) -> bool:
        """True if t3.5 is the standard's fixed 1.75 ms, not a number of character times."""
        return self.t3_5 is None and self.baud > _FIXED_ABOVE_BAUD

    def _standard_ns(self, half_characters: int, fixed_ns: int) -> int:
        if self.baud > _FIXED_ABOVE_BAUD:
            return fixed_ns
        return self.character_bits * half_characters * 500_000_000 // self.baud

    @classmethod
    def usual(cls, *, is_ascii: bool) -> Self:
        """The default settings of a line: 19200-8E1 for RTU, 9600-7E1 for ASCII."""
        return cls(9600, 7) if is_ascii else cls()

    def demand_rtu(self, given: str, example: str) -> None:
        """Raise UsageError unless there are 8 data bits, which RTU needs.

        The error text shows `given`, the text that the user wrote, and `example`, a correct one.
        """
        if self.data_bits != 8:  # Serial Line V1.02, 2.5.1.
            raise UsageError(f"{given}: RTU needs 8 data bits, for example {example}")

    def _silence_ns(self, silence: Silence) -> int:
        return silence.ns(self.baud, self.character_bits)

    def __str__(self) -> str:
        silences = ((_T1_5, self.t1_5), (_T3_5, self.t3_5))
        given = "".join(f",{name}={each}" for name, each in silences if each is not None)
        return f"{self.baud}-{self.data_bits}{self.parity}{self.stop_bits}{given}"
