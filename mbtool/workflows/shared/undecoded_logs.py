"""Finds logs with packets or bytes that were not decoded while the log was recorded."""

# A log has evidence (the packets and bytes as they were heard) and records (transactions and events
# that were decoded from it). If recording was killed, the records of the last moments may be
# missing. So a log that was not closed is decoded again if its evidence goes on behind its last
# record. That is only checked if the files together have at most MAX_LOOKED_THROUGH bytes.
#
# A log with undecoded evidence is decoded from its beginning, as the meaning of a packet or byte
# depends on what came before it. Then its records are ignored, except for events that cannot be
# decoded from evidence: those that drivers, taps and interfaces reported.

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import cached_property
from typing import TYPE_CHECKING

from mbtool.core import Chunk, EventKind, InputError, Packet, WireEvent
from mbtool.core.moments import clock_time, counted, day
from mbtool.logs.links import SPEC
from mbtool.logs.undecoded import (
    MAX_LOOKED_THROUGH,
    UNDECODED_PIECES,
    ends_undecoded,
    undecoded_pieces,
)
from mbtool.sources.files import place_of

if TYPE_CHECKING:
    from mbtool.logs import LogReader

_OF_SOURCES = frozenset(
    {EventKind.LINE_ERROR, EventKind.REFUSED, EventKind.BLOCKED, EventKind.CLOCK_STEP}
)
_OF_TAPS = frozenset({EventKind.OPENED, EventKind.CLOSED})
"""Kinds of events that are kept only for taps. For captured packets, decoding finds such events
again."""

_HELD_NS = 2_000_000_000
"""Items of a log are held back until an item comes that is later by this much (ns). Events with
earlier times may stand behind them in the log."""
_MOST_HELD = 5000

_LOSSES_OF_SOURCES = ("not recorded", "turned away")


class LogRemarks:
    """Finds the logs among the files that have undecoded evidence, or that were not closed, and
    makes remarks about them.
    """

    def __init__(self, paths: Sequence[str], *, is_raw: bool) -> None:
        """Prepare to look at the files. `is_raw` is True if the user wants all logs to be decoded
        again in any case.
        """
        self._paths = paths
        self._is_raw = is_raw
        self._unread: dict[str, int] = {}
        """The number of undecoded chunks and packets in each pipe or compressed log, by file name.
        For these files it is known only after reading."""
        self._unclosed: list[str] = []

    @property
    def are_undecoded(self) -> bool:
        """True if at least one log has undecoded evidence. Then all logs are decoded again."""
        return bool(self._counts) or any(self._undecoded_ends.values())

    def note(self, log: LogReader, name: str) -> None:
        """Keep remarks for the user about the log with this name, which has been read to
        its end.
        """
        text = log.capture.get(UNDECODED_PIECES, "0")
        if not self._counts and text.isdecimal() and len(text) <= 9 and int(text):
            self._unread[name] = int(text)
        if not log.closed:
            end = f"ends at {day(log.end_ns)} {clock_time(log.end_ns)} UTC"
            more = "" if log.is_evidence_only else self._last_moments(name)
            end = end + more if log.end_ns else "holds nothing"
            self._unclosed.append(f"{name}: was not closed; it {end}")

    def _last_moments(self, name: str) -> str:
        """The part of a remark that says how the last moments of a log that was not closed get
        decoded; empty if there is nothing to say.
        """
        if self._is_raw or self._counts:
            return ""
        if self.are_undecoded:
            return "; it is decoded again, for its last moments"
        return "" if name in self._undecoded_ends else "; --raw also decodes its last moments"

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about logs that were not closed, or not completely decoded."""
        told = ((self._counts, "it is decoded again"), (self._unread, "--raw decodes it again"))
        return self._unclosed + [
            f"{path}: {counted(count, 'piece')} not decoded when it was made; {then}"
            for counts, then in told
            for path, count in counts.items()
        ]

    @cached_property
    def _counts(self) -> Mapping[str, int]:
        """The number of chunks and packets that were not decoded, by path, for logs that say so."""
        counts = {path: undecoded_pieces(path) for path in self._files}
        return {path: count for path, count in counts.items() if count}

    @cached_property
    def _undecoded_ends(self) -> Mapping[str, bool]:
        """For each log, by path: True if it was not closed, and its last evidence was not decoded.

        Empty if the files together have more than MAX_LOOKED_THROUGH bytes, since decoding all of
        them again would take too long.
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
        """The paths of the files that are no pipes and can be read several times."""
        return [path for path in self._paths if not place_of(path)[1]]


def evidence_and_events(log: LogReader) -> Iterator[Chunk | Packet | WireEvent]:
    """Yield the packets and chunks of a log, and those events that decoding them again cannot find,
    such as errors of a port. Each event comes at its place in time.
    """
    taps = {name for name, one in log.links.items() if one.get(SPEC, "").startswith("tap:")}
    return _in_place(
        item
        for item in log.captured_items()
        if not isinstance(item, WireEvent) or is_of_source(item, taps)
    )


def _in_place(items: Iterator[Chunk | Packet | WireEvent]) -> Iterator[Chunk | Packet | WireEvent]:
    """Yield the items in an order in which each event stands before the later evidence of its link.

    The log has an event only after the decoder has passed it on, and often behind later evidence.
    An event about lost bytes ends the frame that is being decoded. If it came too late, it would
    end a later frame.
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
    except InputError:  # The log is cut off. The items before that are sound.
        yield from held
        raise
    yield from held


def is_of_source(event: WireEvent, taps: Set[str]) -> bool:
    """True for an event that a driver, a tap or an interface reported. Decoding packets and bytes
    again cannot find it.

    `taps` are the names of the links that are taps.
    """
    if event.kind in _OF_TAPS:
        return event.link in taps
    if event.kind is EventKind.DISCARDED:
        # The decoder may have discarded data because of its own limits. Decoding again reports that
        # again.
        return bool(event.packets) or any(text in event.message for text in _LOSSES_OF_SOURCES)
    if event.kind is EventKind.GAP:
        # A GAP event without a source address is about a damaged place of the log, or a port that
        # was unplugged. A GAP event about missing packets has a source address, and decoding finds
        # it again.
        return not event.source
    return event.kind in _OF_SOURCES
