"""The part of a capture that --start and --end name."""

# A time since the beginning counts from the capture's first request, as with `replay`. Transactions
# come when they are complete, so the first one to come need not be the first one to begin. So
# records are held until HOLD_NS of the capture have gone by, or MAX_HELD records have come; a
# request may wait that long for its response. What begins before the first request found so is
# taken for the beginning.

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import UsageError, WireEvent
from mbtool.core.moments import Moment, parse_moment

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.decode.decoder import Record

HOLD_NS = 60_000_000_000
MAX_HELD = 100_000


@dataclass(slots=True)
class TimeWindow:
    """A part of a capture; what begins exactly at its end is not in it."""

    start: Moment | None
    end: Moment | None
    _first_ns: int | None = field(default=None, init=False)

    @classmethod
    def parse(cls, start: str | None, end: str | None) -> TimeWindow:
        """Read --start and --end.

        Raises UsageError for a text that is no moment, and for an end that is not after the start.
        """
        first = None if start is None else parse_moment(start, "--start")
        last = None if end is None else parse_moment(end, "--end")
        alike = first is not None and last is not None and first.is_absolute is last.is_absolute
        if first is not None and last is not None and alike and last.ns <= first.ns:
            raise UsageError(f"--end {end}: is not after --start {start}")
        return cls(first, last)

    @property
    def is_whole(self) -> bool:
        """True if everything is in it."""
        return self.start is None and self.end is None

    def begun(self, records: Iterable[Record], *, at_once: bool = False) -> Iterator[Record]:
        """Give all records, once the first request among them is known.

        With `at_once`, the first transaction that comes counts as the first request, as nobody
        wants to wait for a live capture.
        """
        if not any(one is not None and not one.is_absolute for one in (self.start, self.end)):
            yield from records
            return
        held: list[Record] | None = []
        for record in records:
            if held is None:
                yield record
                continue
            held.append(record)
            now_ns = self._note(record)
            is_known = self._first_ns is not None and now_ns - self._first_ns >= HOLD_NS
            if is_known or at_once or len(held) >= MAX_HELD:
                yield from held
                held = None
        yield from held or ()

    def __contains__(self, record: Record) -> bool:
        """True if a record begins in the window. `begun` has given the record."""
        ts_ns = record.ts_ns if isinstance(record, WireEvent) else record.start_ns
        since_ns = max(ts_ns - (self._first_ns or 0), 0)
        start, end = self.start, self.end
        if start is not None and (ts_ns if start.is_absolute else since_ns) < start.ns:
            return False
        return end is None or (ts_ns if end.is_absolute else since_ns) < end.ns

    def _note(self, record: Record) -> int:
        """Note a record that comes before the first request is known; return its time in ns."""
        if isinstance(record, WireEvent):
            return record.ts_ns
        start_ns = record.start_ns
        if self._first_ns is None or start_ns < self._first_ns:
            self._first_ns = start_ns
        return start_ns
