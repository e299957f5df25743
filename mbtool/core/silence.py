"""The length of a silence on a line, in bit times, character times, ms or us (28bits, 5ms)."""

# The duration of a bit or a character depends on the line's baud rate and character format. So a
# silence keeps the unit in which it was given: 28 bit times stay 28 bit times at 9600 and at 19200
# baud.

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum
from typing import Self

from mbtool.core.errors import UsageError

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
        # The length of bits and characters is checked when the baud rate is known.
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
