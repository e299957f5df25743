"""Writes tables of transactions to a Parquet file."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import pyarrow.parquet as pq

from mbtool.columns.row_table import row_table
from mbtool.columns.schema import SCHEMA

if TYPE_CHECKING:
    import pyarrow as pa

    from mbtool.devices import NamedTransaction

ROWS = 65_536
"""So many transactions that come one by one are written together."""


class ParquetRows:
    """A Parquet file that is being written; it is complete once `close` was called."""

    def __init__(self, file: BinaryIO) -> None:
        self._writer = pq.ParquetWriter(file, SCHEMA, compression="zstd")
        self._rows: list[NamedTransaction] = []

    def write(self, transaction: NamedTransaction) -> None:
        """Write a transaction. Raises InputError for a number that its column cannot hold."""
        self._rows.append(transaction)
        if len(self._rows) == ROWS:
            self._write_rows()

    def write_table(self, table: pa.Table) -> None:
        """Write a table with the columns of schema.py."""
        self._write_rows()
        if table.num_rows:
            self._writer.write_table(table)

    def close(self) -> None:
        """Write what is held, and the end of the file."""
        self._write_rows()
        self._writer.close()

    def _write_rows(self) -> None:
        if self._rows:
            rows, self._rows = self._rows, []
            self._writer.write_table(row_table(rows))
