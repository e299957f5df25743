"""Finds the registers that hold numbers which somebody saw on a display."""

# The slaves' words are sampled over the whole recording (devices/observed_slave.py). For each time
# at which a number was seen, the rows right before and right after it are kept as well, as a sample
# of a long recording is too coarse.
#
# Memory: that of the observed slaves; two rows of each kind of request for each time of a sighting.

from __future__ import annotations

import threading
from bisect import insort
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from mbtool.core import InputError, UsageError, WireEvent
from mbtool.core.moments import moment
from mbtool.devices.observed_slave import MAX_SAMPLED, ObservedRequest, ObservedSlave
from mbtool.ports.clock import now_ns
from mbtool.values.finding import Sighting, Wanted, WordsOfSlave, find, find_changed
from mbtool.values.judging import WordHistory
from mbtool.values.sightings import Seen, SeenTime, wanted_of
from mbtool.values.value_series import histories_of
from mbtool.workflows.shared.observed_slaves import ObservedSlaves
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from contextlib import ExitStack

    from mbtool.decode.decoder import Record
    from mbtool.devices import Who
    from mbtool.values.finding import ChangedPlace, FoundPlace
    from mbtool.workflows.sniff import Sniffer

_Row = tuple[int, tuple[int, ...]]


class Finder:
    """Collects the words of slaves, and finds numbers in them."""

    def __init__(self, who: Who | None = None) -> None:
        self.slaves = ObservedSlaves(who, with_values=True, on_row=self._note)
        self.first_ns = 0
        """When the first transaction began (UTC ns); 0 before it."""
        self.last_ns = 0
        """When the last registers were read or written (UTC ns)."""
        self._times: list[int] = []
        self._last: dict[tuple[int, ObservedRequest], _Row] = {}
        self._around: dict[int, dict[tuple[int, ObservedRequest], list[_Row]]] = {}
        self._pending: dict[tuple[int, ObservedRequest], int] = {}
        """For each kind of request of a slave: the index of the next time of a sighting."""

    def add(self, records: Iterable[Record]) -> None:
        for record in records:
            if not self.first_ns and not isinstance(record, WireEvent):
                self.first_ns = record.start_ns
            self.slaves.add((record,))

    def expect(self, at_ns: int) -> None:
        """Keep the rows around a time (UTC ns); earlier rows must not have been added yet."""
        if at_ns not in self._times:
            insort(self._times, at_ns)
            self._around[at_ns] = {}

    def _note(
        self, slave: ObservedSlave, request: ObservedRequest, at_ns: int, values: Sequence[int]
    ) -> None:
        self.last_ns = max(self.last_ns, at_ns)
        if not self._times:
            return
        key = id(slave), request
        if key not in self._last and len(self._last) >= MAX_SAMPLED:
            return
        row = at_ns, tuple(values)
        place = self._pending.get(key, 0)
        while place < len(self._times) and self._times[place] <= at_ns:
            before = self._last.get(key)
            rows = [row] if before is None else [before, row]
            self._around[self._times[place]][key] = rows
            place += 1
        self._pending[key] = place
        self._last[key] = row

    def words(self) -> list[WordsOfSlave]:
        """Return the words of all slaves so far; what comes later does not change them."""
        found = []
        for slave in self.slaves.slaves:
            exact: dict[int, list[WordHistory]] = {}
            for at_ns, around in self._around.items():
                own = exact[at_ns] = []
                for (place, request), last in self._last.items():
                    rows = around.get((place, request), [last])
                    if place == id(slave) and request.table is not None:
                        times, words = zip(*rows, strict=True)
                        own.append(
                            WordHistory(
                                request.table,
                                request.span.start,
                                times,
                                words,
                                is_written=request.writes,
                            )
                        )
            found.append(WordsOfSlave(str(slave.who), histories_of(slave), exact))
        return found

    def places(self, wanted: Sequence[Wanted]) -> list[list[FoundPlace]]:
        """Return the places of each number, the most probable first."""
        return find(wanted, self.words())

    def changed(self, begin_ns: int, end_ns: int) -> list[ChangedPlace]:
        """Return the values that are others after `end_ns` than before `begin_ns` (UTC ns)."""
        return find_changed(self.words(), begin_ns, end_ns)

    def slave_of(self, text: str) -> ObservedSlave:
        """The slave with this name in a found place."""
        return next(one for one in self.slaves.slaves if str(one.who) == text)


class FindRun:
    """Finds numbers in files."""

    def __init__(self, files: Sequence[str], options: ReadingOptions, who: Who | None) -> None:
        self.reading = Reading(files, options)
        self.finder = Finder(who)
        self.error: InputError | None = None
        """The error of a file that could be read only in part."""

    def read(self, times: Sequence[SeenTime], watch: Watch = unwatched) -> None:
        """Read the files as far as they can be read.

        `times` are those at which numbers were seen. Raises InputError if an error comes before the
        first transaction.
        """
        finder = self.finder
        try:
            for record in watch(self.reading, self.reading.records()):
                if not finder.first_ns and not isinstance(record, WireEvent):
                    for time in times:
                        finder.expect(time.at_ns(record.start_ns))
                finder.add((record,))
        except InputError as error:
            if not finder.first_ns:
                raise
            self.error = error

    def wanted(self, seen: Sequence[Seen]) -> list[Wanted]:
        """Return the displays; raise UsageError if a time is outside the recording."""
        finder = self.finder
        if finder.last_ns:
            for one in seen:
                if one.time is not None:
                    at_ns = one.time.at_ns(finder.first_ns)
                    self.demand_inside(at_ns, f"{one.value:g} was seen at {moment(at_ns)}, which")
        return wanted_of(seen, finder.first_ns)

    def demand_inside(self, at_ns: int, text: str) -> None:
        """Raise UsageError, which begins with `text`, if a time is outside the recording."""
        first_ns, last_ns = self.finder.first_ns, self.finder.last_ns
        if not first_ns <= at_ns <= last_ns:
            raise UsageError(
                f"{text} is not in the recording, {moment(first_ns)} to {moment(last_ns)} UTC"
            )


class LiveFinder:
    """Listens on links in a thread of its own, and finds numbers that are seen meanwhile.

    Numbers with the same name are one display; so are all numbers without a name.
    """

    def __init__(self, sniffer: Sniffer, opened: ExitStack, who: Who | None) -> None:
        """`opened` is a context that contains the opened sniffer; the thread leaves it."""
        self.finder = Finder(who)
        self.lock = threading.Lock()
        """The lock that a thread must hold while it uses `finder`."""
        self.error: Exception | None = None
        """The error that ended the thread; None if there was none."""
        self._sniffer, self._opened = sniffer, opened
        self._stopping = threading.Event()
        self._seen: dict[str, list[Sighting]] = {}
        self._units: dict[str, str] = {}
        self._thread = threading.Thread(target=self._main, name="find", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for its end."""
        self._stopping.set()
        self._thread.join()

    def see(self, seen: Seen) -> None:
        """Note a number that a display shows at this moment."""
        at_ns = now_ns()
        with self.lock:
            self.finder.expect(at_ns)
        self._seen.setdefault(seen.name, []).append(Sighting(seen.value, seen.tolerance, at_ns))
        if seen.unit:
            self._units[seen.name] = seen.unit

    @property
    def wanted(self) -> list[Wanted]:
        return [
            Wanted(name, sightings, self._units.get(name, ""))
            for name, sightings in self._seen.items()
        ]

    def places(self) -> list[list[FoundPlace]]:
        """Return the places of each number so far; the links are heard meanwhile."""
        with self.lock:
            words = self.finder.words()
        return find(self.wanted, words)

    def _main(self) -> None:
        try:
            with self._opened:
                for record in self._sniffer.records(lambda _: self._stopping.is_set()):
                    with self.lock:
                        self.finder.add((record,))
        except Exception as error:  # The main thread raises it again.
            self.error = error
