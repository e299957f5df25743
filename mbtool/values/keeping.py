"""Adds found places of numbers as points to a profile, and writes them into the profile's text."""

# In the text of a profile, a block begins with a line such as [[points]], or with a comment
# directly above it, and ends before the next block. The tables of a point, such as [points.texts],
# are in its block. If an old point has one of the registers of a new point, its block is removed,
# except comments between empty lines. Everything else stays unchanged.

from __future__ import annotations

import io
import re
import tomllib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.devices.dumping import dump_point
from mbtool.devices.model import Point, Profile
from mbtool.devices.point_types import ByteOrder, WordOrder

if TYPE_CHECKING:
    from mbtool.values.finding import FoundPlace, Wanted

_HEADER = re.compile(r"\s*\[(?!\[?\s*points\s*\.).*\]\s*(?:#.*)?")
"""A line with which a block begins, and no table of a point."""


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
    kept = [
        _lone_comments(block) if _point_name(block) in gone else block for block in _blocks(text)
    ]
    rest = replace(profile, points=[point for point, _ in known])
    new = [dump_point(rest, point, [comment]) for point, comment in known]
    return "\n\n".join(["".join(kept).rstrip("\n"), *new]) + "\n"


def _blocks(text: str) -> list[str]:
    """Cut the text of a profile into its blocks; the first one is what is before them."""
    blocks: list[list[str]] = [[]]
    for line in io.StringIO(text):
        if _HEADER.fullmatch(line.rstrip("\n")):
            begin = len(blocks[-1])
            while begin and blocks[-1][begin - 1].startswith("#"):
                begin -= 1
            blocks[-1], comment = blocks[-1][:begin], blocks[-1][begin:]
            blocks.append(comment)
        blocks[-1].append(line)
    return ["".join(block) for block in blocks]


def _lone_comments(block: str) -> str:
    """The comments of a block that stand alone between empty lines."""
    paragraphs = block.split("\n\n")[1:]
    return "".join(
        f"{one.strip()}\n\n"
        for one in paragraphs
        if one.strip() and all(line.startswith("#") for line in one.strip().splitlines())
    )


def _point_name(block: str) -> str | None:
    if "[[points]]" not in block:
        return None
    try:
        points = tomllib.loads(block).get("points", [])
    except tomllib.TOMLDecodeError:
        return None
    name = points[0].get("name") if len(points) == 1 else None
    return name if isinstance(name, str) else None
