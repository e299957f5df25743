"""The four tables of an embedded slave: what its registers and bits hold."""

# Every address of every table exists here and holds 0 at first; which of them a device has is its
# profile's matter, and the responder's to check. The tables are flat arrays, 384 KiB in all, so
# reading and writing a range is one slice, and memory does not grow.

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Self

from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.model import Profile

ADDRESSES = 0x10000

_BITS = "B"
_WORDS = "H"


class RegisterImage:
    """What each address of the four tables holds: registers 0..65535, bits 0 or 1."""

    __slots__ = ("_tables",)

    def __init__(self) -> None:
        self._tables = {table: _zeros(_BITS if table.is_bits else _WORDS) for table in Table}

    @classmethod
    def of(cls, profile: Profile) -> Self:
        """What a device holds before anyone writes it: the defaults of its points, else 0."""
        image = cls()
        for point in profile.points:
            if point.default is not None:
                for address in point.addresses:
                    image.set(point.table, address, [point.default])
        return image

    def get(self, table: Table, address: int, quantity: int = 1) -> list[int]:
        """The values of a range. Raises ValueError for one that no table has."""
        _check_range(address, quantity)
        return self._tables[table][address : address + quantity].tolist()

    def set(self, table: Table, address: int, values: Sequence[int]) -> None:
        """Write a range: all of it, or nothing and ValueError for what no table can hold."""
        _check_range(address, len(values))
        highest = 1 if table.is_bits else 0xFFFF
        if not all(0 <= value <= highest for value in values):
            raise ValueError(f"{table} hold 0..{highest}, not {list(values)}")
        cells = self._tables[table]
        cells[address : address + len(values)] = array(cells.typecode, values)


def _zeros(typecode: str) -> array[int]:
    return array(typecode, [0]) * ADDRESSES


def _check_range(address: int, quantity: int) -> None:
    if address < 0 or quantity < 0 or address + quantity > ADDRESSES:
        raise ValueError(f"addresses {address}..{address + quantity - 1} are not in 0..65535")
