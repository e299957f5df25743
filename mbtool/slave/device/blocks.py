"""Registers that a device gives out in blocks: a read must begin at the block's first address."""

# A profile's point says so with `block`. The registers of a block are apart from the table: a read
# that begins at the block's first address gives the block's registers; a read that begins at one
# of the addresses behind it gives the table's. devices/block_reads.py says which reads are allowed.
#
# Size: a block ends with its last point, so it has at most 65536 registers.

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.devices.model import Point, Profile


class Blocks:
    """The blocks of one device, by table and first address."""

    def __init__(self) -> None:
        self._blocks: dict[tuple[Table, int], list[int]] = {}

    @classmethod
    def of(cls, profile: Profile) -> Self:
        """The blocks of a device, full of zeros."""
        blocks = cls()
        for table in Table:
            points = [point for point in profile.points if point.table is table]
            for point in points:
                if point.block is None:
                    continue
                first = point.block
                held = blocks._blocks.setdefault((table, first), [])
                held += [0] * (max(_held(point)) + 1 - first - len(held))
        return blocks

    def get(self, table: Table, span: range) -> list[int] | None:
        """Return the registers that a read of `span` gets from a block.

        Returns None if the read does not begin at the first address of a block.
        """
        block = self._blocks.get((table, span.start)) if self._blocks else None
        return None if block is None else block[: len(span)]

    def set(self, table: Table, first: int, offset: int, values: Sequence[int]) -> None:
        """Write registers of the block at `first`, from its register `offset` (0-based) on.

        Raises ValueError if they extend beyond the block's end, or if a value is not 0..65535.
        """
        block = self._blocks[table, first]
        if offset + len(values) > len(block) or not all(0 <= one <= 0xFFFF for one in values):
            raise ValueError(f"the block at {first} does not hold {list(values)} from {offset} on")
        block[offset : offset + len(values)] = values

    def share(self, table: Table, with_table: Table) -> None:
        """Give `table` the blocks of `with_table`: from now on both tables share them."""
        for (of, first), block in list(self._blocks.items()):
            if of is with_table:
                self._blocks[table, first] = block


def _held(point: Point) -> Iterable[int]:
    return (at for first in point.addresses for at in range(first, first + point.words))
