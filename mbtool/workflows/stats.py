"""Computes the statistics of captures and logs, or of live links."""

# Files are read as for `decode`, and live links as for `sniff`. The option --where chooses
# transactions. Events are always counted, as the counts of connections come from them.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import InputError, WireEvent
from mbtool.ledger.answered_run import AnsweredRun
from mbtool.ledger.statistics import Statistics
from mbtool.workflows.shared.model_hints import ModelHints
from mbtool.workflows.shared.unreadable_lines import UnreadableLines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.core import SerialFormat
    from mbtool.decode.decoder import Record
    from mbtool.query.where import Where
    from mbtool.workflows.shared.part_reading import PartReading

ORDERED_AFTER_NS = 5_000_000_000
"""Live transactions wait for this time (ns) before they are sorted by the time of their requests. A
decoder does not wait longer for a response. So no transaction with an earlier request can come
after this time."""


class FileStatistics:
    """Reads files once, and computes the statistics of the transactions that the user's filter
    accepts.
    """

    def __init__(self, reading: PartReading, wanted: Where) -> None:
        """`wanted` returns True for the transactions to count.

        Unless it does so for all of them, `reading` must not yield batches (AnsweredRun), as these
        cannot be filtered.
        """
        self._reading = reading
        self._wanted = wanted
        self._captures = 0
        self._hints = ModelHints(reading.profile_for)
        self._lines = UnreadableLines(lambda link: reading.line_of(link))
        self._doubts: list[str] = []
        self.statistics = Statistics(self._format_of)

    def run(self) -> Iterator[Record | AnsweredRun]:
        """Count everything in the files, and yield each transaction and event; many answered
        requests may come together as one AnsweredRun.

        Raises InputError for a file that cannot be read, and, after all other records are counted,
        for a file that is cut or damaged.
        """
        try:
            for record in self._reading.parts():
                if self._reading.captures != self._captures:
                    self._captures = self._reading.captures
                    self.statistics.begin_capture()
                if isinstance(record, AnsweredRun):
                    self.statistics.add_run(record)
                    yield record
                    continue
                self._hints.note(record)
                if (doubt := self._lines.note(record)) is not None:
                    self._doubts.append(doubt)
                _add_wanted(self.statistics, record, self._wanted)
                yield record
        except InputError:
            self.statistics.settle()
            raise
        self.statistics.settle()
        self._doubts += self._lines.untold()

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about the files, for example about cut packets or wrong line
        settings.
        """
        doubts = [f"mbtool: {doubt}" for doubt in self._doubts]
        return [*self._reading.remarks, *doubts, *self._hints.remarks]

    def _format_of(self, link: str) -> SerialFormat | None:
        return self._reading.format_of(link)


class LiveStatistics:
    """Computes the statistics of live links, from the transactions that the user's filter
    accepts.
    """

    def __init__(self, format_of: Callable[[str], SerialFormat | None], wanted: Where) -> None:
        self._wanted = wanted
        self.statistics = Statistics(format_of)

    def add(self, record: Record) -> None:
        _add_wanted(self.statistics, record, self._wanted)

    def advance(self, now_ns: int) -> None:
        """Take the transactions whose requests are more than ORDERED_AFTER_NS before `now_ns` (UTC
        ns), in order of time, and count them in the periods, poll cycles and hours.
        """
        self.statistics.settle(now_ns - ORDERED_AFTER_NS)


def _add_wanted(statistics: Statistics, record: Record, wanted: Where) -> None:
    if isinstance(record, WireEvent) or wanted(record):
        statistics.add(record)
    else:
        statistics.left_out += 1
