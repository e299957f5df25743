"""The child process that makes lines of text or Parquet of decoded transactions, while its parent
decodes the next packets: `python -m mbtool.workflows.shared.block_printing`.
"""

# The parent (block_processes.py) decodes blocks of packets; this process prints their transactions
# as lines or Parquet. Its arguments are the format, the descriptor of the Parquet file (or -), and
# the descriptors of files in memory. The parent writes a block into one of these files, and then a
# line to this process's standard input: the index of the file, and the sizes of the pieces in it.
# The reply on standard output is a pickled object behind its size. Printed lines are passed back in
# the same file in memory.
#
# When standard input ends, also because the parent was killed, the Parquet file is completed.

from __future__ import annotations

import os
import pickle
import sys
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from mbtool.columns.table_counts import TransactionCounts, table_counts
from mbtool.core import InputError, WireEvent
from mbtool.logs import csv_line, transaction_to_jsonl
from mbtool.modbus import Outcome, Verdict
from mbtool.workflows.shared.block_pieces import SIZE, PrintedBlock, read_pieces, write_pieces

if TYPE_CHECKING:
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.devices import NamedTransaction

PARQUET = "parquet"


class _BlockPrinter(Protocol):
    def print(self, block: DecodedBlock) -> PrintedBlock: ...
    def close(self) -> None: ...


def main() -> None:
    kind, output, *slots = sys.argv[1:]
    files = [int(one) for one in slots]
    replies = os.fdopen(os.dup(1), "wb")
    try:
        printer = _ParquetBlocks(int(output)) if kind == PARQUET else _LineBlocks(kind)
        _print_all(printer, files, replies.write, replies.flush)
        printer.close()
    except BrokenPipeError:
        return  # The parent has ended.
    except (OSError, InputError) as error:
        _reply(error, replies.write)
    replies.close()


def _print_all(
    printer: _BlockPrinter,
    files: list[int],
    write: Callable[[bytes], object],
    flush: Callable[[], None],
) -> None:
    for line in sys.stdin.buffer:
        number, *sizes = map(int, line.split())
        body, *buffers = read_pieces(files[number], sizes)
        printed = printer.print(pickle.loads(body, buffers=buffers))
        data = printed.text.encode("utf-8", "surrogatepass")
        printed.text, printed.text_bytes = "", write_pieces(files[number], [data])[0]
        _reply(printed, write)
        flush()


def _reply(reply: PrintedBlock | Exception, write: Callable[[bytes], object]) -> None:
    data = pickle.dumps(reply, pickle.HIGHEST_PROTOCOL)
    write(SIZE.pack(len(data)) + data)


class _ParquetBlocks:
    """Writes the transactions of each block to a Parquet file."""

    def __init__(self, descriptor: int) -> None:
        from mbtool.columns.block_table import BlockTables
        from mbtool.columns.parquet import ParquetRows

        self._tables = BlockTables()
        self._file = os.fdopen(descriptor, "wb")
        self._rows = ParquetRows(self._file)

    def print(self, block: DecodedBlock) -> PrintedBlock:
        batch = self._tables.batch(block)
        self._rows.write_table(batch.table)
        return PrintedBlock(table_counts(batch.table), batch.made)

    def close(self) -> None:
        self._rows.close()
        self._file.close()


class _LineBlocks:
    """Prints the transactions of each block as lines of jsonl or CSV."""

    def __init__(self, kind: str) -> None:
        from mbtool.columns.plain_lines import BlockLines

        self._lines = BlockLines(*_LINES[kind])

    def print(self, block: DecodedBlock) -> PrintedBlock:
        batch = self._lines.batch(block)
        rows = [one for one in batch.records if not isinstance(one, WireEvent)]
        outcomes: Counter[Outcome] = Counter(one.outcome for one in rows) + batch.outcomes
        ambiguous = sum(Verdict.AMBIGUOUS in one.verdicts for one in rows)
        counts = TransactionCounts(outcomes, ambiguous)
        return PrintedBlock(counts, batch.made, batch.text)

    def close(self) -> None:
        pass


_LINES: dict[str, tuple[Callable[[NamedTransaction], str], str]] = {
    "jsonl": (lambda one: transaction_to_jsonl(one).decode(), ","),
    "csv": (csv_line, " "),
}
"""For each format, the function that makes the line of a transaction, and the text that stands
between the values of a list in that line."""


if __name__ == "__main__":
    main()
