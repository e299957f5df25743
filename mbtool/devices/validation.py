"""What must hold between the keys of a profile."""

# loading.py sees to each key alone. Here: areas that end before they begin or overlap, points
# outside every area or on top of one another, texts and limits that fit their type.

from __future__ import annotations

import math
import re
from typing import NoReturn

from mbtool.core.errors import ProfileError
from mbtool.devices.model import Area, Point, PointType, Profile
from mbtool.modbus.tables import Table

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def validate(profile: Profile, file: str) -> None:
    """Raise ProfileError for the first thing that cannot be."""
    if _NAME.fullmatch(profile.name) is None:
        raise ProfileError(
            file, "name", f"{profile.name!r}: letters, digits, '-', '_' and '.' make a name"
        )
    if not profile.transports:
        raise ProfileError(file, "transports", "is empty; name rtu, ascii or tcp")
    _validate_areas(profile, file)
    _validate_exceptions(profile, file)
    _validate_points(profile, file)


def _validate_areas(profile: Profile, file: str) -> None:
    before: dict[Table, Area] = {}
    for area in sorted(profile.areas, key=lambda area: area.first):
        key = f'areas "{area.name}"'
        if area.last < area.first:
            raise ProfileError(
                file,
                f"{key}.last",
                f"{area.last} (0x{area.last:04X}) ends before it begins, "
                f"at {area.first} (0x{area.first:04X})",
            )
        other = before.get(area.table)
        if other is not None and area.first <= other.last:
            raise ProfileError(
                file,
                f"{key}.first",
                f'{area.first} (0x{area.first:04X}) lies in area "{other.name}" of the same table, '
                f"which ends at {other.last} (0x{other.last:04X})",
            )
        if area.access == "rw" and not area.table.is_writable:
            raise ProfileError(
                file, f"{key}.access", f"no function writes {area.table}; 'r' would be right"
            )
        before[area.table] = area


def _validate_exceptions(profile: Profile, file: str) -> None:
    codes = profile.exceptions
    for key in ("function", "address", "value"):
        code = getattr(codes, key)
        if code not in codes.documented:
            raise ProfileError(
                file,
                f"exceptions.{key}",
                f"{code} is not among the documented codes "
                f"({', '.join(map(str, codes.documented))})",
            )


def _validate_points(profile: Profile, file: str) -> None:
    names: set[str] = set()
    taken: dict[tuple[Table, int], Point] = {}
    for point in profile.points:
        place = _Place(file, f'points "{point.name}"')
        _validate_point(point, place)
        if point.name in names:
            place.wrong("name", "another point has this name")
        names.add(point.name)
        # The ends are enough to know that a hostile count does not make this loop long.
        for address in (point.addresses[0], point.addresses[-1]):
            if profile.area(point.table, address, point.type.words) is None:
                place.wrong(
                    "address",
                    f"{point.table} {address} (0x{address:04X}) is outside every area of the profile",
                )
        for address in point.addresses:
            if profile.area(point.table, address, point.type.words) is None:
                place.wrong("address", f"{point.table} {address} is outside every area")
            for word in range(address, address + point.type.words):
                other = taken.setdefault((point.table, word), point)
                if other is not point or (word == address and address != _owner(point, word)):
                    place.wrong("address", f'{point.table} {word} has the name "{other.name}" too')


def _owner(point: Point, word: int) -> int:
    return word - (word - point.address) % point.stride


class _Place:
    """The point that is looked at, for errors."""

    def __init__(self, file: str, key: str) -> None:
        self._file = file
        self._key = key

    def wrong(self, key: str, problem: str) -> NoReturn:
        raise ProfileError(self._file, f"{self._key}.{key}", problem)


def _validate_point(point: Point, place: _Place) -> None:
    if point.table.is_bits != (point.type is PointType.BIT):
        place.wrong("type", f"{point.type} does not fit {point.table}")
