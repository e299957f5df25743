"""What a master may read of a device that gives some registers out in blocks only."""

# A block is read from its first address, any part of it from there on; a read that begins elsewhere
# finds none of it, and more than the block has is not there. A profile's points say what is in one
# (`block`). Where they stand in one table and another has an area with the same notation, as WAGO's
# 0x2020 that functions 03 and 04 read alike, the block is in both.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Point, Profile
    from mbtool.modbus.tables import Table


def can_be_read(profile: Profile, table: Table, span: range) -> bool:
    """Whether a range is one that a master may read in one request."""
    return profile.allows(table, span) and _keeps_to_blocks(profile, table, span)


def _keeps_to_blocks(profile: Profile, table: Table, span: range) -> bool:
    within = [point for point in profile.points if point.block is not None]
    if not within:
        return True
    near = [point for point in within if _touches(point, span) and _is_in(profile, point, table)]
    whole = [max(_held(point)) + 1 for point in near if point.block == span.start]
    if whole:
        return span.stop <= max(whole)
    held = {at for point in near for at in _held(point) if at in span}
    if not held:
        return True
    alone = [point for point in profile.points if point.block is None]
    readable = {
        at
        for point in alone
        if point.allows(writing=False) and _touches(point, span) and _is_in(profile, point, table)
        for at in _held(point)
    }
    return held <= readable


def _touches(point: Point, span: range) -> bool:
    last = point.addresses[-1] + point.words - 1
    first = point.address if point.block is None else point.block
    return first < span.stop and last >= span.start


def _is_in(profile: Profile, point: Point, table: Table) -> bool:
    if point.table is table:
        return True
    own, other = profile.area(point.table, point.address), profile.area(table, point.address)
    return own is not None and other is not None and own.notation == other.notation


def _held(point: Point) -> Iterator[int]:
    for address in point.addresses:
        yield from range(address, address + point.words)
