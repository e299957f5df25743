"""The encodings of a point's value: its type, and the order of its words and bytes."""

from __future__ import annotations

import struct
from enum import StrEnum


class PointType(StrEnum):
    """Tells how the value of a point is encoded in its registers or its bit."""

    BIT = "bit"
    UINT16 = "uint16"
    INT16 = "int16"
    BCD16 = "bcd16"
    """Four decimal digits of four bits each."""
    HEX16 = "hex16"
    """A code that the manual writes in hexadecimal."""
    OCTETS = "octets"
    """Two numbers of an IP address, 0 to 255 each; the first one is in the high byte."""
    UINT32 = "uint32"
    INT32 = "int32"
    BCD32 = "bcd32"
    FLOAT32 = "float32"
    UINT64 = "uint64"
    INT64 = "int64"
    FLOAT64 = "float64"
    STRING = "string"
    """Two characters in each register; the first one is in the high byte."""
    FLAGS = "flags"
    """A register whose bits have names."""
    BIT_FIELD = "bit-field"
    """A register with one bit for each channel."""
    NIBBLE_FIELD = "nibble-field"
    """A register with four bits for each channel."""

    @property
    def words(self) -> int:
        """Number of addresses (registers or bits) that a value of this type takes.

        0 for a string, whose length the point states.
        """
        return 0 if self is PointType.STRING else _WORDS.get(self, 1)

    @property
    def channel_bits(self) -> int:
        """Number of bits for each channel in a bit field or nibble field; 0 for other types."""
        return {PointType.BIT_FIELD: 1, PointType.NIBBLE_FIELD: 4}.get(self, 0)

    @property
    def whole_numbers(self) -> range | None:
        """The range of numbers that an integer type can encode; None for other types."""
        return _RANGES.get(self)

    @property
    def is_number(self) -> bool:
        """True if the value is a number, which can have a scale and a unit of measure."""
        return self in _RANGES or self.is_float

    @property
    def is_float(self) -> bool:
        """True if the value is a number of IEEE 754, of 32 or 64 bits."""
        return self in (PointType.FLOAT32, PointType.FLOAT64)

    @property
    def struct_code(self) -> str | None:
        """The character of Python's module struct for values of this type, without the byte order.

        None for decimal digits, strings, and registers whose bits or bytes have meanings.
        """
        return _STRUCT_CODES.get(self)

    def number(self, data: bytes) -> float | None:
        """Return the number in the bytes of a value, the highest byte first.

        None if the bytes hold no number: a string, or digits that are not BCD.
        """
        if self is PointType.STRING:
            return None
        if self.is_bcd:
            digits = data.hex()
            return int(digits) if digits.isdecimal() else None
        code = self.struct_code
        if code is None:
            return int.from_bytes(data, "big")
        (number,) = struct.unpack(f">{code}", data)
        return float(number) if self.is_float else int(number)

    @property
    def is_bcd(self) -> bool:
        """True if the value is decimal digits of four bits each."""
        return self in (PointType.BCD16, PointType.BCD32)


_WORDS = {
    PointType.UINT32: 2,
    PointType.INT32: 2,
    PointType.BCD32: 2,
    PointType.FLOAT32: 2,
    PointType.UINT64: 4,
    PointType.INT64: 4,
    PointType.FLOAT64: 4,
}
_STRUCT_CODES = {
    PointType.UINT16: "H",
    PointType.HEX16: "H",
    PointType.INT16: "h",
    PointType.UINT32: "I",
    PointType.INT32: "i",
    PointType.FLOAT32: "f",
    PointType.UINT64: "Q",
    PointType.INT64: "q",
    PointType.FLOAT64: "d",
}
_RANGES = {
    PointType.UINT16: range(1 << 16),
    PointType.INT16: range(-(1 << 15), 1 << 15),
    PointType.BCD16: range(10**4),
    PointType.UINT32: range(1 << 32),
    PointType.INT32: range(-(1 << 31), 1 << 31),
    PointType.BCD32: range(10**8),
    PointType.UINT64: range(1 << 64),
    PointType.INT64: range(-(1 << 63), 1 << 63),
}


class WordOrder(StrEnum):
    """The order of the registers of a value that takes several registers."""

    HIGH_FIRST = "high-first"
    LOW_FIRST = "low-first"


class ByteOrder(StrEnum):
    """The order of the two bytes of a register; in the standard the high byte comes first."""

    HIGH_FIRST = "high-first"
    LOW_FIRST = "low-first"
