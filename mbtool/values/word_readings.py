"""The ways to read registers as numbers: a type, and the order of words and bytes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

from mbtool.devices.point_types import ByteOrder, PointType, WordOrder


class Order(StrEnum):
    """The order of the bytes of a number of several registers; A is its highest byte."""

    ABCD = "ABCD"
    CDAB = "CDAB"
    BADC = "BADC"
    DCBA = "DCBA"

    @property
    def is_low_first(self) -> bool:
        """True if the register with the lowest digits comes first."""
        return self in (Order.CDAB, Order.DCBA)

    @property
    def is_swapped(self) -> bool:
        """True if the two bytes of each register are swapped."""
        return self in (Order.BADC, Order.DCBA)

    @property
    def words(self) -> WordOrder:
        return WordOrder.LOW_FIRST if self.is_low_first else WordOrder.HIGH_FIRST

    @property
    def bytes(self) -> ByteOrder:
        return ByteOrder.LOW_FIRST if self.is_swapped else ByteOrder.HIGH_FIRST


class WordReading(NamedTuple):
    """A way to read registers as a number."""

    type: PointType
    order: Order = Order.ABCD

    @property
    def words(self) -> int:
        return self.type.words


_SWAPPED = [(word >> 8) | ((word & 0xFF) << 8) for word in range(1 << 16)]


def numbers_in(columns: Sequence[Sequence[int]], reading: WordReading) -> Sequence[float] | None:
    """Return the numbers that some registers hold, one for each time.

    `columns` has the words of each register over time, in the order of addresses. None if they
    hold no number: digits that are not BCD.
    """
    if reading.order.is_low_first:
        columns = columns[::-1]
    if reading.order.is_swapped:
        columns = [[_SWAPPED[word] for word in column] for column in columns]
    words = [word for row in zip(*columns, strict=True) for word in row]
    data = struct.pack(f">{len(words)}H", *words)
    code = reading.type.struct_code
    if code is not None:
        return struct.unpack(f">{len(columns[0])}{code}", data)
    size = 2 * len(columns)
    numbers = [reading.type.number(data[at : at + size]) for at in range(0, len(data), size)]
    found = [one for one in numbers if one is not None]
    return found if len(found) == len(numbers) else None
