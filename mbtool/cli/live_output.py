"""Prints the records of a live recording without waiting for the reader of the output."""

# Text goes through a queue (view_queue.py). While the queue is full, whole rows are left out and
# counted; the number is printed before the next row. The output may take no more text, because its
# reader has closed it (as `head` does) or the disk is full. Then the recording goes on if a log
# keeps the records; without a log it ends with BrokenPipeError or OutputError.

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import TYPE_CHECKING, TextIO

from mbtool.cli.output import RecordOutput, as_output_error
from mbtool.cli.talk import say
from mbtool.cli.view_queue import ViewQueue, unwaited
from mbtool.core import OutputError
from mbtool.core.moments import counted

if TYPE_CHECKING:
    from mbtool.cli.options import EventChoice, SortKey
    from mbtool.cli.printers import Printer
    from mbtool.decode.decoder import Record
    from mbtool.query.where import Where


class LiveOutput(RecordOutput):
    """Prints the records that pass the filter, as long as the reader takes them in time."""

    def __init__(
        self,
        file: TextIO,
        name: str,
        make_printer: Callable[[TextIO], Printer],
        events: EventChoice,
        wanted: Where,
        limit: int | None,
        order: SortKey | None = None,
        *,
        is_kept: bool,
        is_hurried: Callable[[], bool],
        is_silent: bool = False,
    ) -> None:
        """Print to `file`, which messages call `name`, in the form of the printer that is made.

        `is_kept` is True if a log keeps the records, too. With `is_silent`, records are only
        counted. `is_hurried` returns True once the user has asked for the end of the command.
        """
        queue = unwaited(file)
        super().__init__(queue, name, make_printer, events, wanted, limit, order)
        self._queue = queue if isinstance(queue, ViewQueue) else None
        self._is_kept = is_kept
        self._is_hurried = is_hurried
        self._has_reader = not is_silent
        self.has_failed = False
        """True if the output could not be written, and not because its reader had closed it."""
        self._not_shown = 0
        """Number of records left out since the last printed record, as the reader was too slow."""

    def wait(self) -> None:
        if self._has_reader:
            self._write(self._printer.pause, self._file.flush)

    def finish(self) -> None:
        self._report_not_shown()
        self._write(self._printer.flush, self._file.flush, self._drain)

    def _print(self, record: Record, number: int) -> None:
        self._tally.add(record)
        if not self._has_reader:
            return
        if self._queue is not None and self._queue.is_full:
            self._not_shown += 1
            return
        self._report_not_shown()
        self._write(lambda: self._printer.print(record, number))

    def _report_not_shown(self) -> None:
        count, self._not_shown = self._not_shown, 0
        if count:
            say(
                f"mbtool: {counted(count, 'row')} not shown: {self._name} did not take them in time"
            )

    def _drain(self) -> None:
        if self._queue is not None and not self._queue.drain(self._is_hurried):
            say(f"mbtool: {self._name} takes no text, so the last rows are not shown")

    def _write(self, *writes: Callable[[], None]) -> None:
        """Call the functions `writes`, unless the output takes no more text.

        If it fails now, the recording goes on if a log keeps the records; else the error is raised:
        BrokenPipeError, or OutputError if a terminal was closed or a disk is full.
        """
        if not self._has_reader:
            return
        try:
            with as_output_error(self._name):
                for write in writes:
                    write()
        except (BrokenPipeError, OutputError) as error:
            # A closed terminal gives EIO instead of EPIPE.
            is_gone = isinstance(error, BrokenPipeError) or _number(error) == errno.EIO
            if not self._is_kept:
                raise
            self._has_reader = False
            self.has_failed = not is_gone
            why = f"nobody reads {self._name} any more" if is_gone else str(error)
            say(f"mbtool: {why}; the recording goes on")


def _number(error: OutputError) -> int | None:
    """Return the system's error number (errno) that caused an OutputError, or None."""
    cause = error.__cause__
    return cause.errno if isinstance(cause, OSError) else None
