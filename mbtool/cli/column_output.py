"""Prints the transactions of the array decoder; for large files it uses several processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING

from mbtool.cli.options import Format
from mbtool.cli.progress import with_progress
from mbtool.core import LinkError

if TYPE_CHECKING:
    from mbtool.cli.output import RecordOutput
    from mbtool.cli.printers import TablePrinter
    from mbtool.cli.talk import Interrupt
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.decode.decoder import Record
    from mbtool.workflows.shared.block_processes import BlockProcesses
    from mbtool.workflows.shared.column_reading import ColumnReading

    Note = Callable[[Record], None]

WORTH_PROCESSES = 64 * 1024 * 1024
"""If the unpacked files have fewer bytes than this in total, one process prints them: starting
another one takes longer than it saves."""


def processes_for(files: Sequence[str], jobs: int | None) -> int:
    """Return the number of processes for printing the files.

    That is 1 for small files and on Windows; else `jobs`, or all cores if `jobs` is None.
    """
    from mbtool.workflows.shared.reading_choice import unpacked_bytes

    if sys.platform == "win32" or unpacked_bytes(files) < WORTH_PROCESSES:
        return 1
    return jobs or cores()


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def print_columns(
    columns: ColumnReading, out: RecordOutput, note: Note, interrupt: Interrupt, jobs: int
) -> None:
    """Print all transactions of `columns`, a reading by the array decoder, to `out`.

    `jobs` is the number of processes. `note` gets each record that may be worth a remark: events,
    transactions that were decoded one by one or have an unusual form, and reads of SunSpec models.
    """
    from mbtool.cli.printers import LinesPrinter, TablePrinter

    if isinstance(out.printer, TablePrinter):
        _print_runs(columns, out, out.printer, note, interrupt)
        return
    from mbtool.columns.sunspec_rows import SunSpecReads

    sunspec = SunSpecReads()

    def note_block(block: DecodedBlock) -> None:
        for record in sunspec.records(block):
            note(record)

    columns.on_block = note_block
    with out.as_output_error(), ExitStack() as ended:
        processes = _processes(columns, out, jobs)
        if processes is not None:
            _print_apart(columns, out, note, interrupt, ended.enter_context(processes))
        elif out.takes_tables:
            for batch in with_progress(columns, interrupt.breakable(columns.batches())):
                for record in batch.made:
                    note(record)
                out.add_table(batch.table)
        else:
            printer = out.printer
            assert isinstance(printer, LinesPrinter)
            blocks = columns.lines(printer.line_of, printer.separator)
            for lines in with_progress(columns, interrupt.breakable(blocks)):
                for record in lines.made:
                    note(record)
                out.add_lines(lines)


def _print_runs(
    columns: ColumnReading,
    out: RecordOutput,
    printer: TablePrinter,
    note: Note,
    interrupt: Interrupt,
) -> None:
    """Print a table: transactions of a UsualRun (usual reads and writes, read as arrays) together,
    all others one by one.
    """
    from mbtool.columns.table_counts import TransactionCounts
    from mbtool.decode.usual_run import UsualRun
    from mbtool.views.transaction_table import SAMPLE

    parts = interrupt.breakable(columns.runs(printer.form_of, SAMPLE))
    for part in with_progress(columns, parts):
        if isinstance(part, UsualRun):
            first = out.count(TransactionCounts(part.outcomes))
            with out.as_output_error():
                printer.print_run(first, part)
        else:
            note(part)
            out.add(part)


def _processes(columns: ColumnReading, out: RecordOutput, jobs: int) -> BlockProcesses | None:
    """Start `jobs` processes that turn decoded transactions into output.

    Returns None if `jobs` is 1, if profiles are in use, which these processes do not know, if
    values are written to a second file, or if the system starts no more processes.
    """
    from mbtool.cli.printers import LinesPrinter, ParquetPrinter

    is_alone = isinstance(out.printer, ParquetPrinter) and out.printer.values is not None
    if jobs == 1 or is_alone or any(columns.assignments):
        return None
    from mbtool.workflows.shared.block_processes import BlockProcesses

    with suppress(LinkError):
        if out.takes_tables:
            processes = BlockProcesses(Format.PARQUET.value, jobs, out.file_descriptor)
            out.is_written_elsewhere()
            return processes
        assert isinstance(out.printer, LinesPrinter)
        return BlockProcesses(out.printer.format.value, jobs)
    return None


def _print_apart(
    columns: ColumnReading,
    out: RecordOutput,
    note: Note,
    interrupt: Interrupt,
    processes: BlockProcesses,
) -> None:
    """Decode in this process, and let `processes` turn the transactions into output.

    The processes return text lines, which this process prints; a Parquet file one of them writes.
    """
    is_table = out.takes_tables
    try:
        blocks = interrupt.breakable(processes.printed(columns.decoded()))
        for printed in with_progress(columns, blocks):
            for record in printed.made:
                note(record)
            if not is_table:
                out.add_text(printed.text)
                out.count(printed.counts)
    finally:
        if is_table:  # After an error, the file has what was decoded before.
            out.count(processes.complete())
