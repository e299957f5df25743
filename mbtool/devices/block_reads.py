"""Decides if a master may read a range of addresses from a device that has blocks of registers."""

# A device returns the registers of a block only to a read that begins at the block's first address
# and does not extend beyond its last one. To a read that begins at another address, the device
# returns the registers outside all blocks, which may have the same addresses. In a profile, each
# point of a block has the key `block`, the block's first address. If an area of another table has
# the same notation, the block is in that table, too: WAGO's 0x2020 is the same for functions 03
# and 04.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.devices.model import Point, Profile
    from mbtool.modbus.tables import Table


def can_be_read(profile: Profile, table: Table, span: range) -> bool:
    """True if a master may read the addresses `span` with one request."""
    return profile.allows(table, span) and (
        not profile.has_blocks or _respects_blocks(profile, table, span)
    )


def _respects_blocks(profile: Profile, table: Table, span: range) -> bool:
    in_blocks, readable = _touched_points(profile, table, span)
    from_start = [point for point in in_blocks if point.block == span.start]
    if from_start:
        return span.stop <= 1 + max(max(point.all_addresses) for point in from_start)
    # A device returns the registers of a block only to a read from the block's first address on.
    # Any other read returns registers outside all blocks. So each address of the range that belongs
    # to a block must also have a readable point outside all blocks.
    return _addresses(in_blocks, span) <= _addresses(readable, span)


def _touched_points(profile: Profile, table: Table, span: range) -> tuple[list[Point], list[Point]]:
    """Return two lists of points that a range of addresses touches.

    The first has the points in blocks (registers that a device returns only to a read from the
    block's first address on). The second has the readable points outside all blocks.
    """
    touched = [
        point
        for first, last, point in profile.point_spans
        if first < span.stop and last >= span.start and _is_in_table(profile, point, table)
    ]
    in_blocks = [point for point in touched if point.block is not None]
    others = [point for point in touched if point.block is None and point.allows(writing=False)]
    return in_blocks, others


def _addresses(points: list[Point], span: range) -> set[int]:
    return {at for point in points for at in point.all_addresses if at in span}


def _is_in_table(profile: Profile, point: Point, table: Table) -> bool:
    if point.table is table:
        return True
    own, other = profile.area(point.table, point.address), profile.area(table, point.address)
    return own is not None and other is not None and own.notation == other.notation
