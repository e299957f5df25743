"""Collects the values of one register or point over time, in bounded memory."""

# Only changes of the value are stored. If there are more than `limit`, the time is divided into
# equal parts. Only the first, least, greatest and last value of each part are kept, so that no
# extreme is lost.

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, compress, groupby, islice, starmap
from operator import ne
from typing import TYPE_CHECKING

import msgspec

from mbtool.values.judging import WordHistory

if TYPE_CHECKING:
    from mbtool.devices.observed_slave import ObservedSlave

# Word histories: the words of a slave's registers over time, as judging.py takes them.


def histories_of(seen: ObservedSlave) -> list[WordHistory]:
    """Return the histories of a slave's registers; it must have been observed with values."""
    return [
        WordHistory(
            request.table,
            request.span.start,
            list(samples.times_ns),
            list(samples.rows),
            answers=samples.count,
            is_written=request.writes,
        )
        for request, samples in seen.samples.items()
        if request.table is not None
    ]


MAX_CHANGES = 1600
"""The most samples that a series keeps; beyond it, they are thinned out."""
MAX_TEXTS = 32
"""The most different texts (such as `on`) that a series keeps."""


class SeriesSample(msgspec.Struct, frozen=True, gc=False):
    """A value, and the time (UTC ns) at which it was first seen after another value."""

    # There are many samples, and none refers to other objects. gc=False keeps them out of the
    # garbage collector, which would examine each again and again.

    ts_ns: int
    value: float


class ValueSeries:
    """Collects the value of one register or point over time."""

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
        """The unit of measure, such as `bar`; empty if none is known."""
        self.bit = bit
        """True if the values are those of a coil or a discrete input."""
        self.samples: list[SeriesSample] = []
        self.changes = 0
        """The number of changes of the value, including changes whose samples were thinned out."""
        self.texts: dict[float, str] = {}
        """By number: its text in the words of the device's manual, such as `on`; at most MAX_TEXTS
        texts."""
        self.last_text = ""
        self._limit = limit

    def add(self, ts_ns: int, value: float | None, text: str | None = None) -> None:
        """Add a value seen at a time (UTC ns), unless it equals the last one.

        `value` is None if the value is no number, such as a string. `text` is the value in words.
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
            self.samples = thin_samples(self.samples, self._limit // 2)

    def add_all(self, times_ns: Sequence[int], values: Sequence[int]) -> None:
        """Add the values seen at these times (ns), which are in order, with the same result as
        `add` for each.
        """
        last = self.samples[-1].value if self.samples else None
        is_new = map(ne, values, chain((last,), values))
        some = starmap(SeriesSample, compress(zip(times_ns, values, strict=True), is_new))
        while taken := [*islice(some, self._limit + 1 - len(self.samples))]:
            self.changes += len(taken) - (not self.samples)
            self.samples += taken
            if len(self.samples) > self._limit:
                self.samples = thin_samples(self.samples, self._limit // 2)


def thin_samples(samples: list[SeriesSample], most: int) -> list[SeriesSample]:
    """Return at most `most` of the samples (`most` is 4 or more), in order of time.

    The time is divided into equal parts. Each part keeps its first, least, greatest and last value.
    """
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
