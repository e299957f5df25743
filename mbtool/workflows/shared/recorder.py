"""Writes captured packets and bytes to the log in a thread that never waits for the decoder."""

# The packets and chunks that were heard (the evidence) pass from the threads of the sources (ports,
# interfaces, taps) into an Inbox. The recorder's thread writes them to the log and puts them into a
# second Inbox for the decoder, which runs in the main thread. The decoder's records are given back
# to the recorder's thread, which writes them, too. So only one thread writes the log, and evidence
# stands before the records decoded from it. Evidence is in the log at most 0.6 s after it was heard
# (see logs/writer.py).
#
# The second Inbox takes DEFAULT_LIMIT bytes. If the decoder is that far behind, further items are
# not decoded (sources/inbox.py), but they are in the log. Marks in the log say how far the decoder
# is behind if it is later than BEHIND_NS, and when it has caught up (docs/decisions/0012).
#
# The decoder waits while MAX_RECORDS records wait to be written. The recorder never waits for the
# decoder.
#
# Memory: the two inboxes (64 MiB each) and MAX_RECORDS records.

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from threading import Condition, Thread
from typing import TYPE_CHECKING, Protocol

from mbtool.core import Chunk, EventKind, Packet, WireEvent
from mbtool.logs.messages import DecodingMark, LogItem
from mbtool.logs.undecoded import UNDECODED_PIECES
from mbtool.sources.inbox import Inbox, Item

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record

TICK_S = 0.1
"""The recorder's thread waits at most this long (seconds) for evidence before it checks the clock
again."""
BATCH = 500
"""At most this many packets and chunks are written to the log before they are passed to the
decoder."""
MAX_RECORDS = 1000
"""At most this many decoded records wait to be written. The recorder's thread writes all of them at
once, which delays the writing of evidence by less than 0.1 s."""
BEHIND_NS = 250_000_000
"""If decoding is later than recording by more than this (ns), a mark is written to the log. So if
recording is killed and there is no mark, the log lacks at most the decoded records of this time,
and what was not on the disk yet."""
_MARK_NS = 100_000_000
"""While the decoder is behind, a mark that says so is written to the log at this interval (ns)."""


class Log(Protocol):
    """The methods of a log writer that a recorder uses."""

    def write(self, item: LogItem | DecodingMark) -> None: ...

    def tick(self, now_ns: int) -> None:
        """Write items that have waited in memory for some time. Called regularly with the present
        time (UTC ns).
        """

    def close(self, final: Mapping[str, str]) -> None:
        """Complete the log. `final` is metadata (keys and values as texts) that is known only at
        the end of recording.
        """


class Recorder:
    """Writes a log in a thread of its own while sources are recorded. Call `start`, `stop` and
    `close`, in this order.
    """

    def __init__(self, heard: Inbox, log: Log, now_ns: Callable[[], int]) -> None:
        """`heard` is the inbox that the sources fill, and `log` the log writer. `now_ns` returns
        the time in UTC ns.
        """
        self._heard = heard
        self._log = log
        self._now_ns = now_ns
        self.undecoded = Inbox(behind=heard)
        """The inbox of the decoder. Its packets and chunks are already in the log; it also has the
        sources' events."""
        self._records: deque[Record] = deque()
        self._changed = Condition()
        self._failure: Exception | None = None
        self._is_stopping = False
        self._thread: Thread | None = None
        self._recorded = 0
        """The number of chunks and packets written to the log."""
        self._decoded = 0
        """The number of chunks and packets that are decoded, and whose records were passed to
        `write`."""
        self.dropped = 0
        """The number of chunks and packets that will not be decoded, because the decoder was too
        far behind."""
        self._told_dropped = 0
        self._awaited = (0, now_ns())
        """An earlier value of `_recorded`, and the time (ns) when it had this value. If the decoder
        has not decoded as many chunks and packets BEHIND_NS after that time, it is behind."""
        self._is_behind = False
        self._marked_ns = now_ns() - _MARK_NS
        self._discarded_packets = 0
        self._discarded_bytes = 0
        """The number of bytes that the sources have lost. Packets that the kernel dropped are
        counted in `_discarded_packets`."""

    @property
    def waiting(self) -> int:
        """The number of chunks and packets in the log that the decoder still has to decode."""
        return self._recorded - self._decoded - self.dropped

    def start(self) -> None:
        self._thread = Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def write(self, record: Record) -> None:
        """Pass a decoded record to the recorder's thread, which writes it to the log. Waits while
        MAX_RECORDS records wait to be written.

        If an error has ended the recording, it is raised.
        """
        if self._thread is None:
            self._log.write(record)
            return
        with self._changed:
            while len(self._records) >= MAX_RECORDS and self._failure is None:
                self._changed.wait()
            self._records.append(record)
        self.check()

    def note_decoded(self, item: Item) -> None:
        """Count `item` as decoded if it is a chunk or packet. Before that, all its records must
        have been passed to `write`.
        """
        self._decoded += isinstance(item, Chunk | Packet)

    def check(self) -> None:
        """If an error has ended the recording, raise it; usually it is an OutputError."""
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Write all evidence that is still in the inbox, and end the thread.

        The caller must close the sources first. After this call, `write` writes to the log
        directly.
        """
        self._is_stopping = True
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def close(self) -> None:
        """Complete the log; call it after `stop`. Raises OutputError if the log cannot be
        written.
        """
        final = {
            "discarded_packets": str(self._discarded_packets),
            "discarded_bytes": str(self._discarded_bytes),
        }
        try:
            if self._failure is None and (self._is_behind or self.waiting or self._has_new_drops):
                self._write_decoding_mark(self._now_ns(), self.waiting)
        finally:
            if self.waiting or self.dropped:
                final[UNDECODED_PIECES] = str(self.waiting + self.dropped)
            self._log.close(final)

    def _run(self) -> None:
        try:
            self._tick()  # Lets `mbtool status` find the links and a heartbeat from the start.
            while True:
                # Read the flag before the inbox, so that everything put into the inbox before
                # `stop` is written.
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
            (self._is_behind or self._has_new_drops)
            and not 0 <= now_ns - self._marked_ns < _MARK_NS
        ):
            self._write_decoding_mark(now_ns, self.waiting if self._is_behind else 0)
        self._log.tick(now_ns)

    @property
    def _has_new_drops(self) -> bool:
        """True if chunks or packets were dropped without being decoded since the last mark in the
        log.
        """
        return self.dropped > self._told_dropped

    def _write_decoding_mark(self, now_ns: int, waiting: int) -> None:
        # The records of all chunks and packets decoded so far must stand before the mark in the
        # log.
        self._write_records()
        dropped, self._told_dropped = self.dropped - self._told_dropped, self.dropped
        self._marked_ns = now_ns
        self._log.write(DecodingMark(ts_ns=now_ns, waiting=waiting, dropped=dropped))
