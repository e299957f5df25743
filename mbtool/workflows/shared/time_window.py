"""Selects the part of a capture between the options --start and --end."""

# A relative time (`--start 10s`) counts from the capture's first request, as with `replay`. A
# transaction is decoded when it is complete, so the first decoded transaction is not always the one
# that began first. So records are held back until HOLD_NS of the capture have passed (a request may
# wait that long for its response), or until MAX_HELD records are held. The earliest request among
# these counts as the first. A record that began before it counts as being at relative time 0.

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import UsageError, WireEvent
from mbtool.core.moments import TimePoint, clock_time, day, parse_moment

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record

HOLD_NS = 60_000_000_000
MAX_HELD = 100_000


@dataclass(slots=True)
class TimeWindow:
    """The part of a capture from `start` to `end`. None means the capture's own beginning or end.

    A record that begins exactly at `end` is outside.
    """

    start: TimePoint | None
    end: TimePoint | None
    _first_ns: int | None = field(default=None, init=False)
    _times: tuple[int, int] | None = field(default=None, init=False)
    """The begin times (UTC ns) of the earliest and the latest transaction that was tested with
    `in`; None before the first."""
    _has_any: bool = field(default=False, init=False)
    """True if at least one transaction that was tested with `in` is in the window."""

    @classmethod
    def parse(cls, start: str | None, end: str | None) -> TimeWindow:
        """Make a window from the values of --start and --end; None for an option that is not given.

        Raises UsageError for a text that is no time, and for an end that is not after the start.
        """
        first = None if start is None else parse_moment(start, "--start")
        last = None if end is None else parse_moment(end, "--end")
        alike = first is not None and last is not None and first.is_absolute is last.is_absolute
        if first is not None and last is not None and alike and last.ns <= first.ns:
            raise UsageError(f"--end {end}: is not after --start {start}")
        return cls(first, last)

    @property
    def is_whole(self) -> bool:
        """True if the window is the whole capture, as neither --start nor --end is given."""
        return self.start is None and self.end is None

    @property
    def is_relative(self) -> bool:
        """True if the window's beginning or end counts from the capture's first request."""
        return any(one is not None and not one.is_absolute for one in (self.start, self.end))

    def begun(self, records: Iterable[Record], *, at_once: bool = False) -> Iterator[Record]:
        """Yield all records. If --start or --end count from the capture's first request, records
        are held back until that request is known.

        With `at_once`, for live captures, no record is held back: the first decoded transaction
        counts as the first request.
        """
        if not self.is_relative:
            return iter(records)
        return self._held_back(records, at_once)

    def _held_back(self, records: Iterable[Record], at_once: bool) -> Iterator[Record]:
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
        """True if a record begins in the window. Call it only for a record that `begun` has
        yielded.
        """
        if isinstance(record, WireEvent):
            return self.contains_ns(record.ts_ns)
        start_ns = record.start_ns
        earliest, latest = self._times or (start_ns, start_ns)
        self._times = min(earliest, start_ns), max(latest, start_ns)
        is_in = self.contains_ns(start_ns)
        self._has_any |= is_in
        return is_in

    @property
    def why_empty(self) -> str | None:
        """A message for the user if all transactions that were tested with `in` are outside the
        window; None if one is inside, or if none was tested.
        """
        if self._has_any or self._times is None:
            return None
        place = "after --start" if self.end is None else "before --end"
        if self.start is not None and self.end is not None:
            place = "between --start and --end"
        first, last = (f"{day(ns)} {clock_time(ns)}" for ns in self._times)
        return f"no transaction {place}: the first is of {first}, the last of {last} UTC"

    def contains_ns(self, ts_ns: int) -> bool:
        """True if the time `ts_ns` (UTC ns) is in the window. Call it only after `begun` has
        yielded a record.
        """
        return not self._is_before(ts_ns, self.start) and (
            self.end is None or self._is_before(ts_ns, self.end)
        )

    def is_before_ns(self, ts_ns: int) -> bool:
        """True if the time `ts_ns` (UTC ns) is before the window. Call it only after `begun` has
        yielded a record.
        """
        return self._is_before(ts_ns, self.start)

    def _is_before(self, ts_ns: int, point: TimePoint | None) -> bool:
        if point is None:
            return False
        since_ns = max(ts_ns - (self._first_ns or 0), 0)
        return (ts_ns if point.is_absolute else since_ns) < point.ns

    def _note(self, record: Record) -> int:
        """Remember the begin of a record that is held back, if it is the earliest transaction so
        far.

        Returns the time at which the record begins, in UTC ns.
        """
        if isinstance(record, WireEvent):
            return record.ts_ns
        start_ns = record.start_ns
        if self._first_ns is None or start_ns < self._first_ns:
            self._first_ns = start_ns
        return start_ns
