"""Feeds the live views, in a thread of its own: records of links, or of files that are played."""

# The thread decodes and, with a log, records, however long a view takes to draw. A view reads
# `watched` while it holds `lock`; the thread takes the lock for at most BATCH records at a time.
#
# A file is first read to its end. Then it can be played: a jump back reads it again from the start.
# The times of a file are those of its records; the view's time is the position in the file.
#
# Memory: the records of a file, as far as they are no more than MAX_CACHED, so that a jump back
# need not decode them again.

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from typing import TYPE_CHECKING

from mbtool.core import MbtoolError, WireEvent
from mbtool.ports.clock import now_ns
from mbtool.replay.clock import PlayClock
from mbtool.watching.watched import Watched
from mbtool.workflows.stats import ORDERED_AFTER_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from contextlib import ExitStack

    from mbtool.core import SerialFormat
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.workflows.sniff import Sniffer

    Note = Callable[[Record], str | None]

BATCH = 64
MAX_CACHED = 200_000
MAX_REMARKS = 100
_SETTLE_NS = 200_000_000
_PACE_S = 0.05
"""How often a file that is played looks at the time, in s."""


class WatchFeed(ABC):
    """Reads records in a thread of its own, and adds them to `watched`."""

    is_live = True

    def __init__(self, watched: Watched) -> None:
        self.watched = watched
        self.lock = threading.Lock()
        """Hold it to read or change `watched`."""
        self.remarks: deque[str] = deque(maxlen=MAX_REMARKS)
        """Lines for the user, the last one last."""
        self.error: BaseException | None = None
        """What ended the thread or the reading of a file; None while all is well."""
        self.is_over = False
        """True once no further record comes by itself."""
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._main, name="watch feed", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread, and wait until it has completed the log."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    @abstractmethod
    def now_ns(self) -> int:
        """The time of the view: the clock's, or the position in a file, in UTC ns."""

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
    """Takes the records of live links from a sniffer that is already open."""

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
        """`opened` is the context of the sniffer; the thread leaves it, which completes the log.

        `ends` is asked at least ten times a second, True ends the recording. Each of `notes` looks
        at a record and may give a line for the user; `remarks` are those of the sniffer.
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
        """True once the recording must end: what was heard is then decoded for a short time."""
        return self._stopping.is_set() or self._ends()


class FileFeed(WatchFeed):
    """Reads files to their end; then plays them: at a speed, step by step, from any position."""

    is_live = False

    def __init__(
        self,
        records: Callable[[], Iterator[Record]],
        watched: Watched,
        *,
        plays: bool = False,
    ) -> None:
        """`records` reads the files anew with each call; with `plays` they are played at once."""
        super().__init__(watched)
        self._open = records
        self._plays = plays
        self._cache: list[Record] | None = []
        self._clock = PlayClock(0)
        self._woken = threading.Event()
        self._steps = 0
        self._is_whole = False
        self.first_ns = self.last_ns = 0
        """The times of the first and the last record, in UTC ns; known once the files are read."""
        self.is_read = False
        """True once the files were read to their end."""

    def now_ns(self) -> int:
        if not self.is_read or self._is_whole:
            return self.watched.whole.last_ns
        return self.first_ns + self.position_ns

    @property
    def position_ns(self) -> int:
        """The position since the first record, in ns."""
        return min(max(self._clock.position(now_ns()), 0), self._clock.length_ns)

    @property
    def is_playing(self) -> bool:
        return self._clock.is_running

    @property
    def speed(self) -> float:
        return float(self._clock.rate or 1)

    def play(self) -> None:
        """Play from the position, or from the beginning if all was played; or pause."""
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
        """Jump by a time in ns; back if it is negative."""
        self._jump(self.position_ns + by_ns)

    def seek_to(self, share: float) -> None:
        """Jump to a share of the whole, 0 to 1."""
        self._jump(round(share * self._clock.length_ns))

    def step(self) -> None:
        """Pause, and show one transaction more."""
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
        shown_ns: int | None = None  # The position up to which records are shown.
        while not self._stopping.is_set():
            self._woken.wait(_PACE_S if self._clock.is_running else None)
            self._woken.clear()
            if self._is_whole or self._stopping.is_set():
                continue
            target_ns = self.position_ns
            if shown_ns is None or target_ns < shown_ns:
                with self.lock:
                    self.watched.restart()
                records = self._records()
                waiting = next(records, None)
            target_ns, waiting = self._show_until(records, waiting, target_ns)
            shown_ns = target_ns
            if waiting is None and self._clock.is_running:
                self._clock.pause(now_ns())

    def _show_until(
        self, records: Iterator[Record], waiting: Record | None, target_ns: int
    ) -> tuple[int, Record | None]:
        """Add what came up to a position, and the steps; return it and the next record."""
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
        """Read the files to their end, and show all of them."""
        batch: list[Record] = []
        try:
            for record in self._open():
                batch.append(record)
                if len(batch) >= BATCH:
                    self._add(batch)
                    self._note(batch)
                    batch = []
                    if self._stopping.is_set():
                        return
        except MbtoolError as error:
            self.error = error  # What was read before can be seen and played.
        self._add(batch)
        self._note(batch)
        self._settle(None)
        self._clock = PlayClock(max(self.last_ns - self.first_ns, 0))
        self._clock.jump(self._clock.length_ns, now_ns())
        self._is_whole = self.is_read = True

    def _note(self, batch: list[Record]) -> None:
        for record in batch:
            at_ns = _time_of(record)
            self.first_ns = min(self.first_ns or at_ns, at_ns)
            self.last_ns = max(self.last_ns, at_ns)
        if self._cache is not None:
            self._cache += batch
            if len(self._cache) > MAX_CACHED:
                self._cache = None

    def _records(self) -> Iterator[Record]:
        return iter(self._cache) if self._cache is not None else self._open()


def make_watched(
    format_of: Callable[[str], SerialFormat | None],
    profile_for: Callable[[NamedTransaction], Profile | None],
) -> Watched:
    """The model for a view of links or files."""
    return Watched(format_of, profile_for)


def _time_of(record: Record) -> int:
    return record.ts_ns if isinstance(record, WireEvent) else record.start_ns
