"""Prints records (transactions and events) to standard output or a file: filtered and counted."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import TYPE_CHECKING, TextIO

import typer

from mbtool.cli import exit_codes
from mbtool.cli.options import FORMATS, EventChoice, Format, SortKey
from mbtool.cli.output_file import emptied, is_old, open_file
from mbtool.cli.output_path import chosen_format, demand_new, is_same_file, named_file
from mbtool.cli.printers import LinesPrinter, ParquetPrinter, demand_columns, printer_for
from mbtool.cli.record_order import SORTED
from mbtool.cli.talk import NOTHING_WRITTEN, Interrupted, say
from mbtool.cli.tally import CONNECTION_EVENTS, Tally
from mbtool.core import InputError, MbtoolError, OutputError, UsageError, WireEvent
from mbtool.core.errors import reason_unwritten
from mbtool.views.table_options import TableOptions

if TYPE_CHECKING:
    from mbtool.cli.printers import Printer, ProfileFor
    from mbtool.columns.plain_lines import LineBatch
    from mbtool.columns.schema import Table
    from mbtool.columns.table_counts import TransactionCounts
    from mbtool.columns.value_table import ProfileNamed
    from mbtool.decode.decoder import Record
    from mbtool.query.where import Where
    from mbtool.troubles.judge import Judgement
    from mbtool.workflows.shared.reading import Reading

_STANDARD_OUTPUT_NAME = "standard output"


class RecordOutput:
    """Prints the records that pass the filter, and counts them.

    Its methods raise OutputError if the output cannot be written.
    """

    def __init__(
        self,
        file: TextIO,
        name: str,
        make_printer: Callable[[TextIO], Printer],
        events: EventChoice,
        wanted: Where,
        limit: int | None,
        order: SortKey | None = None,
    ) -> None:
        self._file = file
        self._name = name
        self._printer = make_printer(file)
        self._events = events
        self._wanted = wanted
        self._limit = limit
        self._order = order
        self._held: list[tuple[Record, int]] = []
        """If records are sorted (`order`): those that passed the filter, each with the number of
        transactions read up to it. `finish` sorts and prints them."""
        self._read = 0
        """The number of transactions so far, printed or not."""
        self._tally = Tally()

    @property
    def on_terminal(self) -> bool:
        return self._file.isatty()

    @property
    def is_full(self) -> bool:
        """True if --limit transactions have been printed; never without --limit."""
        return self._limit is not None and self._tally.transactions >= self._limit

    @property
    def is_empty(self) -> bool:
        """True if nothing has been printed."""
        return not self._tally.transactions and not self._tally.events

    def add(self, record: Record) -> None:
        """Print a record if it passes the filter; if records are sorted, keep it for `finish`."""
        if isinstance(record, WireEvent):
            if not self._wants(record):
                return
        else:
            self._read += 1
            if not self._wanted(record):
                return
        if self._order is not None:
            self._held.append((record, self._read))
        else:
            self._print(record, self._read)

    def skip(self) -> None:
        """Count a transaction that is not printed, so that later rows have the right number."""
        self._read += 1

    @property
    def takes_tables(self) -> bool:
        """True if `add_table` prints transactions (Parquet); else `add_lines` or `add` does."""
        return isinstance(self._printer, ParquetPrinter)

    def add_table(self, table: Table) -> None:
        """Print a table of transactions, without applying the filter and the limit."""
        from mbtool.columns.table_counts import table_counts

        assert isinstance(self._printer, ParquetPrinter)
        self.count(table_counts(table))
        with as_output_error(self._name):
            self._printer.print_table(table)

    def count(self, counts: TransactionCounts) -> int:
        """Add `counts` to the numbers of the last sentence: transactions that were printed without
        `add`.

        They are printed together, or by another process. Returns the number of the first of them
        among all transactions, from 1.
        """
        first = self._read + 1
        self._read += counts.outcomes.total()
        self._tally.add_counts(counts)
        return first

    @property
    def file_descriptor(self) -> int:
        return self._file.fileno()

    def is_written_elsewhere(self) -> None:
        """Note that another process writes the Parquet file; this process only counts."""
        assert isinstance(self._printer, ParquetPrinter)
        self._printer.is_elsewhere = True

    @property
    def printer(self) -> Printer:
        return self._printer

    def add_lines(self, batch: LineBatch) -> None:
        """Print the lines of a block of transactions, made by the array decoder, and count them.

        The filter and the limit are not applied.
        """
        self._tally.outcomes += batch.outcomes
        for record in batch.records:
            if not isinstance(record, WireEvent):
                self._tally.add(record)
        self._read += batch.outcomes.total()
        self.add_text(batch.text)

    def add_text(self, lines: str) -> None:
        """Print lines of transactions without counting them; the caller calls `count` for them."""
        assert isinstance(self._printer, LinesPrinter)
        with self.as_output_error():
            self._printer.print_lines(lines)

    def as_output_error(self) -> AbstractContextManager[None]:
        """Turn an OSError in the context into an OutputError that names this output.

        A BrokenPipeError passes unchanged.
        """
        return as_output_error(self._name)

    def wait(self) -> None:
        """Flush the printed records, as the next record may take a while."""
        with as_output_error(self._name):
            self._printer.pause()
            self._file.flush()

    def finish(self) -> None:
        """Print records that were kept to be sorted, and flush the output."""
        if self._order is not None:
            held, self._held = self._held, []
            for record, number in sorted(held, key=SORTED[self._order]):
                if self.is_full:
                    break
                self._print(record, number)
        with as_output_error(self._name):
            self._printer.flush()
            self._file.flush()

    def _print(self, record: Record, number: int) -> None:
        self._tally.add(record)
        try:
            self._printer.print(record, number)
        except OSError:
            with as_output_error(self._name):
                raise

    def sentence(self) -> str:
        """Return one sentence that counts the printed records."""
        return self._tally.sentence()

    def _wants(self, event: WireEvent) -> bool:
        if self._events is EventChoice.TROUBLE:
            return event.kind not in CONNECTION_EVENTS
        return self._events is EventChoice.ALL


@contextmanager
def open_output(
    path: str | None,
    format_: Format | None,
    events: EventChoice | None,
    profile_for: ProfileFor,
    wanted: Where,
    limit: int | None = None,
    demand_inputs: Callable[[], None] = lambda: None,
    *,
    is_kept: bool = False,
    table: TableOptions | None = None,
    order: SortKey | None = None,
    overwrite: bool = False,
    in_place: bool = False,
    make_output: Callable[..., RecordOutput] | None = None,
    is_summed: bool = True,
    if_interrupted: str = NOTHING_WRITTEN,
    points: str | None = None,
    profile_named: ProfileNamed = lambda _: None,
) -> Iterator[RecordOutput]:
    """Open an output. When its context ends, it is flushed and, if `is_summed`, a summary printed.

    `demand_inputs` is called before the file is opened, so that an error in an input does not
    overwrite an older output. `is_kept` is True if a log keeps the records. With `order`, all
    records are kept in memory, and printed in that order when the context ends. A file that exists
    is replaced only with `overwrite`, and only when the new file holds all that could be read; with
    `in_place` it is overwritten at once, for commands that only Ctrl-C ends. `make_output` makes
    another output than RecordOutput, such as one that does not wait for its reader
    (live_output.py). `if_interrupted` is printed if Ctrl-C comes before the first record, except
    where an old file was emptied. `points` is a second file for --format parquet, which gets the
    values of the transactions; `profile_named` returns a profile for them by its name. Raises
    UsageError if the file cannot be written or options contradict each other, and OutputError if
    standard output is closed and no log keeps the records.
    """
    path = named_file(path)
    place = "" if path is None else f" -> {path}"
    chosen = chosen_format(format_, path, FORMATS, Format.TABLE)
    shown = events or (EventChoice.TROUBLE if chosen is Format.TABLE else EventChoice.NONE)
    if table not in (None, TableOptions()) and chosen is not Format.TABLE:
        raise UsageError("--time, --columns, --hex, --wide and --full go with --format table")
    if not chosen.takes_events and shown is not EventChoice.NONE:
        raise UsageError(f"--events goes with table and jsonl; a row of {chosen} is a transaction")
    if chosen is Format.PARQUET:
        if path is None:
            raise UsageError("--format parquet writes a file: decode FILE -o OUT.parquet")
        demand_columns()
    if points is not None and (
        chosen is not Format.PARQUET or (path is not None and is_same_file(points, path))
    ):
        raise UsageError("--points names a second file beside -o OUT.parquet")
    stays = not in_place and is_old(path)
    if in_place and is_old(path):
        if_interrupted = f"interrupted; {path} is empty now"
    broken: InputError | None = None
    with ExitStack() as files:
        file, name = files.enter_context(
            opened(path, demand_inputs, is_kept=is_kept, overwrite=overwrite, in_place=in_place)
        )
        values = None
        if points is not None:
            from mbtool.columns.parquet import ValuesFile

            beside = opened(points, lambda: None, overwrite=overwrite, in_place=in_place)
            values = ValuesFile(files.enter_context(beside)[0].buffer, profile_named)

        def make_printer(to: TextIO) -> Printer:
            return printer_for(chosen, to, profile_for, table, values)

        with as_output_error(name):
            make_output = make_output or RecordOutput
            output = make_output(file, name, make_printer, shown, wanted, limit, order)
        try:
            yield output
        except OutputError:
            raise
        except KeyboardInterrupt:
            output.finish()
            if output.is_empty and path is not None:
                emptied(file)
            if not is_summed:
                raise
            say(_interrupted(output, path, if_interrupted, stays=stays))
            raise Interrupted from None
        except MbtoolError as error:
            output.finish()
            if not isinstance(error, InputError):
                raise
            if output.is_empty:
                if path is not None:
                    emptied(file)
                if stays:
                    say(f"{path} stays as it was")
                raise
            broken = error  # The rest cannot be read; records so far are kept.
        else:
            output.finish()
        if is_summed:
            say(f"{output.sentence()}{place}")
    if broken is not None:
        raise broken


def _interrupted(output: RecordOutput, path: str | None, if_empty: str, *, stays: bool) -> str:
    """Return the line that says that Ctrl-C ended the command, and how much was written.

    `path` is the output file, None for standard output. With `stays`, an older file was kept.
    `if_empty` is the line if nothing was written.
    """
    if stays:
        return f"interrupted; {path} stays as it was"
    if output.is_empty:
        return if_empty
    if path is None:
        return f"interrupted; so far {output.sentence()}"
    return f"interrupted; {path} holds only what was read so far: {output.sentence()}"


@contextmanager
def opened(
    path: str | None,
    demand_inputs: Callable[[], None],
    *,
    is_kept: bool = False,
    overwrite: bool = False,
    in_place: bool = False,
) -> Iterator[tuple[TextIO, str]]:
    """Open a file or standard output; yield it with its name for messages.

    The arguments mean the same as those of `open_output`. Raises UsageError if the file cannot be
    written, OutputError if standard output is closed, and the errors of `demand_inputs` and
    `demand_new`.
    """
    if path is None and not is_kept:
        demand_standard_output()
    demand_inputs()
    demand_new(path, overwrite=overwrite)
    with open_file(path, in_place=in_place) as file:
        yield file, path or _STANDARD_OUTPUT_NAME


def demand_standard_output() -> None:
    """Raise OutputError if standard output is closed."""
    if sys.__stdout__ is None:
        raise OutputError(
            f"{_STANDARD_OUTPUT_NAME}: closed, so what goes there is lost; redirect it to a file"
        )


def say_if_empty(reading: Reading) -> None:
    """Print the reason if the files had no transaction and no event.

    Raises InputError if they had only events about data that cannot be decoded.
    """
    reading.demand_readable()
    if reading.why_empty is not None:
        say(reading.why_empty)


def say_troubles(judgement: Judgement) -> None:
    """Print the worst troubles to standard error, a line for each; nothing if there is none."""
    from mbtool.views.trouble_lines import trouble_lines

    if judgement.troubles:
        for line in trouble_lines(judgement):
            say(line.text)


@contextmanager
def as_output_error(name: str) -> Iterator[None]:
    """Turn an OSError in the context, such as a full disk, into an OutputError.

    `name` is that of the output, for the message. A BrokenPipeError passes unchanged.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"{name}: cannot be written: {reason_unwritten(name, error)}") from error


@contextmanager
def verdict_kept(is_no: Callable[[], bool]) -> Iterator[None]:
    """Keep exit code 1 for findings or differences, even if the reader closes the output early.

    A reader such as `head` does that. `is_no` returns True if there are findings or differences.
    """
    try:
        yield
    except BrokenPipeError:
        if not is_no():
            raise
        raise typer.Exit(exit_codes.NO) from None
