"""Writes what the sources hear to the log, in a thread of its own, however late the decoder is."""

# Evidence goes from the sources' threads into an Inbox, from there by the recorder's thread into
# the log, and then into a second Inbox for the decoder, which runs in the main thread. The decoder
# hands its records back, and the same thread writes them. So one thread owns the log, and nothing
# that decodes or prints delays evidence: it is in the log at most 0.6 s after it was heard (see
# logs/writer.py), and evidence stands before what was decoded from it.
#
# When the second Inbox is full, the decoder is DEFAULT_LIMIT bytes behind. Then items are left out
# there (sources/inbox.py); the log has them. A mark in the log says how far the decoder is behind
# once that is more than BEHIND_NS, and when it has caught up (docs/decisions/0012).
#
# The decoder waits while MAX_RECORDS records wait for the log. The recorder waits for nobody.
#
# Memory: the two inboxes (64 MiB each) and MAX_RECORDS records.

from __future__ import annotations

from collections import deque
from threading import Condition, Thread
from typing import TYPE_CHECKING, Protocol

from mbtool.core import Chunk, EventKind, Packet, WireEvent
from mbtool.logs.messages import DecodingMark
from mbtool.logs.undecoded import UNDECODED_PIECES
from mbtool.sources.inbox import Inbox

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mbtool.decode.decoder import Record
    from mbtool.logs.messages import LogItem
    from mbtool.sources.inbox import Item

TICK_S = 0.1
"""The longest time in seconds between two looks at the clock."""
BATCH = 500
"""The most items that are written before the decoder gets them."""
MAX_RECORDS = 1000
"""So many records are written at once, while evidence waits: for less than 0.1 s."""
BEHIND_NS = 250_000_000
"""A decoder that is later than this, in ns, is marked as behind. So a log that was not closed lacks
at most so much of what its evidence shows, beside what was not on the disk."""
_MARK_NS = 100_000_000
"""While the decoder is behind, a mark is written every so many ns."""


class Log(Protocol):
    """The part of a log writer that a recorder uses."""

    def write(self, item: LogItem | DecodingMark) -> None: ...

    def tick(self, now_ns: int) -> None:
        """Called regularly with the time in ns: write items that have been waiting in memory."""

    def close(self, final: Mapping[str, str]) -> None:
        """Complete the log; `final` holds values that are only known at the end of a run."""


class Recorder:
    """Owns a log while sources are heard. `start`, then `stop`, then `close`."""

    def __init__(self, heard: Inbox, log: Log, now_ns: Callable[[], int]) -> None:
        """`heard` is the inbox that the sources fill."""
        self._heard = heard
        self._log = log
        self._now_ns = now_ns
        self.undecoded = Inbox(behind=heard)
        """What is in the log, or is no evidence, and is to be decoded."""
        self._records: deque[Record] = deque()
        self._changed = Condition()
        self._failure: Exception | None = None
        self._is_stopping = False
        self._thread: Thread | None = None
        self._recorded = 0
        """Number of pieces (chunks and packets) in the log."""
        self._decoded = 0
        """Number of pieces whose records have been handed over."""
        self.dropped = 0
        """Number of pieces that the decoder did not get, as it was too far behind."""
        self._told_dropped = 0
        self._awaited = (0, now_ns())
        """A number of recorded pieces, and the time in ns when there were so many."""
        self._is_behind = False
        self._marked_ns = now_ns() - _MARK_NS
        self._discarded_packets = 0
        self._discarded_bytes = 0
        """Number of bytes that the sources lost, without packets that the kernel dropped."""

    @property
    def waiting(self) -> int:
        """The number of pieces in the log that the decoder still has to decode."""
        return self._recorded - self._decoded - self.dropped

    def start(self) -> None:
        self._thread = Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def write(self, record: Record) -> None:
        """Hand over a record. Raises the error that ended the recording."""
        if self._thread is None:
            self._log.write(record)
            return
        with self._changed:
            self._changed.wait_for(
                lambda: len(self._records) < MAX_RECORDS or self._failure is not None
            )
            self._records.append(record)
        self.check()

    def note_decoded(self, item: Item) -> None:
        """Count an item as decoded; its records have been handed over."""
        self._decoded += isinstance(item, Chunk | Packet)

    def check(self) -> None:
        """Raise the error that ended the recording, usually an OutputError, if there is one."""
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Write all that is heard, and end the thread. The sources are closed before.

        The caller owns the log from here on.
        """
        self._is_stopping = True
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def close(self) -> None:
        """Complete the log, after `stop`. Raises OutputError if it cannot be written."""
        final = {
            "discarded_packets": str(self._discarded_packets),
            "discarded_bytes": str(self._discarded_bytes),
        }
        try:
            if self._failure is None and (self._is_behind or self.waiting or self._news):
                self._mark(self._now_ns(), self.waiting)
        finally:
            if self.waiting or self.dropped:
                final[UNDECODED_PIECES] = str(self.waiting + self.dropped)
            self._log.close(final)

    def _run(self) -> None:
        try:
            self._tick()  # So `mbtool status` finds the links and a heartbeat from the start.
            while True:
                # Read before the inbox: what was heard before the order to stop is then written.
                is_stopping = self._is_stopping
                items = self._heard.take(0 if is_stopping else TICK_S, BATCH)
                self._record(items)
                self._write_records()
                if is_stopping and not items:
                    return
                self._tick()
        except Exception as error:  # Usually an OutputError; `check` raises it in the main thread.
            with self._changed:
                self._failure = error
                self._changed.notify_all()

    def _record(self, items: list[Item]) -> None:
        for item in items:
            if isinstance(item, Chunk | Packet):
                self._log.write(item)
                self._recorded += 1
            elif isinstance(item, WireEvent) and item.kind is EventKind.DISCARDED:
                self._discarded_packets += item.packets
                self._discarded_bytes += item.missing
        for item in items:
            if self.undecoded.put(item):
                continue
            if isinstance(item, Chunk | Packet):
                self.dropped += 1
            elif isinstance(item, WireEvent):
                self._log.write(item)

    def _write_records(self) -> None:
        with self._changed:
            records, self._records = self._records, deque()
            self._changed.notify_all()
        for record in records:
            self._log.write(record)

    def _tick(self) -> None:
        now_ns = self._now_ns()
        awaited, since_ns = self._awaited
        was_behind = self._is_behind
        self._is_behind = now_ns - since_ns > BEHIND_NS and self.waiting > 0
        if self._decoded + self.dropped >= awaited:
            self._awaited = self._recorded, now_ns
        has_changed = was_behind != self._is_behind
        if has_changed or (
            (self._is_behind or self._news) and not 0 <= now_ns - self._marked_ns < _MARK_NS
        ):
            self._mark(now_ns, self.waiting if self._is_behind else 0)
        self._log.tick(now_ns)

    @property
    def _news(self) -> bool:
        """True if pieces were dropped since the last mark."""
        return self.dropped > self._told_dropped

    def _mark(self, now_ns: int, waiting: int) -> None:
        # The records of the decoded pieces must stand before the mark.
        self._write_records()
        dropped, self._told_dropped = self.dropped - self._told_dropped, self.dropped
        self._marked_ns = now_ns
        self._log.write(DecodingMark(ts_ns=now_ns, waiting=waiting, dropped=dropped))
