"""Finds the points (named values of devices) that have changed since they were last seen."""

# Memory: the last value of at most MAX_POINTS points. Beyond that, the point that has not changed
# for the longest time is forgotten; it counts as changed when it is seen again.

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mbtool.logs.messages import PointMessage

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

MAX_POINTS = 65536


class PointChanges:
    """Finds changed points (named values) in transactions.

    A point's first value counts as a change.
    """

    def __init__(self, limit: int = MAX_POINTS) -> None:
        self._limit = limit
        self._last: dict[tuple[str, int, str | None, str], tuple[float | None, str]] = {}

    def changes(self, transaction: NamedTransaction, ts_ns: int) -> Iterator[PointMessage]:
        """Yield the points of a transaction whose value differs from the one seen before.

        A transaction that the slave did not carry out, such as a refused write, yields none.
        `ts_ns`, UTC ns, becomes the time of the yielded points.
        """
        if not transaction.points or not transaction.took_effect:
            return
        link, unit, device = transaction.link, transaction.unit, transaction.device
        for point in transaction.points:
            key = (link, unit, device, point.name)
            seen = (point.value, point.text)
            if self._last.get(key) == seen:
                continue
            self._last.pop(key, None)
            if len(self._last) >= self._limit:
                del self._last[next(iter(self._last))]
            self._last[key] = seen
            yield PointMessage(
                ts_ns=ts_ns,
                link=link,
                unit_id=unit,
                device=device,
                name=point.name,
                reference=point.reference,
                value=point.value,
                text=point.text,
                unit=point.unit,
            )


# The code below names a topic for each point (named value) of a device: `/points/LINK/unit_5/NAME`.
#
# With such topics a viewer such as Foxglove lists points by name. Foxglove's message paths take
# letters, digits, `_` and `-` without quotes; any other character becomes `_`. If two points would
# get the same topic name, a number is appended to that of the later one.
#
# Memory: at most MAX_POINT_TOPICS names. Points beyond them have no topic of their own.

MAX_POINT_TOPICS = 10_000
_OTHERS = re.compile(r"[^A-Za-z0-9_-]+")


class PointTopics:
    """Gives each point a topic name that no other point of the log has."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, int, str], str] = {}
        self._taken: set[str] = set()

    def name_of(self, point: PointMessage) -> str | None:
        """Return the name of a point's topic, always the same for the same point.

        Returns None if the point has no topic yet and MAX_POINT_TOPICS other points have one.
        """
        key = point.link, point.unit_id, point.name
        name = self._names.get(key)
        if name is None and len(self._names) < MAX_POINT_TOPICS:
            name = self._names[key] = self._free_name(point)
            self._taken.add(name)
        return name

    def _free_name(self, point: PointMessage) -> str:
        link, last = (_OTHERS.sub("_", text) for text in (point.link, point.name))
        name = plain = f"/points/{link}/unit_{point.unit_id}/{last}"
        number = 1
        while name in self._taken:
            number += 1
            name = f"{plain}_{number}"
        return name
