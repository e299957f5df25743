"""Makes a table of polled values for spreadsheets: a row for each round, a column for each."""

# The first response to each request decides its columns. If a request is not answered in a round,
# its cells are empty. Rows are held back until every request has had a response, at most MAX_HELD
# rows; after that, requests without a response get no columns. Until the first response of all, no
# row can be written, and the oldest rows are dropped.

from __future__ import annotations

import csv
import io
from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from mbtool.core.moments import clock_time, day

if TYPE_CHECKING:
    from mbtool.devices import PointValue

MAX_HELD = 10


class PolledValues:
    """Writes the lines of the table; `requests` are the polled PDUs, in their order."""

    def __init__(self, requests: Sequence[bytes]) -> None:
        self._requests = list(dict.fromkeys(requests))
        self._columns: dict[bytes, list[str]] = {}
        self._held: deque[tuple[int, Mapping[bytes, Sequence[PointValue]]]] = deque(maxlen=MAX_HELD)
        self._is_begun = False

    def lines(self, at_ns: int, values: Mapping[bytes, Sequence[PointValue]]) -> str:
        """Return the lines to write after a round that began at `at_ns` (UTC).

        `values` has the points of each request that was answered.
        """
        for pdu, points in values.items():
            if pdu not in self._columns:
                self._columns[pdu] = [_heading(point) for point in points]
        self._held.append((at_ns, values))
        if self._is_begun or len(self._columns) == len(self._requests):
            return self.take_held_lines()
        return self.take_held_lines() if len(self._held) >= MAX_HELD else ""

    def take_held_lines(self) -> str:
        """Return the lines that are held back."""
        if not self._held or (not self._is_begun and not self._columns):
            return ""
        rows: list[list[object]] = []
        asked = [pdu for pdu in self._requests if pdu in self._columns]
        if not self._is_begun:
            rows.append(["time", *(name for pdu in asked for name in self._columns[pdu])])
            self._requests = asked
            self._is_begun = True
        for at_ns, values in self._held:
            row: list[object] = [f"{day(at_ns)} {clock_time(at_ns)}"]
            for pdu in asked:
                points, width = values.get(pdu, ()), len(self._columns[pdu])
                cells = [one.text if one.value is None else one.value for one in points]
                row += [*cells, *[""] * width][:width]
            rows.append(row)
        self._held.clear()
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows(rows)
        return stream.getvalue()


def _heading(point: PointValue) -> str:
    return f"{point.name} ({point.unit})" if point.unit else point.name
