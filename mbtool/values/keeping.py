"""Keeps found places as points of a profile, and writes them into the text of a profile."""

# In the text of a profile, a point is a block: the lines from its comment to the next empty line.
# A block of a point that has some of the same registers as a new one is left out; all else stays as
# it is, with its comments.

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.devices.dumping import dump_point
from mbtool.devices.model import Point
from mbtool.devices.point_types import ByteOrder, WordOrder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.model import Profile
    from mbtool.values.finding import FoundPlace, Wanted


def point_of(wanted: Wanted, place: FoundPlace) -> tuple[Point, str]:
    """Return the point of a found place, and the reason as a comment."""
    is_wide = place.reading.words > 1
    seen = ", ".join(f"{one.value:g}" for one in wanted.sightings[:4])
    percent = min(round(100 * place.likelihood), 99)
    point = Point(
        name=wanted.name or f"{place.table.value.partition('_')[0]} {place.address}",
        table=place.table,
        address=place.address,
        type=place.reading.type,
        word_order=place.reading.order.words if is_wide else WordOrder.HIGH_FIRST,
        byte_order=place.reading.order.bytes if is_wide else ByteOrder.HIGH_FIRST,
        scale=place.scale,
        unit=wanted.unit or None,
    )
    return point, f"Found by what a display showed, {percent} % likely: {seen}."


def with_points(text: str, profile: Profile, known: Sequence[tuple[Point, str]]) -> str:
    """Return the text of a profile with some points more, in place of those at their registers.

    `profile` is the profile that the text is of.
    """
    taken = {(point.table, at) for point, _ in known for at in point.all_addresses}
    names = {point.name for point, _ in known}
    gone = {
        point.name
        for point in profile.points
        if point.name in names or any((point.table, at) in taken for at in point.all_addresses)
    }
    blocks = [block for block in text.rstrip("\n").split("\n\n") if _point_name(block) not in gone]
    rest = replace(profile, points=[point for point, _ in known])
    blocks += [dump_point(rest, point, [comment]) for point, comment in known]
    return "\n\n".join(blocks) + "\n"


def _point_name(block: str) -> str | None:
    if "[[points]]" not in block:
        return None
    try:
        points = tomllib.loads(block).get("points", [])
    except tomllib.TOMLDecodeError:
        return None
    name = points[0].get("name") if len(points) == 1 else None
    return name if isinstance(name, str) else None
