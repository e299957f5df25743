"""Helps all exports of a profile: lists the profile's values one by one, and collects losses.

A loss is something that the profile says, but the other program's format cannot express.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from msgspec.structs import replace

from mbtool.devices.model import Access, Point, Profile
from mbtool.devices.point_types import ByteOrder, WordOrder
from mbtool.devices.references import write_reference
from mbtool.devices.values import PointInstance

_MOST_NAMED = 3
"""A text has at most this many names."""
NOT_SCALED = "as in the register, since another register of the device holds the scale"


@dataclass(frozen=True, slots=True)
class ExportedMap:
    """A profile written in the format of another program."""

    text: str
    lacking: tuple[str, ...] = ()
    """Sentences for the user, each about something that the profile says and `text` cannot
    express."""


@dataclass(frozen=True, slots=True)
class SinglePoint:
    """One value of a profile: a point, or one value of a point that stands for a series."""

    point: Point
    """A copy of the profile's point with the name and address of this one value, and a count of
    1."""
    reference: str
    access: Access

    @property
    def letters(self) -> str:
        """The order of the value's bytes on the wire, as the letters A (highest byte) to D: ABCD is
        big-endian.
        """
        swaps = self.point.byte_order is ByteOrder.LOW_FIRST
        words = ["BA" if swaps else "AB", "DC" if swaps else "CD"]
        if self.point.word_order is WordOrder.LOW_FIRST and self.point.words > 1:
            words.reverse()
        return "".join(words)


class Lacking:
    """Collects losses: facts of a profile that an export cannot express, with the names of the
    points that lose them.
    """

    def __init__(self) -> None:
        self._names: dict[str, list[str]] = {}

    def note(self, what: str, name: str) -> None:
        self._names.setdefault(what, []).append(name)

    @property
    def lines(self) -> tuple[str, ...]:
        return tuple(f"{what}: {_listed(names)}" for what, names in self._names.items())


def single_points(profile: Profile) -> Iterator[SinglePoint]:
    """Yield the values of a profile, sorted by table and address.

    A point that stands for a series gives one value for each address in `Point.addresses`.
    """
    for point in sorted(profile.points, key=lambda one: (one.table, one.address)):
        for address in point.addresses:
            area = profile.area(point.table, address, point.words)
            reference = write_reference(profile, point.table, address, point.words)
            name = PointInstance(point, address, reference).name
            access = Access.READ_WRITE if area is None else area.access
            single = replace(point, name=name, address=address, count=1, stride=1)
            yield SinglePoint(single, reference, point.access or access)


def number_text(number: float) -> str:
    """Write a number, without `.0` if it is whole: 1, 0.1, 2.5e-05."""
    return str(int(number)) if number == int(number) else repr(number)


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"{', '.join(names[:_MOST_NAMED])}{more}"
