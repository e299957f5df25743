"""Sorts points: those whose values changed since the last reading come first."""

# Memory: the texts of at most MAX_POINTS points. When there are more, all are forgotten; the next
# value of each point then counts as unchanged.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import NamedTransaction, PointValue

MAX_POINTS = 100_000


class ChangedPoints:
    """Remembers the last value of each point that was read."""

    def __init__(self) -> None:
        self._texts: dict[tuple[str, int, str, str], str] = {}

    def of(self, transaction: NamedTransaction) -> PointsRead:
        """The points in a response, sorted and remembered.

        A point that was not read before counts as unchanged, but not as seen before.
        """
        points = transaction.read_points
        if not points:
            return _NO_POINTS
        if len(self._texts) > MAX_POINTS:
            self._texts.clear()
        changed: list[PointValue] = []
        unseen: list[PointValue] = []
        kept: list[PointValue] = []
        unchanged: list[PointValue] = []
        """Those unseen and kept, in the order of the response."""
        for point in points:
            key = transaction.link, transaction.unit, point.reference, point.name
            last = self._texts.get(key)
            self._texts[key] = point.text
            if last is not None and last != point.text:
                changed.append(point)
                continue
            unchanged.append(point)
            (unseen if last is None else kept).append(point)
        fresh = [*changed, *unseen]
        if fresh:  # Bits of one phrase stand or fall together: `all off`, `CH1 CH3 on`.
            fresh += [one for one in kept if not is_number(one)]
        return PointsRead([*changed, *unchanged], fresh, has_unseen=bool(unseen))


class PointsRead(NamedTuple):
    """The points in a response."""

    every: Sequence[PointValue]
    """All of them; those whose values changed since the last reading come first."""
    fresh: Sequence[PointValue]
    """Without numbers that are as they were in the last reading; empty if no point changed."""
    has_unseen: bool = False
    """True if a point was not read before."""


_NO_POINTS = PointsRead((), ())


def is_number(point: PointValue) -> bool:
    """True if a point is shown as a number, not as a word such as `on`."""
    return point.text.lstrip("-")[:1].isdigit()
