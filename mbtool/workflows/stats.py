"""Gathers the statistics of captures and logs, or of live links."""

# Files are read by the same reader as for `decode`, links are heard by the same sniffer as for
# `sniff`. --where chooses transactions; events, which tell of connections, always count.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import InputError, WireEvent
from mbtool.overview.statistics import Statistics
from mbtool.workflows.shared.model_hints import ModelHints
from mbtool.workflows.shared.unreadable_lines import UnreadableLines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.core import SerialFormat
    from mbtool.decode.decoder import Record
    from mbtool.query.where import Where
    from mbtool.workflows.shared.reading import Reading

ORDERED_AFTER_NS = 5_000_000_000
"""A live transaction is put in order after this time (ns): none ends later than a decoder waits for
an answer."""


class FileStatistics:
    """One pass over some files that counts what passes the filter."""

    def __init__(self, reading: Reading, wanted: Where) -> None:
        self._reading = reading
        self._wanted = wanted
        self._captures = 0
        self._hints = ModelHints(reading.profile_for)
        self._lines = UnreadableLines(lambda link: reading.line_of(link))
        self._doubts: list[str] = []
        self.statistics = Statistics(self._format_of)

    def run(self) -> Iterator[Record]:
        """Count all records, and give each of them.

        Raises InputError for a file that cannot be read; for one that is cut or damaged, after
        everything else has been counted.
        """
        try:
            for record in self._reading.records():
                if self._reading.captures != self._captures:
                    self._captures = self._reading.captures
                    self.statistics.begin_capture()
                self._hints.note(record)
                if (doubt := self._lines.note(record)) is not None:
                    self._doubts.append(doubt)
                if isinstance(record, WireEvent) or self._wanted(record):
                    self.statistics.add(record)
                yield record
        except InputError:
            self.statistics.settle()
            raise
        self.statistics.settle()
        self._doubts += self._lines.untold()

    @property
    def remarks(self) -> list[str]:
        """What a user should know of the files beside the figures, a line each."""
        doubts = [f"mbtool: {doubt}" for doubt in self._doubts]
        return [*self._reading.remarks, *doubts, *self._hints.remarks]

    def _format_of(self, link: str) -> SerialFormat | None:
        return self._reading.format_of(link)


class LiveStatistics:
    """Counts the records of live links that pass the filter."""

    def __init__(self, format_of: Callable[[str], SerialFormat | None], wanted: Where) -> None:
        self._wanted = wanted
        self.statistics = Statistics(format_of)

    def add(self, record: Record) -> None:
        if isinstance(record, WireEvent) or self._wanted(record):
            self.statistics.add(record)

    def advance(self, now_ns: int) -> None:
        """Put in order what has waited long enough at this time (ns)."""
        self.statistics.settle(now_ns - ORDERED_AFTER_NS)
