"""What must hold between the keys of a profile."""

# loading.py sees to each key alone. Here: areas that end before they begin or overlap, points
# outside every area or on top of one another, texts and limits that fit their type.

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, NoReturn

from mbtool.core.errors import ProfileError, UsageError
from mbtool.core.silence import Silence
from mbtool.devices.model import WORD_BITS, Area, Point, PointType, Profile

if TYPE_CHECKING:
    from mbtool.modbus.tables import Table

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_PLACEHOLDER = re.compile(r"\{(n|reference)\}")


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
    _validate_timing(profile, file)
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


def _validate_timing(profile: Profile, file: str) -> None:
    for key in ("t1_5", "t3_5"):
        text = getattr(profile.timing, key)
        try:
            if text is not None:
                Silence.parse(text)
        except UsageError as error:
            raise ProfileError(file, f"timing.{key}", str(error)) from None


def _validate_points(profile: Profile, file: str) -> None:
    names: set[str] = set()
    taken: dict[tuple[Table, int], str] = {}
    for point in profile.points:
        place = _Place(file, f'points "{point.name}"')
        _validate_point(point, place)
        if point.name in names:
            place.wrong("name", "another point has this name")
        names.add(point.name)
        for address in point.addresses:
            if profile.area(point.table, address, point.type.words) is None:
                place.wrong(
                    "address",
                    f"{point.table} {address} (0x{address:04X}) is outside every area",
                )
            for word in range(address, address + point.type.words):
                other = taken.setdefault((point.table, word), point.name)
                if other != point.name:
                    place.wrong(
                        "address", f'{point.table} {word} (0x{word:04X}) is "{other}" already'
                    )


class _Place:
    """The point that is looked at, for errors."""

    def __init__(self, file: str, key: str) -> None:
        self._file = file
        self._key = key

    def wrong(self, key: str, problem: str) -> NoReturn:
        raise ProfileError(self._file, f"{self._key}.{key}", problem)


def _validate_point(point: Point, place: _Place) -> None:
    if point.table.is_bits != (point.type is PointType.BIT):
        right = "bit" if point.table.is_bits else "a type of registers, for example uint16"
        place.wrong("type", f"{point.type} does not fit {point.table}; {right} would be right")
    if point.count > 1 and point.stride < point.type.words:
        place.wrong("stride", f"{point.stride} is less than the {point.type.words} that each takes")
    if "{" in _PLACEHOLDER.sub("", point.name):
        place.wrong("name", "only {n} and {reference} are filled in")
    if point.count > 1 and _PLACEHOLDER.search(point.name) is None:
        place.wrong("name", f"{point.count} points need {{n}} or {{reference}} in their name")
    if not math.isfinite(point.scale) or point.scale == 0:
        place.wrong("scale", f"{point.scale} scales nothing; 0.1 would be right for tenths")
    _validate_field(point, place)
    _validate_range(point, place)


def _validate_field(point: Point, place: _Place) -> None:
    bits = point.type.channel_bits
    if bits == 0:
        if point.channels is not None:
            place.wrong(
                "channels", f"only bit-field and nibble-field have channels, not {point.type}"
            )
        return
    if point.channels is not None and point.channels * bits > WORD_BITS:
        place.wrong(
            "channels", f"{point.channels} do not fit a register; {WORD_BITS // bits} at most do"
        )
    for value in point.texts:
        if not 0 <= value < 1 << bits:
            place.wrong("texts", f"{value} does not fit the {bits} bit of each channel")


def _validate_range(point: Point, place: _Place) -> None:
    low, high = point.minimum, point.maximum
    if low is not None and high is not None and low > high:
        place.wrong("minimum", f"{low} is more than the maximum, {high}")
    if point.default is None:
        return
    if point.type is PointType.BIT and point.default > 1:
        place.wrong("default", f"{point.default} is no bit; 0 or 1 would be right")
    if (low is not None and point.default < low) or (high is not None and point.default > high):
        place.wrong("default", f"{point.default} is outside {low}..{high}")
