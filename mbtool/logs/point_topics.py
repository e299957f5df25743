"""Names a topic for each point (named value) of a device: `/points/LINK/unit_5/NAME`."""

# With such topics a viewer such as Foxglove lists points by name. Foxglove's message paths take
# letters, digits, `_` and `-` without quotes; any other character becomes `_`. If two points would
# get the same topic name, a number is appended to that of the later one.
#
# Memory: at most MAX_POINT_TOPICS names. Points beyond them have no topic of their own.

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.logs.messages import PointMessage

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
