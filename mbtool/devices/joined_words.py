"""Words of values that follow from two registers: a unit that another register chooses, and an
address in two registers.
"""

# Both are keys of points in a profile:
#
#     units_from, units   FA3-AT1M8X: 5000 in 010CH is ms if the averaging process of CH6 (0106H) is
#                         the time average, and a number of times if it is the count average
#     after               FA3: 00F1H and 00F0H together are the IP address 192.168.3.250
#
# The register that chooses a unit may have been read or written in an earlier transaction.
#
# Memory: one number for each channel of the MAX_SLAVES slaves that were used last.

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.devices.named_transaction import PointValue
from mbtool.devices.point_types import PointType
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.model import Point, Profile
    from mbtool.modbus.transaction import Transaction

MAX_SLAVES = 1024

_Slave = tuple[str, str | None, int]


class JoinedWords:
    """Finds the words of such values of the slaves with one profile."""

    def __init__(self, profile: Profile) -> None:
        self._fields = {
            point.name: point for point in profile.points if point.type is PointType.NIBBLE_FIELD
        }
        self._units: dict[str, tuple[int, str, dict[int, str]]] = {}
        """By name of a point: its channel, the beginning of the names of the fields that choose the
        unit, and the units by the number of the channel in that field."""
        self._after = {point.name: point.after for point in profile.points if point.after}
        for point in profile.points:
            if point.units_from is not None:
                for number in range(point.count):
                    channel = point.counted_from + number
                    name = point.name.replace("{n}", str(channel))
                    self._units[name] = channel, point.units_from, point.units
        self._slaves: dict[_Slave, dict[tuple[str, int], int]] = {}

    @classmethod
    def of(cls, profile: Profile) -> JoinedWords | None:
        """Return the words of a profile; None if it has no such points."""
        joined = cls(profile)
        return joined if joined._units or joined._after else None

    def words(self, transaction: Transaction, points: list[PointValue]) -> list[PointValue]:
        """Return the points of a transaction, with the words that follow from two registers."""
        chosen = self._chosen(transaction, points)
        shown = [self._with_unit(point, chosen) for point in points]
        return self._joined(shown) if self._after else shown

    def _chosen(
        self, transaction: Transaction, points: Sequence[PointValue]
    ) -> dict[tuple[str, int], int]:
        """By field and channel, the numbers that the slave holds, or that this request writes."""
        key = transaction.link, transaction.destination, transaction.unit
        known = self._slaves.pop(key, {})
        while len(self._slaves) >= MAX_SLAVES:
            del self._slaves[next(iter(self._slaves))]
        seen = {
            (name, channel): number
            for point in points
            if (field := self._fields.get(point.name)) is not None and point.value is not None
            for name in {one for _, one, _ in self._units.values()}
            if point.name.startswith(name)
            for channel, number in _channels(field, int(point.value))
        }
        after = {**known, **seen}
        is_held = transaction.outcome in (Outcome.OK, Outcome.LATE)
        self._slaves[key] = after if is_held else known
        return after

    def _with_unit(self, point: PointValue, chosen: dict[tuple[str, int], int]) -> PointValue:
        if point.name not in self._units:
            return point
        channel, field, units = self._units[point.name]
        unit = units.get(chosen.get((field, channel), -1))
        if unit is None:
            return point
        return msgspec.structs.replace(point, unit=unit, text=f"{point.value} {unit}")

    def _joined(self, points: list[PointValue]) -> list[PointValue]:
        by_name = {point.name: point for point in points}
        joined = []
        for point in points:
            earlier = by_name.get(self._after.get(point.name) or "")
            if earlier is not None:
                name = point.name.partition(" (")[0]
                reference = f"{point.reference}..{earlier.reference}"
                text = f"{earlier.text}.{point.text}"
                joined.append(PointValue(name=name, reference=reference, text=text))
            elif not any(
                first == point.name and last in by_name for last, first in self._after.items()
            ):
                joined.append(point)
        return joined


def _channels(field: Point, word: int) -> list[tuple[int, int]]:
    """The channels of a nibble field, each with its number."""
    return [
        (field.first_channel + index, word >> 4 * index & 0xF)
        for index in range(field.channels or 4)
    ]
