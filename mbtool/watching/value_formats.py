"""Writes register values in the format that the user chose for a row."""

# A 32-bit float has two registers and four bytes. With A as its most significant byte: ABCD is the
# standard's order of registers and bytes, CDAB has the registers swapped, BADC the bytes of each
# register, DCBA both.

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import StrEnum


class ValueFormat(StrEnum):
    """A format for the values of a row."""

    NAMED = "as named"
    DECIMAL = "decimal"
    HEX = "hex"
    SIGNED = "signed"
    FLOAT_ABCD = "float32 ABCD"
    FLOAT_CDAB = "float32 CDAB"
    FLOAT_BADC = "float32 BADC"
    FLOAT_DCBA = "float32 DCBA"

    @property
    def is_float(self) -> bool:
        return self.value.startswith("float32")

    @property
    def next(self) -> ValueFormat:
        """The next format when the user goes through all formats."""
        every = list(ValueFormat)
        return every[(every.index(self) + 1) % len(every)]


def register_texts(values: Sequence[int], form: ValueFormat) -> list[str]:
    """Return the text of each register; for a float format, of each pair of registers.

    A register that is left over from the pairs gives `-`.
    """
    if form.is_float:
        pairs = zip(values[::2], values[1::2], strict=False)
        texts = [float_text(first, second, form) for first, second in pairs]
        return [*texts, "-"] if len(values) % 2 else texts
    return [register_text(value, form) for value in values]


def register_text(value: int, form: ValueFormat) -> str:
    """Return the text of one register (0 to 65535) in a format for single registers."""
    if form is ValueFormat.HEX:
        return f"{value:04X}H"
    if form is ValueFormat.SIGNED and 0x8000 <= value <= 0xFFFF:
        return str(value - 0x10000)
    return str(value)


def float_text(first: int, second: int, form: ValueFormat) -> str:
    """Return the float in two registers, `first` at the lower address, with up to 7 digits."""
    if form in (ValueFormat.FLOAT_CDAB, ValueFormat.FLOAT_DCBA):
        first, second = second, first
    order = "<" if form in (ValueFormat.FLOAT_BADC, ValueFormat.FLOAT_DCBA) else ">"
    data = struct.pack(f"{order}HH", first & 0xFFFF, second & 0xFFFF)
    (number,) = struct.unpack(">f", data)
    return f"{number:.7g}"
