"""The four tables of an embedded slave: what its registers and bits hold."""

# Every address of every table exists here and holds 0 at first; which of them a device has is its
# profile's matter, and the responder's to check.
#
# A register is kept as it travels, high byte first, and a bit as a byte of 0 or 1, so that what a
# response carries is one slice. 384 KiB in all, and what the profile's blocks hold (blocks.py):
# memory does not grow.

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Self

from mbtool.modbus.tables import ADDRESSES, Table
from mbtool.slave.device.blocks import Blocks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.model import Point, Profile


_DIGITS = bytes.maketrans(b"\x00\x01", b"01")


class RegisterImage:
    """What each address of the four tables holds: registers 0..65535, bits 0 or 1."""

    __slots__ = ("_cells", "blocks")

    def __init__(self, blocks: Blocks | None = None) -> None:
        self._cells = {table: bytearray(ADDRESSES * _width(table)) for table in Table}
        self.blocks = blocks or Blocks()

    @classmethod
    def of(cls, profile: Profile) -> Self:
        """What a device holds before anyone writes it: the defaults of its points, else 0."""
        image = cls(Blocks.of(profile))
        for point in profile.points:
            if point.default is not None:
                for address in point.addresses:
                    image.put(point, address, [point.default])
        return image

    def get(self, table: Table, address: int, quantity: int = 1) -> list[int]:
        """The values of a range. Raises ValueError for one that no table has."""
        _check_range(address, quantity)
        if table.is_bits:
            return list(self._cells[table][address : address + quantity])
        data = self._cells[table][2 * address : 2 * (address + quantity)]
        return list(struct.unpack(f">{quantity}H", data))

    def set(self, table: Table, address: int, values: Sequence[int]) -> None:
        """Write a range: all of it, or nothing and ValueError for what no table can hold."""
        _check_range(address, len(values))
        highest = 1 if table.is_bits else 0xFFFF
        if not all(0 <= value <= highest for value in values):
            raise ValueError(f"{table} hold 0..{highest}, not {list(values)}")
        width = _width(table)
        data = bytes(values) if table.is_bits else struct.pack(f">{len(values)}H", *values)
        self._cells[table][width * address : width * (address + len(values))] = data

    def put(self, point: Point, address: int, values: Sequence[int]) -> None:
        """Write one of the places of a point, where a master finds it: in its block, if it has one.

        Raises ValueError for what no table can hold.
        """
        if point.block is None:
            self.set(point.table, address, values)
        else:
            self.blocks.set(point.table, point.block, address - point.block, values)

    def share(self, table: Table, with_table: Table) -> None:
        """Make two tables one: each address of both holds what `with_table` holds.

        Where that is 0 it takes over what the other one holds.
        """
        ours, theirs = self._cells[table], self._cells[with_table]
        if ours is theirs:
            return
        width = _width(table)
        for at in range(0, len(ours), width):
            if any(ours[at : at + width]) and not any(theirs[at : at + width]):
                theirs[at : at + width] = ours[at : at + width]
        self._cells[table] = theirs
        self.blocks.share(table, with_table)

    def cells(self, table: Table, span: range) -> tuple[bytearray, slice]:
        """The bytes of a table, two for a register and one for a bit, and which are the range's.

        For who reads the same range again and again; the bytes stay the table's.
        """
        width = _width(table)
        return self._cells[table], slice(width * span.start, width * span.stop)


def packed_bits(cells: bytearray) -> bytes:
    """Bits as a response carries them: eight to a byte, the lowest address lowest (V1.1b3, 6.1)."""
    digits = cells.translate(_DIGITS)[::-1]  # A number's digits begin with the highest.
    return int(digits, 2).to_bytes((len(cells) + 7) // 8, "little")


def _width(table: Table) -> int:
    return 1 if table.is_bits else 2


def _check_range(address: int, quantity: int) -> None:
    if address < 0 or quantity < 0 or address + quantity > ADDRESSES:
        raise ValueError(f"addresses {address}..{address + quantity - 1} are not in 0..65535")
