"""Sorts points: those whose values changed since the last reading come first."""

# Memory: the texts of at most MAX_POINTS points. When there are more, all are forgotten; the next
# value of each point then counts as unchanged.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import NamedTransaction, PointValue

MAX_POINTS = 100_000


class ChangedPoints:
    """Remembers the last value of each point that was read."""

    def __init__(self) -> None:
        self._texts: dict[tuple[str, int, str, str], str] = {}

    def changed_first(self, transaction: NamedTransaction) -> Sequence[PointValue]:
        """The points in a response; those whose values changed come first.

        A point that was not read before counts as unchanged.
        """
        points = transaction.read_points
        if not points:
            return points
        if len(self._texts) > MAX_POINTS:
            self._texts.clear()
        changed: list[PointValue] = []
        unchanged: list[PointValue] = []
        for point in points:
            key = transaction.link, transaction.unit, point.reference, point.name
            is_changed = self._texts.get(key, point.text) != point.text
            (changed if is_changed else unchanged).append(point)
            self._texts[key] = point.text
        return [*changed, *unchanged]
