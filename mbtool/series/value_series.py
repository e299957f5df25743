"""The values of one register or point over time, thinned out so that no extreme is lost."""

# Only changes are kept: between two of them the value stays. If there are more than `limit`, the
# time is cut into pieces, and of each piece the first, least, greatest and last value stay.

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

MAX_CHANGES = 1600
MAX_TEXTS = 32


class SeriesSample(NamedTuple):
    """A value, and the time (UTC ns) from which on it was seen."""

    ts_ns: int
    value: float


class ValueSeries:
    """One value over time."""

    __slots__ = (
        "_limit", "bit", "changes", "last_text", "name", "reference", "samples", "texts", "unit",
    )  # fmt: skip

    def __init__(
        self,
        name: str,
        reference: str = "",
        unit: str = "",
        *,
        bit: bool = False,
        limit: int = MAX_CHANGES,
    ) -> None:
        self.name = name
        self.reference = reference
        self.unit = unit
        """The unit of measure."""
        self.bit = bit
        """True for a coil or a discrete input."""
        self.samples: list[SeriesSample] = []
        self.changes = 0
        """The number of changes, also of those that were thinned out."""
        self.texts: dict[float, str] = {}
        """What the manual says of a value; of at most MAX_TEXTS values."""
        self.last_text = ""
        self._limit = limit

    def add(self, ts_ns: int, value: float | None, text: str | None = None) -> None:
        """Take what was seen at a time; nothing happens if it is the value that was seen last.

        `value` is None for what is no number, such as a string.
        """
        if text is not None:
            self.changes += value is None and bool(self.last_text) and text != self.last_text
            self.last_text = text
        if value is None or (self.samples and self.samples[-1].value == value):
            return
        self.changes += bool(self.samples)
        self.samples.append(SeriesSample(ts_ns, value))
        if text is not None and len(self.texts) < MAX_TEXTS:
            self.texts.setdefault(value, text)
        if len(self.samples) > self._limit:
            self.samples = thinned(self.samples, self._limit // 2)


def thinned(samples: list[SeriesSample], most: int) -> list[SeriesSample]:
    """At most `most` (at least 4) of the samples, in order of time, with all extremes."""
    in_order = sorted(samples, key=lambda one: one.ts_ns)
    if len(in_order) <= most:
        return in_order
    begin_ns = in_order[0].ts_ns
    pieces = max(most // 4, 1)
    width_ns = max((in_order[-1].ts_ns - begin_ns) // pieces + 1, 1)
    kept = []
    for _, piece in groupby(in_order, lambda one: (one.ts_ns - begin_ns) // width_ns):
        some = list(piece)
        places = {0, len(some) - 1}
        values = [one.value for one in some]
        places |= {values.index(min(values)), values.index(max(values))}
        kept += [some[place] for place in sorted(places)]
    return kept
