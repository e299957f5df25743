"""Sorts the points (named values) of a response: first those whose values have changed since they
were last read.
"""

# Memory: the texts of about MAX_POINTS points. When there are more, all of them are forgotten; each
# point is then treated as one that is read for the first time.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, PointValue

MAX_POINTS = 100_000


class ChangedPoints:
    """Remembers the last value of each point (a value that the slave's profile names)."""

    def __init__(self) -> None:
        self._texts: dict[tuple[str, int, str, str], str] = {}

    def of(self, transaction: NamedTransaction) -> PointsRead:
        """Return the points of a response, those with changed values first; remember all values.

        A point has changed if its text differs from that of the last reading. A point that is read
        for the first time has not changed, but is worth showing (PointsRead.fresh).
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
        """Points read for the first time, and points whose value did not change, in the response's
        order."""
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
        if fresh:  # Bits of one phrase are shown all or not at all: `all off`, `CH1 CH3 on`.
            fresh += [one for one in kept if not is_number(one)]
        return PointsRead([*changed, *unchanged], fresh, has_unseen=bool(unseen))


class PointsRead(NamedTuple):
    """The points (named values) of one response."""

    every: Sequence[PointValue]
    """All points of the response; those whose values changed since the last reading come first."""
    fresh: Sequence[PointValue]
    """The points worth showing: those that changed, those read for the first time and, if there are
    any of these, all points shown as words, such as `on`. Empty if nothing changed or was new."""
    has_unseen: bool = False
    """True if at least one point of the response is read for the first time."""


_NO_POINTS = PointsRead((), ())


def is_number(point: PointValue) -> bool:
    """True if a point is shown as a number, not as a word such as `on`."""
    return point.text.lstrip("-")[:1].isdigit()
