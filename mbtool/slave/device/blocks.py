"""Registers that can only be read as a block, from the block's first address on."""

# A block is a group of registers that exists beside the table of the same addresses: points with
# the key `block` in the profile. A read that begins at a block's first address returns the block's
# registers; a read that begins at a later address returns the table's. devices/block_reads.py says
# which reads are allowed.
#
# Memory: a block ends with its last point, so it has at most 65536 registers.

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.devices.model import Point, Profile


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
                held += [0] * (max(_held(point)) + 1 - first - len(held))
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

    def share(self, table: Table, with_table: Table) -> None:
        """Let reads of `table` find the blocks of `with_table`, too, at the same addresses."""
        for (of, first), block in list(self._blocks.items()):
            if of is with_table:
                self._blocks[table, first] = block


def _held(point: Point) -> Iterable[int]:
    return (at for first in point.addresses for at in range(first, first + point.words))
