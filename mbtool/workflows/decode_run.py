"""Decodes several files of a rotated capture, with a Parquet file as the result for each.

Run as a program, it reads a line of standard input for each task: a DecodeTask as JSON, written in
hexadecimal digits. It answers each with a line of standard output: the list of the task's
FileOutcomes, one for each file, as JSON in hexadecimal digits.
"""

# A job (decode_job.py) divides its files into runs: consecutive files that one process decodes. The
# files just before and after a run are read, too, so that the decoder knows the connections that
# are open at the beginning of the run, and finds the responses to its last requests. A transaction
# belongs to the file that has its first packet. So each transaction is in exactly one result,
# however the files are divided into runs.
#
# For each file, a record (a FileOutcome as JSON) in the output says that the file was decoded. The
# Parquet files and records are written when the whole run is decoded, and replace older ones. So a
# run that is repeated writes the same files.
#
# Memory: a block of packets, as for a single file. Files of an object store are copied to the disk
# until the run ends.

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, BinaryIO

import msgspec

from mbtool.cluster.plan import NEAR_BYTES, FileRun, InputFile, parquet_name
from mbtool.cluster.store import OutputStore, fetch
from mbtool.columns.file_tables import tables_by_file, with_file_names
from mbtool.columns.parquet import ROWS, ParquetRows
from mbtool.columns.row_table import row_table
from mbtool.core import CutError, DamageError, InputError, MbtoolError, WireEvent
from mbtool.sources.files import open_capture, shown_name
from mbtool.workflows.shared.column_reading import ColumnReading
from mbtool.workflows.shared.reading import Reading
from mbtool.workflows.shared.reading_choice import column_reading
from mbtool.workflows.shared.reading_options import ReadingOptions

if TYPE_CHECKING:
    from mbtool.columns.schema import Table
    from mbtool.devices import NamedTransaction

RECORDS = "_mbtool"
"""The folder in the output that has the records, which say which files were decoded."""
DONE, FAILED = ".json", ".failed.json"
"""The suffixes of records: DONE for a file that was read to its end, FAILED for any other."""


class DecodeTask(msgspec.Struct, frozen=True, kw_only=True):
    """Consecutive files that one process decodes, and the places to which it writes the results."""

    run: FileRun
    output: str
    """The folder for all results, or their prefix in an object store."""
    folders: list[str]
    """For each file, the folder of its Parquet file, relative to `output`."""
    records: list[str]
    """For each file, the name (without suffix) of the record to write when the file was decoded."""
    older: list[list[str]]
    """For each file, the names of the records that earlier jobs wrote for the same path. They
    are deleted or replaced once the file is decoded."""
    ports: list[int] = []
    rtu_ports: list[int] = []
    any_port: bool = False


class FileOutcome(msgspec.Struct, kw_only=True, omit_defaults=True):
    """The result of decoding one file; written as JSON, it is the record of the file."""

    path: str
    size: int
    changed_ns: int
    sha256: str = ""
    parquet: str = ""
    """The path of the Parquet file made from this file, relative to the output folder; empty if
    there is none."""
    transactions: int = 0
    error: str = ""
    """The error that kept the file from being read, or from being read to its end; empty if it was
    read to its end."""


def decode_run(task: bytes) -> bytes:
    """Decode the files of `task`, a DecodeTask as JSON. Returns the outcomes, one for each file, as
    JSON.
    """
    decoded = msgspec.json.decode(task, type=DecodeTask)
    with TemporaryDirectory(prefix="mbtool-") as folder:
        work = _RunWork(decoded, Path(folder))
        try:
            work.do()
        except (MbtoolError, MemoryError) as error:
            work.fail(str(error) or "memory is short")
        return msgspec.json.encode(work.outcomes)


@dataclass(slots=True)
class _Input:
    """An input file that was opened successfully: one of the task's files, or one just before or
    after them.
    """

    file: InputFile
    number: int | None
    """The index of the file among those of the task. None for a file just before or after these,
    which is read only to know the open connections and late responses."""
    path: str
    """The path from which the file is read: its own, or that of a copy on this machine's disk."""
    digest: str


class _RunWork:
    """Decodes the files of one DecodeTask."""

    def __init__(self, task: DecodeTask, folder: Path) -> None:
        self._task = task
        self._folder = folder
        self._output = OutputStore(task.output)
        self._done: set[int] = set()
        self.outcomes = [
            FileOutcome(path=one.path, size=one.size, changed_ns=one.changed_ns)
            for one in task.run.files
        ]

    def do(self) -> None:
        """Decode all files, and write the results. Raises MbtoolError if results cannot be
        written.
        """
        inputs = self._inputs()
        with ExitStack() as files:
            tables = {
                one.number: _FileTable(files.enter_context(self._parquet(one.number).open("wb")))
                for one in inputs
                if one.number is not None
            }
            left = inputs
            while left:
                left = self._decode(left, tables)
            for table in tables.values():
                table.rows.close()
        for one in inputs:
            if one.number is not None:
                self._write(one, tables[one.number].transactions)

    def fail(self, why: str) -> None:
        """Set the error of all files whose results are not written yet to `why`, unless they have
        one.
        """
        for number, outcome in enumerate(self.outcomes):
            if number not in self._done:
                outcome.error = outcome.error or why
                outcome.parquet, outcome.transactions = "", 0

    def _inputs(self) -> list[_Input]:
        """Return the files that can be read: those of the task, and those just before and after
        them.

        If a file of the task cannot be read, its outcome gets the error.
        """
        run = self._task.run
        inputs = []
        for place, file in enumerate((*run.around[0].before, *run.files, *run.around[-1].after)):
            number = place - len(run.around[0].before)
            is_after = number >= len(run.files)
            is_own = number >= 0 and not is_after
            copy = self._folder / str(place) / (file.path.rpartition("/")[2] or "file")
            copy.parent.mkdir()
            try:
                path, digest = fetch(file, copy, NEAR_BYTES if is_after else None)
            except InputError as error:  # Without a record, the next job tries the file again.
                if is_own:
                    self.outcomes[number].error = str(error)
                continue
            one = _Input(file, number if is_own else None, path, digest)
            try:
                open_capture(path).close()
            except InputError as error:
                if is_own:
                    self.outcomes[number].error = _renamed(str(error), [one])
                    self._record(number)
                continue
            inputs.append(one)
        return inputs

    def _decode(self, inputs: list[_Input], tables: dict[int, _FileTable]) -> list[_Input]:
        """Decode files with one decoder, and add their transactions to `tables`, whose keys are
        indices of the task's files.

        If a file cannot be read, decoding stops there. Returns the files after it, for another
        call.
        """
        task = self._task
        options = ReadingOptions(ports=task.ports, rtu_ports=task.rtu_ports, any_port=task.any_port)
        paths = [one.path for one in inputs]
        reading = column_reading(paths, options, at_least=0) or Reading(paths, options)
        own = {shown_name(one.path): one.number for one in inputs if one.number is not None}
        stop: InputError | None = None
        try:
            for table in _tables(reading):
                for name, some in tables_by_file(table).items():
                    if name in own:
                        tables[own[name]].add(with_file_names(some, _names(inputs)))
        except (CutError, DamageError):
            pass  # `reading.results` has the error.
        except InputError as error:
            stop = error
        read = reading.results.files_read
        for place, one in enumerate(inputs):
            broken = stop if place == read else reading.results.error_of(one.path)
            if broken is not None and one.number is not None:
                self.outcomes[one.number].error = _renamed(str(broken), inputs)
        return inputs[read + 1 :]

    def _write(self, one: _Input, transactions: int) -> None:
        """Copy the finished Parquet file of the input file `one` to the output, and write its
        record. `transactions` is their number in the Parquet file.
        """
        assert one.number is not None
        outcome, folder = self.outcomes[one.number], self._task.folders[one.number]
        outcome.sha256, outcome.transactions = one.digest, transactions
        name = f"{parquet_name(one.file.path, one.digest)}.parquet"
        outcome.parquet = f"{folder}/{name}".lstrip("/")
        self._output.put(outcome.parquet, self._parquet(one.number))
        self._record(one.number)

    def _record(self, number: int) -> None:
        """Write the record of the task's file with this index; delete its older records and their
        Parquet files.
        """
        outcome = self.outcomes[number]
        name = f"{self._task.records[number]}{FAILED if outcome.error else DONE}"
        self._output.put(f"{RECORDS}/{name}", msgspec.json.encode(outcome))
        for older in self._task.older[number]:
            if older != name:
                self._forget(older, outcome.parquet)
        self._done.add(number)

    def _forget(self, record: str, kept: str) -> None:
        """Delete an older record, and the Parquet file that it names unless that path is `kept`."""
        with suppress(msgspec.DecodeError):
            data = self._output.read(f"{RECORDS}/{record}")
            parquet = msgspec.json.decode(data, type=FileOutcome).parquet
            if parquet not in ("", kept):
                self._output.delete(parquet)
        self._output.delete(f"{RECORDS}/{record}")

    def _parquet(self, number: int) -> Path:
        """The temporary path at which the Parquet file of the task's file with this index is
        written.
        """
        return self._folder / f"{number}.parquet"


class _FileTable:
    """Writes the Parquet file of one input file, and counts its transactions."""

    def __init__(self, file: BinaryIO) -> None:
        self.rows = ParquetRows(file)
        self.transactions = 0

    def add(self, table: Table) -> None:
        self.transactions += table.num_rows
        self.rows.write_table(table)


def _tables(reading: Reading) -> Iterator[Table]:
    """Yield the transactions of the files as Arrow tables.

    Raises InputError for a file that cannot be read, is cut or damaged, after the transactions
    before that place.
    """
    if isinstance(reading, ColumnReading):
        for batch in reading.batches():
            yield batch.table
        return
    rows: list[NamedTransaction] = []
    try:
        for record in reading.records():
            if not isinstance(record, WireEvent):
                rows.append(record)
            if len(rows) == ROWS:
                yield row_table(rows)
                rows = []
    except InputError:
        yield row_table(rows)
        raise
    yield row_table(rows)


def _names(inputs: Sequence[_Input]) -> dict[str, str]:
    """The names of the files as the user gave them, by the names under which they are read; the two
    differ for copies.
    """
    return {shown_name(one.path): shown_name(one.file.path) for one in inputs}


def _renamed(text: str, inputs: Sequence[_Input]) -> str:
    for name, given in _names(inputs).items():
        text = text.replace(name, given)
    return text


def main() -> None:
    """Read tasks from standard input, and write their outcomes to standard output, until the input
    ends.

    Each is a line: JSON written in hexadecimal digits.
    """
    for line in sys.stdin.buffer:
        sys.stdout.buffer.write(decode_run(bytes.fromhex(line.decode())).hex().encode() + b"\n")
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
