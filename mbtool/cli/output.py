"""Where records go: a table, JSON lines or CSV; to standard output or a file."""

from __future__ import annotations

import sys
from contextlib import ExitStack, contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from mbtool.core import MbtoolError, UsageError, WireEvent
from mbtool.workflows.counting import CONNECTION_EVENTS, Tally

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.devices import NamedTransaction, Profile
    from mbtool.workflows.decoding import Record
    from mbtool.workflows.where import Where

    ProfileFor = Callable[[NamedTransaction], Profile | None]


class Format(StrEnum):
    """How records are printed."""

    TABLE = "table"
    JSONL = "jsonl"
    CSV = "csv"


class EventChoice(StrEnum):
    """Which wire events are printed."""

    NONE = "none"
    TROUBLE = "trouble"
    ALL = "all"


_SUFFIXES = {".jsonl": Format.JSONL, ".csv": Format.CSV, ".txt": Format.TABLE}


class Output:
    """Prints what is wanted of the records it is given, and counts it."""

    def __init__(
        self,
        file: TextIO,
        format_: Format,
        events: EventChoice,
        profile_for: ProfileFor,
        wanted: Where,
        limit: int | None,
    ) -> None:
        self._file = file
        self._events = events
        self._wanted = wanted
        self._limit = limit
        self._tally = Tally()
        self._print, self._end = _printer(file, format_, profile_for)

    @property
    def on_terminal(self) -> bool:
        return self._file.isatty()

    @property
    def is_full(self) -> bool:
        """Whether as many transactions as wanted have been printed."""
        return self._limit is not None and self._tally.transactions >= self._limit

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been printed."""
        return not self._tally.transactions and not self._tally.events

    def add(self, record: Record) -> None:
        """Print a record if it is wanted."""
        if self._wants(record):
            self._tally.add(record)
            self._print(record, self._tally.transactions)

    def wait(self) -> bool:
        """Show all that has been printed, before there is a pause. Always true."""
        self._end()
        self._file.flush()
        return True

    def finish(self) -> str:
        """Print the rest; the answer is a sentence about all of it."""
        self.wait()
        return self._tally.sentence()

    def _wants(self, record: Record) -> bool:
        if not isinstance(record, WireEvent):
            return self._wanted(record)
        if self._events is EventChoice.TROUBLE:
            return record.kind not in CONNECTION_EVENTS
        return self._events is EventChoice.ALL


@contextmanager
def open_output(
    path: str | None,
    format_: Format | None,
    events: EventChoice | None,
    profile_for: ProfileFor,
    wanted: Where,
    limit: int | None = None,
) -> Iterator[Output]:
    """An output that is finished, and talked about, when its context ends. Raises UsageError."""
    from mbtool.cli.talk import say

    suffix = Path(path).suffix.lower() if path is not None else ""
    chosen = format_ or _SUFFIXES.get(suffix, Format.TABLE)
    shown = events or (EventChoice.TROUBLE if chosen is Format.TABLE else EventChoice.NONE)
    with _open_file(path) as file:
        output = Output(file, chosen, shown, profile_for, wanted, limit)
        try:
            yield output
        except MbtoolError:
            sentence = output.finish()
            if not output.is_empty:
                say(sentence)
            raise
        else:
            sentence = output.finish()
            say(sentence if path in (None, "-") else f"{sentence} -> {path}")


@contextmanager
def _open_file(path: str | None) -> Iterator[TextIO]:
    if path is None or path == "-":
        yield sys.stdout
        return
    with ExitStack() as stack:
        try:
            file = stack.enter_context(Path(path).open("w", encoding="utf-8", newline=""))
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from error
        yield file


def _printer(
    file: TextIO, format_: Format, profile_for: ProfileFor
) -> tuple[Callable[[Record, int], None], Callable[[], None]]:
    """What prints a record with its number, and what prints the rest."""
    match format_:
        case Format.JSONL:
            from mbtool.logs.exports import event_to_jsonl, transaction_to_jsonl

            def print_line(record: Record, _: int) -> None:
                if isinstance(record, WireEvent):
                    file.write(event_to_jsonl(record).decode())
                else:
                    file.write(transaction_to_jsonl(record).decode())

            return print_line, lambda: None
        case Format.CSV:
            from mbtool.logs.exports import CsvWriter

            writer = CsvWriter(file)

            def print_row(record: Record, _: int) -> None:
                if not isinstance(record, WireEvent):
                    writer.write(record)

            return print_row, lambda: None
        case Format.TABLE:
            return _table_printer(file, profile_for)


def _table_printer(
    file: TextIO, profile_for: ProfileFor
) -> tuple[Callable[[Record, int], None], Callable[[], None]]:
    from rich.console import Console

    from mbtool.views.cells import day, event_row, transaction_row
    from mbtool.views.transaction_table import TransactionTable

    table = TransactionTable(Console(file=file))

    def show(one: NamedTransaction, number: int) -> None:
        row = transaction_row(number, one, profile_for(one))
        table.add(row, day(one.start_ns))

    def print_record(record: Record, number: int) -> None:
        if isinstance(record, WireEvent):
            table.add(event_row(record), day(record.ts_ns))
        else:
            show(record, number)

    return print_record, table.flush
