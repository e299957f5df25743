"""Prints records (transactions and events) as a table, JSON lines, CSV or Parquet."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING, TextIO

from mbtool.cli.options import Format
from mbtool.core import WireEvent
from mbtool.core.extras import missing_extra
from mbtool.logs import CsvWriter, csv_line, event_to_jsonl, transaction_to_jsonl

if TYPE_CHECKING:
    from mbtool.columns.parquet import ParquetRows, ValuesFile
    from mbtool.columns.schema import Table
    from mbtool.decode.decoder import Record
    from mbtool.decode.usual_run import UsualRun
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.views.table_options import TableOptions
    from mbtool.views.tables import RowForm

    ProfileFor = Callable[[NamedTransaction], Profile | None]


class Printer(ABC):
    """Writes records to a file. Its methods raise OSError if the file cannot be written."""

    @abstractmethod
    def print(self, record: Record, number: int) -> None:
        """Print a record.

        `number` is the number of transactions read up to here, with this one, printed or not.
        """

    @property
    def takes_many(self) -> bool:
        """True if many transactions that the array decoder gives can be printed together."""
        return True

    def pause(self) -> None:  # noqa: B027 - most printers buffer nothing
        """Print buffered rows now, as the next record may take a while."""

    def flush(self) -> None:  # noqa: B027
        """Print buffered rows at the end, after the last record."""


def printer_for(
    format_: Format,
    file: TextIO,
    profile_for: ProfileFor,
    table: TableOptions | None = None,
    values: ValuesFile | None = None,
) -> Printer:
    """Return a printer that writes records to `file` in the format.

    `profile_for` returns the device profile for a transaction; `table` has the options of a table,
    and `values` is a second file for the values, beside a Parquet file.
    """
    match format_:
        case Format.TABLE:
            return TablePrinter(file, profile_for, table)
        case Format.JSONL:
            return _JsonLinesPrinter(file)
        case Format.CSV:
            return _CsvPrinter(file)
        case Format.PARQUET:
            return ParquetPrinter(file, values)
        case Format.IPAL:
            return _IpalPrinter(file)


class TablePrinter(Printer):
    """Prints records as a table. Into a file or pipe, many transactions are printed together by
    `print_run`.
    """

    def __init__(self, file: TextIO, profile_for: ProfileFor, options: TableOptions | None) -> None:
        from mbtool.cli.console import PipeConsole
        from mbtool.views.transaction_table import TransactionTable

        self._profile_for = profile_for
        self._table = TransactionTable(PipeConsole(file=file), options)

    def print(self, record: Record, number: int) -> None:
        profile = None if isinstance(record, WireEvent) else self._profile_for(record)
        self._table.add(number, record, profile)

    @property
    def takes_many(self) -> bool:
        return self._table.takes_runs

    def form_of(self, like: NamedTransaction) -> RowForm:
        """Return the text that the rows of equal requests have in common, made from the example
        `like`.
        """
        return self._table.form_of(like)

    def print_run(self, number: int, run: UsualRun[RowForm]) -> None:
        """Print many transactions together. `number` is the first one's number in the capture, from
        1.
        """
        self._table.add_run(number, run)

    def pause(self) -> None:
        self._table.pause()

    def flush(self) -> None:
        self._table.flush()


class LinesPrinter(Printer):
    """Prints JSON lines or CSV: one line for a transaction, independent of earlier lines.

    So several processes can make lines of one output.
    """

    format: Format
    separator: str
    """The text between two values of a transaction: a comma in JSON, a space in CSV."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    @abstractmethod
    def line_of(self, transaction: NamedTransaction) -> str:
        """Return the text of a transaction's line."""

    def print_lines(self, lines: str) -> None:
        """Print lines that are already made, each with its line end."""
        self._file.write(lines)


class _JsonLinesPrinter(LinesPrinter):
    format = Format.JSONL
    separator = ","

    def line_of(self, transaction: NamedTransaction) -> str:
        return transaction_to_jsonl(transaction).decode()

    def print(self, record: Record, number: int) -> None:
        if isinstance(record, WireEvent):
            self._file.write(event_to_jsonl(record).decode())
        else:
            self._file.write(transaction_to_jsonl(record).decode())


class _CsvPrinter(LinesPrinter):
    format = Format.CSV
    separator = " "

    def __init__(self, file: TextIO) -> None:
        super().__init__(file)
        self._writer = CsvWriter(file)

    def line_of(self, transaction: NamedTransaction) -> str:
        return csv_line(transaction)

    def print(self, record: Record, number: int) -> None:
        if not isinstance(record, WireEvent):
            self._writer.write(record)


class _IpalPrinter(Printer):
    """Prints messages for intrusion detection systems, in the form of IPAL."""

    def __init__(self, file: TextIO) -> None:
        from mbtool.logs.ipal import IpalLines

        self._file = file
        self._lines = IpalLines()

    @property
    def takes_many(self) -> bool:
        return False

    def print(self, record: Record, number: int) -> None:
        if not isinstance(record, WireEvent):
            self._file.write(self._lines.lines(record))


class ParquetPrinter(Printer):
    """Writes transactions to a Parquet file, and their values to another."""

    def __init__(self, file: TextIO, values: ValuesFile | None = None) -> None:
        self._file = file
        self.values = values
        self.is_elsewhere = False
        """True if another process writes the file; then this printer must not close it."""

    @cached_property
    def _rows(self) -> ParquetRows:
        from mbtool.columns.parquet import ParquetRows

        return ParquetRows(self._file.buffer, self.values)

    def print(self, record: Record, number: int) -> None:
        if not isinstance(record, WireEvent):
            self._rows.write(record)

    def print_table(self, table: Table) -> None:
        """Write the transactions of an Arrow table, which has one row for each."""
        self._rows.write_table(table)

    def flush(self) -> None:
        if not self.is_elsewhere:
            self._rows.close()


def demand_columns(what: str = "--format parquet", extra: str = "columns") -> None:
    """Raise UsageError if pyarrow, which Parquet needs, is not installed.

    The error says that `what`, an option, needs mbtool's extra named `extra`.
    """
    if find_spec("pyarrow") is None:
        raise missing_extra(what, extra)
