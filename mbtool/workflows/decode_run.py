"""Decodes a run of files of a rotated capture into a Parquet file for each: a task of decode.

Run as a program, it answers tasks on standard input: a line of hexadecimal digits for each.
"""

# A transaction is in the Parquet of the file whose packets complete it; so the Parquet of a file
# depends on the files before it, not on those behind it. The file before the run is read first,
# without printing: the decoder then knows its connections and open requests. A request that is
# still open at the end of the last file is
#
#     left to the next run, which reads the last file again, if the capture goes on
#     in a Parquet file of its own (NAME.open.parquet), if not: it is deleted as soon as the capture
#     goes on with a further file
#
# Each file's Parquet and record are written when the file is done, and replace older ones. So a
# run that is begun again, here or elsewhere, writes the same files.
#
# Memory: a block of packets, as for a single file. Files of an object store are copied to the disk
# for as long as the run lasts.

from __future__ import annotations

import sys
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import msgspec

from mbtool.cluster.plan import FileRun, InputFile, parquet_name
from mbtool.cluster.store import OutputStore, fetch
from mbtool.columns.file_tables import split_by_file, with_file_names
from mbtool.columns.parquet import ROWS, ParquetRows
from mbtool.columns.row_table import row_table
from mbtool.columns.schema import SCHEMA
from mbtool.core import CutError, DamageError, InputError, MbtoolError, WireEvent
from mbtool.sources.files import open_capture, shown_name
from mbtool.workflows.shared.column_reading import ColumnReading
from mbtool.workflows.shared.part_reading import PartReading
from mbtool.workflows.shared.reading_choice import column_reading
from mbtool.workflows.shared.reading_options import ReadingOptions

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.columns.schema import Table
    from mbtool.devices import NamedTransaction
    from mbtool.workflows.shared.file_results import FileResults

RECORDS = "_mbtool"
"""The folder of the records, in the output."""
DONE, FAILED = ".json", ".failed.json"
"""The ends of the names of records; FAILED for a file that was not read, or not to its end."""
OPEN = ".open.parquet"


class DecodeTask(msgspec.Struct, frozen=True, kw_only=True):
    """A run of files, and what to make of it."""

    run: FileRun
    output: str
    """The folder or prefix for all results."""
    folders: list[str]
    """For each file, its folder in the output."""
    records: list[str]
    """For each file, the name of its record, without the ending."""
    older: list[list[str]]
    """For each file, the names of older records of the same path."""
    previous_folder: str = ""
    ports: list[int] = []
    rtu_ports: list[int] = []
    any_port: bool = False


class FileOutcome(msgspec.Struct, kw_only=True, omit_defaults=True):
    """What became of a file; also its record."""

    path: str
    size: int
    changed_ns: int
    sha256: str = ""
    parquet: str = ""
    """The name of its Parquet file in the output; empty if there is none."""
    transactions: int = 0
    open_requests: int = 0
    """Those of the transactions that are in NAME.open.parquet."""
    error: str = ""
    """Why it was not read, or not to its end; empty if it was."""


def decode_run(task: bytes) -> bytes:
    """Decode a run: a DecodeTask as JSON; returns a list of FileOutcome as JSON."""
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
    """A file of a run, ready to be read."""

    file: InputFile
    number: int
    """Its index in the run; -1 for the file before the run."""
    path: str
    """Where it is read."""
    digest: str


class _RunWork:
    """Decodes the files of one run."""

    def __init__(self, task: DecodeTask, folder: Path) -> None:
        self._task = task
        self._folder = folder
        self._output = OutputStore(task.output)
        self._begun = folder / "begun.parquet"
        """The Parquet of the file that is being read."""
        self._rows: ParquetRows | None = None
        self._done: set[int] = set()
        self.outcomes = [
            FileOutcome(path=one.path, size=one.size, changed_ns=one.changed_ns)
            for one in task.run.files
        ]

    def do(self) -> None:
        """Decode all files. Raises MbtoolError if results cannot be written."""
        inputs = self._inputs()
        while inputs:
            inputs = self._decode(inputs)

    def fail(self, why: str) -> None:
        """Say of the files that are not done why they are not."""
        for number, outcome in enumerate(self.outcomes):
            if number not in self._done:
                outcome.error = outcome.error or why

    def _inputs(self) -> list[_Input]:
        """The files that can be read; of the others, note why not."""
        run = self._task.run
        files = [*enumerate(run.files)]
        if run.previous is not None:
            files.insert(0, (-1, run.previous))
        inputs = []
        for number, file in files:
            try:
                name = file.path.rpartition("/")[2] or "file"
                copy = self._folder / f"{number + 1}" / name
                copy.parent.mkdir()
                path, digest = fetch(file, copy)
            except InputError as error:  # It may be there the next time, so there is no record.
                if number >= 0:
                    self.outcomes[number].error = str(error)
                continue
            one = _Input(file, number, path, digest)
            try:
                open_capture(path).close()
            except InputError as error:
                if number >= 0:
                    self._record(one, _renamed(str(error), [one]))
                continue
            inputs.append(one)
        return inputs

    def _decode(self, inputs: list[_Input]) -> list[_Input]:
        """Decode files by one decoder; return those behind one that cannot be read further."""
        task = self._task
        options = ReadingOptions(ports=task.ports, rtu_ports=task.rtu_ports, any_port=task.any_port)
        paths = [one.path for one in inputs]
        reading = column_reading(paths, options) or PartReading(paths, options)
        results = reading.results
        at, why = 0, None
        try:
            for read, table in _tables(reading):
                while at < min(read, len(inputs) - 1):
                    self._finish(inputs, at, results)
                    at += 1
                if read == len(inputs):
                    self._write_open(inputs, table)
                else:
                    self._write(inputs, at, table)
        except (CutError, DamageError):
            pass  # The results of the files have it.
        except InputError as error:
            why = str(error)
        last = len(inputs) - 1 if why is None else results.files_read
        for one in range(at, last + 1):
            self._finish(inputs, one, results, why if one == last else None)
        return inputs[last + 1 :]

    def _write(self, inputs: list[_Input], at: int, table: Table) -> None:
        """Add a table to the Parquet of a file; that of the file before the run has none."""
        if inputs[at].number < 0:
            return
        if self._rows is None:
            self._rows = ParquetRows(self._begun.open("wb"))
        self.outcomes[inputs[at].number].transactions += table.num_rows
        self._rows.write_table(with_file_names(table, _names(inputs)))

    def _write_open(self, inputs: list[_Input], table: Table) -> None:
        """Take the requests that were open at the end of the last file."""
        last, run = inputs[-1], self._task.run
        of_last, earlier = split_by_file(table, shown_name(last.path))
        self._write(inputs, len(inputs) - 1, earlier)
        if not of_last.num_rows or last.number < 0:
            return
        if run.is_end or last.number < len(run.files) - 1:
            path = self._folder / "open.parquet"
            with path.open("wb") as file, closing(ParquetRows(file)) as rows:
                rows.write_table(with_file_names(of_last, _names(inputs)))
            self._output.put(self._open_name(last), path)
            outcome = self.outcomes[last.number]
            outcome.transactions += of_last.num_rows
            outcome.open_requests += of_last.num_rows

    def _finish(
        self, inputs: list[_Input], at: int, results: FileResults, why: str | None = None
    ) -> None:
        """Complete the Parquet of a file, and write its record."""
        one = inputs[at]
        if one.number < 0:
            return
        self._write(inputs, at, SCHEMA.empty_table())
        assert self._rows is not None
        self._rows.close()
        self._rows = None
        outcome = self.outcomes[one.number]
        outcome.sha256, outcome.parquet = one.digest, f"{self._name(one)}.parquet"
        self._output.put(outcome.parquet, self._begun)
        if not outcome.open_requests:
            self._output.delete(self._open_name(one))
        if at:  # Its open requests are those of this file.
            self._output.delete(self._open_name(inputs[at - 1]))
        error = results.error_of(one.path)
        text = why if error is None else str(error)
        self._record(one, "" if text is None else _renamed(text, inputs))

    def _record(self, one: _Input, error: str) -> None:
        """Write the record of a file, and delete what older ones tell of."""
        outcome = self.outcomes[one.number]
        outcome.error = error
        name = f"{self._task.records[one.number]}{FAILED if error else DONE}"
        self._output.put(f"{RECORDS}/{name}", msgspec.json.encode(outcome))
        for older in self._task.older[one.number]:
            if older != name:
                self._forget(older, outcome.parquet)
        self._done.add(one.number)

    def _forget(self, record: str, kept: str) -> None:
        """Delete an older record, and its Parquet if that is another one."""
        with suppress(FileNotFoundError, msgspec.DecodeError):
            data = self._output.read(f"{RECORDS}/{record}")
            parquet = msgspec.json.decode(data, type=FileOutcome).parquet
            if parquet not in ("", kept):
                self._output.delete(parquet)
                self._output.delete(parquet.removesuffix(".parquet") + OPEN)
        self._output.delete(f"{RECORDS}/{record}")

    def _name(self, one: _Input) -> str:
        """The name of a file's Parquet in the output, without its ending."""
        task = self._task
        folder = task.previous_folder if one.number < 0 else task.folders[one.number]
        return f"{folder}/{parquet_name(one.file.path, one.digest)}".lstrip("/")

    def _open_name(self, one: _Input) -> str:
        return self._name(one) + OPEN


def _tables(reading: PartReading) -> Iterator[tuple[int, Table]]:
    """The transactions of files; before each table, how many files were read when it was made."""
    if isinstance(reading, ColumnReading):
        for batch in reading.batches():
            yield reading.results.files_read, batch.table
        return
    rows: list[NamedTransaction] = []
    read = 0
    try:
        for record in reading.records():
            if rows and (reading.results.files_read != read or len(rows) == ROWS):
                yield read, row_table(rows)
                rows = []
            read = reading.results.files_read
            if not isinstance(record, WireEvent):
                rows.append(record)
    except InputError:
        yield read, row_table(rows)
        raise
    yield read, row_table(rows)


def _names(inputs: Sequence[_Input]) -> dict[str, str]:
    """The name of each file as the user gave it, by the name it is read by."""
    return {shown_name(one.path): shown_name(one.file.path) for one in inputs}


def _renamed(text: str, inputs: Sequence[_Input]) -> str:
    for name, given in _names(inputs).items():
        text = text.replace(name, given)
    return text


def main() -> None:
    """Answer tasks until standard input ends."""
    for line in sys.stdin.buffer:
        sys.stdout.buffer.write(decode_run(bytes.fromhex(line.decode())).hex().encode() + b"\n")
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
