"""Knows which logs hold evidence that was not decoded when they were made."""

# Logs that were not closed may lack the records of their last moments, too: those of up to
# MAX_LOOKED_THROUGH bytes together are decoded again if their evidence goes on behind the records.
#
# Such a log, and one of evidence only, is decoded from its beginning, as what a packet or a byte
# means depends on what came before it. Its records are left out, but not the events that its
# evidence cannot give: what drivers, taps and interfaces told.

from __future__ import annotations

import os
from collections import deque
from functools import cached_property
from typing import TYPE_CHECKING

from mbtool.core import EventKind, InputError, WireEvent
from mbtool.core.wording import counted
from mbtool.logs.links import SPEC
from mbtool.logs.undecoded import (
    MAX_LOOKED_THROUGH,
    UNDECODED_PIECES,
    ends_undecoded,
    undecoded_pieces,
)
from mbtool.sources.files import place_of
from mbtool.views.cells import clock_time, day

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence, Set

    from mbtool.core import Chunk, Packet
    from mbtool.logs import LogReader

_OF_SOURCES = frozenset(
    {EventKind.LINE_ERROR, EventKind.REFUSED, EventKind.BLOCKED, EventKind.CLOCK_STEP}
)
_OF_TAPS = frozenset({EventKind.OPENED, EventKind.CLOSED})
"""Only a tap tells that a connection was opened or closed; packets show it."""

_HELD_NS = 2_000_000_000
"""Evidence is held back for so many ns of its time, as an event may belong before it."""
_MOST_HELD = 5000

_LOSSES_OF_SOURCES = ("not recorded", "turned away")


class LogRemarks:
    """Tells which logs among some files are not decoded to their end, or were not closed."""

    def __init__(self, paths: Sequence[str], *, is_raw: bool) -> None:
        """`is_raw` is True if the user wants all logs to be decoded again."""
        self._paths = paths
        self._is_raw = is_raw
        self._unread: dict[str, int] = {}
        """The number of undecoded chunks and packets of logs that can be read only once: pipes and
        compressed files."""
        self._unclosed: list[str] = []

    @property
    def are_undecoded(self) -> bool:
        """True if all logs among the files are to be decoded again."""
        return bool(self._counts) or any(self._ends.values())

    def note(self, log: LogReader, name: str) -> None:
        """Take a log that has been read to its end."""
        text = log.capture.get(UNDECODED_PIECES, "0")
        if not self._counts and text.isdecimal() and len(text) <= 9 and int(text):
            self._unread[name] = int(text)
        if not log.closed:
            end = f"ends at {day(log.end_ns)} {clock_time(log.end_ns)} UTC"
            more = "" if log.is_evidence_only else self._last_moments(name)
            end = end + more if log.end_ns else "holds nothing"
            self._unclosed.append(f"{name}: was not closed; it {end}")

    def _last_moments(self, name: str) -> str:
        """What the user is told of the last moments of a log that was not closed."""
        if self._is_raw or self._counts:
            return ""
        if self.are_undecoded:
            return "; it is decoded again, for its last moments"
        return "" if name in self._ends else "; --raw also decodes its last moments"

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about these logs."""
        told = ((self._counts, "it is decoded again"), (self._unread, "--raw decodes it again"))
        return self._unclosed + [
            f"{path}: {counted(count, 'piece')} not decoded when it was made; {then}"
            for counts, then in told
            for path, count in counts.items()
        ]

    @cached_property
    def _counts(self) -> Mapping[str, int]:
        """The number of undecoded chunks and packets, by path."""
        counts = {path: undecoded_pieces(path) for path in self._files}
        return {path: count for path, count in counts.items() if count}

    @cached_property
    def _ends(self) -> Mapping[str, bool]:
        """For each log that was looked through: True if its end is not decoded.

        Empty if the files are large together, as all of them would be decoded again.
        """
        try:
            if sum(map(os.path.getsize, self._files)) > MAX_LOOKED_THROUGH:
                return {}
        except OSError:  # Reading the file will raise the error.
            return {}
        ends = {path: ends_undecoded(path) for path in self._files}
        return {path: is_so for path, is_so in ends.items() if is_so is not None}

    @property
    def _files(self) -> list[str]:
        """The paths that are no pipes."""
        return [path for path in self._paths if not place_of(path)[1]]


def heard(log: LogReader) -> Iterator[Chunk | Packet | WireEvent]:
    """The evidence of a log, and the events that its evidence cannot give, each at its time."""
    taps = {name for name, one in log.links.items() if one.get(SPEC, "").startswith("tap:")}
    return _in_place(
        item for item in log.heard() if not isinstance(item, WireEvent) or is_of_source(item, taps)
    )


def _in_place(items: Iterator[Chunk | Packet | WireEvent]) -> Iterator[Chunk | Packet | WireEvent]:
    """Put each event before the evidence of its link that is later than it.

    An event is written when it has passed the decoder, so often behind later evidence. A loss ends
    the frames of its line, and must not do so in the middle of a later one.
    """
    held: deque[Chunk | Packet | WireEvent] = deque()
    try:
        for item in items:
            at = len(held)
            if isinstance(item, WireEvent):
                later = (
                    number
                    for number, one in enumerate(held)
                    if one.ts_ns > item.ts_ns and item.link in ("", one.link)
                )
                at = next(later, at)
            held.insert(at, item)
            while len(held) > _MOST_HELD or held[0].ts_ns < item.ts_ns - _HELD_NS:
                yield held.popleft()
    except InputError:  # The log is cut off: what came before is whole.
        yield from held
        raise
    yield from held


def is_of_source(event: WireEvent, taps: Set[str]) -> bool:
    """True for an event of a driver, a tap or an interface, which the evidence does not show.

    `taps` are the names of the links that are taps.
    """
    if event.kind in _OF_TAPS:
        return event.link in taps
    if event.kind is EventKind.DISCARDED:
        # The decoder tells what it gave up itself, and will again.
        return bool(event.packets) or any(text in event.message for text in _LOSSES_OF_SOURCES)
    if event.kind is EventKind.GAP:
        # A damaged place of the log, or a port that was unplugged. Of packets, decoding tells gaps.
        return not event.source
    return event.kind in _OF_SOURCES
