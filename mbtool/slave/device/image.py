"""The four tables of a simulated slave: the contents of its registers and bits."""

# Every address of every table exists here and is 0 at first. The profile says which addresses the
# device has, and the responder checks that.
#
# A register is stored as on the wire, high byte first, and a bit as a byte of 0 or 1, so that the
# data of a response is one slice.
#
# Memory: 384 KiB, and the profile's blocks (Blocks); it never grows.

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Self

from mbtool.modbus.tables import ADDRESSES, Table

if TYPE_CHECKING:
    from mbtool.devices.model import Point, Profile

_DIGITS = bytes.maketrans(b"\x00\x01", b"01")


class RegisterImage:
    """The value of each address of the four tables: registers 0..65535, bits 0 or 1."""

    __slots__ = ("_cells", "blocks")

    def __init__(self, blocks: Blocks | None = None) -> None:
        self._cells = {table: bytearray(ADDRESSES * _width(table)) for table in Table}
        self.blocks = blocks or Blocks()

    @classmethod
    def of(cls, profile: Profile) -> Self:
        """Make the image of a device as delivered: each point has its default value, else 0."""
        image = cls(Blocks.of(profile))
        for point in profile.points:
            if point.default is not None:
                for address in point.addresses:
                    image.put(point, address, [point.default])
        return image

    def get(self, table: Table, address: int, quantity: int = 1) -> list[int]:
        """Return the values of `quantity` addresses, from `address` on.

        Raises ValueError if one of the addresses is not 0..65535.
        """
        _check_range(address, quantity)
        if table.is_bits:
            return list(self._cells[table][address : address + quantity])
        data = self._cells[table][2 * address : 2 * (address + quantity)]
        return list(struct.unpack(f">{quantity}H", data))

    def set(self, table: Table, address: int, values: Sequence[int]) -> None:
        """Write the values of consecutive addresses, from `address` on.

        Raises ValueError, and writes nothing, if one of the addresses is not 0..65535, or a value
        is not 0..65535 for a register or 0..1 for a bit.
        """
        _check_range(address, len(values))
        highest = 1 if table.is_bits else 0xFFFF
        if not all(0 <= value <= highest for value in values):
            raise ValueError(f"{table} hold 0..{highest}, not {list(values)}")
        width = _width(table)
        data = bytes(values) if table.is_bits else struct.pack(f">{len(values)}H", *values)
        self._cells[table][width * address : width * (address + len(values))] = data

    def put(self, point: Point, address: int, values: Sequence[int]) -> None:
        """Write the registers or the bit of a point; `address` is the first one to write.

        Writes into the point's block, if it has one, else into the table. Raises ValueError as
        `set` does, and if the values extend beyond the end of the block.
        """
        if point.block is None:
            self.set(point.table, address, values)
        else:
            self.blocks.set(point.table, point.block, address - point.block, values)

    def share_contents(self, table: Table, with_table: Table) -> None:
        """Let `table` and `with_table` have the same contents from now on, at each address.

        An address starts with its value in `with_table`; if that is 0, with its value in `table`.
        """
        ours, theirs = self._cells[table], self._cells[with_table]
        if ours is theirs:
            return
        width = _width(table)
        for at in range(0, len(ours), width):
            if any(ours[at : at + width]) and not any(theirs[at : at + width]):
                theirs[at : at + width] = ours[at : at + width]
        self._cells[table] = theirs
        self.blocks.share_contents(table, with_table)

    def cells(self, table: Table, span: range) -> tuple[bytearray, slice]:
        """Return the bytes that hold a table, and the slice of them for the addresses `span`.

        A register has two bytes, a bit has one. The bytes are not a copy: a caller that keeps both
        results can read the present values of the range at any later time.
        """
        width = _width(table)
        return self._cells[table], slice(width * span.start, width * span.stop)


def packed_bits(cells: bytearray) -> bytes:
    """Pack bits for a response: eight to a byte, the first is bit 0 (V1.1b3, 6.1).

    `cells` has one byte, 0 or 1, for each bit.
    """
    digits = cells.translate(_DIGITS)[::-1]  # int() reads the highest digit first.
    return int(digits, 2).to_bytes((len(cells) + 7) // 8, "little")


def _width(table: Table) -> int:
    return 1 if table.is_bits else 2


def _check_range(address: int, quantity: int) -> None:
    if address < 0 or quantity < 0 or address + quantity > ADDRESSES:
        raise ValueError(f"addresses {address}..{address + quantity - 1} are not in 0..65535")


# Blocks are registers that can only be read together, from the first address of the block on.
#
# A block is a group of registers that exists beside the table of the same addresses: points with
# the key `block` in the profile. A read that begins at a block's first address returns the block's
# registers; a read that begins at a later address returns the table's. devices/block_reads.py says
# which reads are allowed.
#
# Memory: a block ends with its last point, so it has at most 65536 registers.


class Blocks:
    """The register blocks of one device, by table and first address."""

    def __init__(self) -> None:
        self._blocks: dict[tuple[Table, int], list[int]] = {}

    @classmethod
    def of(cls, profile: Profile) -> Self:
        """Return the blocks that a device's profile describes, all registers 0."""
        blocks = cls()
        for table in Table:
            points = [point for point in profile.points if point.table is table]
            for point in points:
                if point.block is None:
                    continue
                first = point.block
                held = blocks._blocks.setdefault((table, first), [])
                held += [0] * (max(_addresses_of(point)) + 1 - first - len(held))
        return blocks

    def get(self, table: Table, span: range) -> list[int] | None:
        """Return the registers that a read of the addresses `span` gets from a block.

        Returns None if the read does not begin at the first address of a block.
        """
        block = self._blocks.get((table, span.start)) if self._blocks else None
        return None if block is None else block[: len(span)]

    def set(self, table: Table, first: int, offset: int, values: Sequence[int]) -> None:
        """Write `values` into the block at address `first`, from the block's register `offset` on.

        `offset` counts from 0. Raises ValueError if the values extend beyond the block's end, or if
        one is not 0..65535.
        """
        block = self._blocks[table, first]
        if offset + len(values) > len(block) or not all(0 <= one <= 0xFFFF for one in values):
            raise ValueError(f"the block at {first} does not hold {list(values)} from {offset} on")
        block[offset : offset + len(values)] = values

    def share_contents(self, table: Table, with_table: Table) -> None:
        """Let reads of `table` find the blocks of `with_table`, too, at the same addresses."""
        for (of, first), block in list(self._blocks.items()):
            if of is with_table:
                self._blocks[table, first] = block


def _addresses_of(point: Point) -> Iterable[int]:
    return (at for first in point.addresses for at in range(first, first + point.words))
