"""Reads the records for live views in a thread of its own: from links, or files played back."""

# The thread decodes and, with a log, records, however long a view takes to draw. A view reads the
# collected data (`watched`) while it holds `lock`. The thread holds the lock for at most BATCH
# records at a time.
#
# A file is first read to its end, and the view shows all of it. Then the user can play it back from
# any position. A jump back starts again with the file's first record. While a file is played,
# the time in the view is the recorded time at the present position.
#
# Memory: all records of the files, if they are at most MAX_CACHED, so that a jump back need not
# decode the files again.

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from mbtool.core import MbtoolError, SerialFormat, WireEvent
from mbtool.ports.clock import now_ns
from mbtool.replay.clock import PlayClock
from mbtool.watching.watched import Watched
from mbtool.workflows.stats import ORDERED_AFTER_NS

if TYPE_CHECKING:
    from contextlib import ExitStack

    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.workflows.sniff import Sniffer

    Note = Callable[[Record], str | None]
    Wanted = Callable[[NamedTransaction], bool]

BATCH = 64
MAX_CACHED = 200_000
MAX_REFILTERED = 50_000
"""A new filter is applied to all records of the files, if they are at most this many: if all of
them pass, that takes 2 s."""
MAX_REMARKS = 100
_SETTLE_NS = 200_000_000
_PACE_S = 0.05
"""While a file is played back, records are added to the view at this interval (seconds)."""


class WatchFeed(ABC):
    """Reads records in a thread of its own, and adds them to `watched`, the data that a
    view shows.
    """

    is_live = True

    def __init__(self, watched: Watched) -> None:
        self.watched = watched
        self.lock = threading.Lock()
        """The lock that a thread must hold while it reads or changes `watched`."""
        self.remarks: deque[str] = deque(maxlen=MAX_REMARKS)
        """The last lines for the user, at most MAX_REMARKS; the newest one is the last."""
        self.error: BaseException | None = None
        """The error that ended the thread, or that ended the reading of a file too early; None if
        there was none."""
        self.is_over = False
        """True once the thread has ended, so that no further records come."""
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._main, name="watch feed", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for its end. If a log is written, it is complete then."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    @abstractmethod
    def now_ns(self) -> int:
        """The time (UTC ns) that the view shows: the present time, or the recorded time at the
        position in a file.
        """

    def set_filter(self, wanted: Wanted | None) -> None:
        """Apply a filter to the records so far, as far as they are still kept, and to later ones;
        None ends filtering.
        """
        with self.lock:
            self.watched.set_filter(wanted, self._past())

    @property
    def keeps_all(self) -> bool:
        """True if a new filter sees all records so far; otherwise only those that are kept."""
        return self._past() is not None

    def _past(self) -> Sequence[Record] | None:
        """Return a list that begins with all records so far; None if they are not kept."""
        return None

    @abstractmethod
    def _run(self) -> None: ...

    def _main(self) -> None:
        try:
            self._run()
        except BaseException as error:  # The main thread raises it again.
            self.error = error
        finally:
            self.is_over = True

    def _add(self, records: Iterable[Record]) -> None:
        with self.lock:
            for record in records:
                self.watched.add(record)

    def _settle(self, before_ns: int | None) -> None:
        with self.lock:
            self.watched.advance(before_ns)


class LinkFeed(WatchFeed):
    """Reads the records of live links from a sniffer whose links are already open."""

    def __init__(
        self,
        sniffer: Sniffer,
        opened: ExitStack,
        watched: Watched,
        *,
        ends: Callable[[], bool] = lambda: False,
        notes: Sequence[Note] = (),
        remarks: deque[str] | None = None,
    ) -> None:
        """`opened` is a context that contains the opened sniffer. When recording ends, the feed's
        thread leaves this context, which completes the log.

        `ends` is called at least ten times a second and returns True to end the recording. Each
        function in `notes` is called with each record; it returns a line for the user, or None. The
        lines are added to `remarks`, to which the sniffer adds its own.
        """
        super().__init__(watched)
        self._sniffer, self._opened = sniffer, opened
        self._ends, self._notes = ends, notes
        self._settled_ns = 0
        if remarks is not None:
            self.remarks = remarks

    def stop(self) -> None:
        super().stop()
        self._opened.close()

    def now_ns(self) -> int:
        return now_ns()

    def _run(self) -> None:
        with self._opened:
            for record in self._sniffer.records(self._stops, self._is_asked):
                with self.lock:
                    self.watched.add(record)
                for note in self._notes:
                    if (remark := note(record)) is not None:
                        self.remarks.append(remark)

    def _stops(self, at_ns: int) -> bool:
        if not 0 <= at_ns - self._settled_ns < _SETTLE_NS:
            self._settled_ns = at_ns
            self._settle(at_ns - ORDERED_AFTER_NS)
        return self._is_asked()

    def _is_asked(self) -> bool:
        """True once the recording must end. After that, what was heard is decoded only for a short
        time.
        """
        return self._stopping.is_set() or self._ends()


class FileFeed(WatchFeed):
    """Reads files to their ends, then plays them back, at any speed or one transaction at a
    time.
    """

    is_live = False

    def __init__(
        self,
        records: Callable[[], Iterator[Record]],
        watched: Watched,
        *,
        plays: bool = False,
    ) -> None:
        """`records` returns all records of the files, from the beginning, at each call.

        With `plays`, the playback begins as soon as the files are read.
        """
        super().__init__(watched)
        self._open = records
        self._plays = plays
        self._cache: list[Record] | None = []
        self._clock = PlayClock(0)
        self._woken = threading.Event()
        self._steps = 0
        self._is_whole = False
        self._shown = (-1, False)
        """The position (ns) up to which records were added to the view, and True if there are no
        later ones."""
        self.first_ns = self.last_ns = 0
        """The times (UTC ns) of the earliest and the latest record; final when `is_read` is
        True."""
        self.is_read = False
        """True once all files have been read, to their ends or to an error."""

    def now_ns(self) -> int:
        if not self.is_read or self._is_whole:
            return self.watched.whole.last_ns
        return self.first_ns + self.position_ns

    @property
    def position_ns(self) -> int:
        """The position of the playback: the recorded time since the first record, in ns."""
        return min(max(self._clock.position(now_ns()), 0), self._clock.length_ns)

    @property
    def is_behind(self) -> bool:
        """True while records up to the position are still being added, after a jump."""
        if self._is_whole or self._clock.is_running:
            return False
        shown_ns, is_all = self._shown
        position_ns = self.position_ns
        return position_ns < shown_ns or (position_ns > shown_ns and not is_all)

    @property
    def is_playing(self) -> bool:
        return self._clock.is_running

    @property
    def speed(self) -> float:
        return float(self._clock.rate or 1)

    def play(self) -> None:
        """Pause the playback if it runs. Otherwise play from the present position; at the end, from
        the beginning.
        """
        at_ns = now_ns()
        if self._clock.is_running:
            self._clock.pause(at_ns)
        else:
            if self._is_whole or self._clock.is_over(at_ns):
                self._jump(0)
            self._clock.run(at_ns)
        self._woken.set()

    def faster(self) -> None:
        self._clock.faster(now_ns())

    def slower(self) -> None:
        self._clock.slower(now_ns())

    def seek(self, by_ns: int) -> None:
        """Jump forward by `by_ns` (ns of recorded time); a negative number jumps back."""
        self._jump(self.position_ns + by_ns)

    def seek_to(self, share: float) -> None:
        """Jump to a position, given as a share (0 to 1) of the length of the files in time."""
        self._jump(round(share * self._clock.length_ns))

    def step(self) -> None:
        """Pause the playback, and show the next transaction."""
        if self._is_whole:
            self._jump(0)
        self._clock.pause(now_ns())
        self._steps += 1
        self._woken.set()

    def stop(self) -> None:
        self._stopping.set()
        self._woken.set()
        super().stop()

    def _jump(self, position_ns: int) -> None:
        self._is_whole = False
        self._clock.jump(min(max(position_ns, 0), self._clock.length_ns), now_ns())
        self._woken.set()

    def _run(self) -> None:
        self._read_all()
        if self._plays and not self._stopping.is_set():
            self.play()
        records: Iterator[Record] = iter(())
        waiting: Record | None = None
        shown_ns: int | None = None  # The position (ns) up to which records were added to the view.
        while not self._stopping.is_set():
            self._woken.wait(_PACE_S if self._clock.is_running else None)
            self._woken.clear()
            if self._is_whole or self._stopping.is_set():
                continue
            target_ns = self.position_ns
            if shown_ns is None or target_ns < shown_ns:
                with self.lock:
                    self.watched.restart()
                self._shown = (-1, False)
                records = self._records()
                waiting = next(records, None)
            target_ns, waiting = self._show_until(records, waiting, target_ns)
            shown_ns = target_ns
            self._shown = (target_ns, waiting is None)
            if waiting is None and self._clock.is_running:
                self._clock.pause(now_ns())

    def _show_until(
        self, records: Iterator[Record], waiting: Record | None, target_ns: int
    ) -> tuple[int, Record | None]:
        """Add records to the view: `waiting` first, then those of `records` up to the position
        `target_ns` (ns).

        For each press of the step key, add records up to one more transaction. Returns the position
        reached (ns), and the next record, which waits; None for it at the end.
        """
        while waiting is not None and not self._stopping.is_set():
            batch: list[Record] = []
            while waiting is not None and len(batch) < BATCH:
                at_ns = _time_of(waiting) - self.first_ns
                if at_ns > target_ns:
                    if not self._steps:
                        break
                    if not isinstance(waiting, WireEvent):
                        self._steps -= 1
                        target_ns = at_ns
                        self._clock.jump(target_ns, now_ns())
                batch.append(waiting)
                waiting = next(records, None)
            if not batch:
                break
            self._add(batch)
        self._steps = 0
        end_ns = self.first_ns + target_ns - ORDERED_AFTER_NS
        self._settle(None if waiting is None else end_ns)
        return target_ns, waiting

    def _read_all(self) -> None:
        """Read the files to their ends, and add all their records to the view."""
        batch: list[Record] = []
        try:
            for record in self._open():
                batch.append(record)
                if len(batch) >= BATCH:
                    self._note(batch)
                    self._add(batch)
                    batch = []
                    if self._stopping.is_set():
                        return
        except MbtoolError as error:
            self.error = error  # The records before the error can be shown and played.
        self._note(batch)
        self._add(batch)
        self._settle(None)
        self._clock = PlayClock(max(self.last_ns - self.first_ns, 0))
        self._clock.jump(self._clock.length_ns, now_ns())
        self._is_whole = self.is_read = True

    def _note(self, batch: list[Record]) -> None:
        """Note the times of records, and the records, before they are added to the view."""
        for record in batch:
            at_ns = _time_of(record)
            self.first_ns = min(self.first_ns or at_ns, at_ns)
            self.last_ns = max(self.last_ns, at_ns)
        if self._cache is not None:
            self._cache += batch
            if len(self._cache) > MAX_CACHED:
                self._cache = None

    def _past(self) -> Sequence[Record] | None:
        cache = self._cache
        return cache if cache is not None and len(cache) <= MAX_REFILTERED else None

    def _records(self) -> Iterator[Record]:
        return iter(self._cache) if self._cache is not None else self._open()


def make_watched(
    format_of: Callable[[str], SerialFormat | None],
    profile_for: Callable[[NamedTransaction], Profile | None],
) -> Watched:
    """Return the data that a view shows, still without records.

    `format_of` returns the baud rate and character format of a link by name, and `profile_for` the
    device profile for a transaction; both return None if there is none.
    """
    return Watched(format_of, profile_for)


def _time_of(record: Record) -> int:
    return record.ts_ns if isinstance(record, WireEvent) else record.start_ns
