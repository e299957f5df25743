"""Packs registers and bits into bytes, and unpacks them."""

from __future__ import annotations

import struct
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


_BITS = [tuple(byte >> bit & 1 for bit in range(8)) for byte in range(256)]


def words(data: bytes) -> tuple[int, ...]:
    """Unpack 16-bit registers, high byte first; an odd last byte is left out."""
    return _registers(len(data) // 2).unpack_from(data)


@lru_cache
def _registers(count: int) -> struct.Struct:
    return struct.Struct(f">{count}H")


def pack_words(values: Sequence[int]) -> bytes:
    """Pack registers, high byte first. Raises ValueError for values outside 0..65535."""
    try:
        return struct.pack(f">{len(values)}H", *values)
    except struct.error as error:
        raise ValueError(f"registers hold 0..65535, not {list(values)}") from error


def unpack_bits(data: bytes) -> tuple[int, ...]:
    """Unpack all bits; the first is bit 0 of the first byte (V1.1b3, 6.1)."""
    return tuple(chain.from_iterable([_BITS[byte] for byte in data]))


def pack_bits(values: Sequence[int]) -> bytes:
    """Pack bits, the first into bit 0 of the first byte; unused bits of the last byte are 0.

    Raises ValueError for values other than 0 and 1.
    """
    if any(value not in (0, 1) for value in values):
        raise ValueError(f"bits are 0 or 1, not {list(values)}")
    digits = "".join("1" if value else "0" for value in reversed(values))
    return int(digits or "0", 2).to_bytes(bit_bytes(len(values)), "little")


def bit_bytes(quantity: int) -> int:
    """The number of bytes that `quantity` bits fill."""
    return (quantity + 7) // 8
