"""The data that the decoding process exchanges with the processes that print decoded blocks."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from struct import Struct
from typing import TYPE_CHECKING

from mbtool.columns.table_counts import TransactionCounts
from mbtool.devices import NamedTransaction

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

NO_FILE = "-"
"""The argument that a printing process gets in place of the file descriptor number of a Parquet
file, if it makes lines of text and so writes no file."""
SIZE = Struct("<Q")
"""The size in bytes of a pickled reply, written before each reply of a printing process."""


@dataclass(slots=True)
class PrintedBlock:
    """The reply of a printing process to one block of packets: the lines of its transactions, and
    their counts.
    """

    counts: TransactionCounts
    made: list[NamedTransaction] = field(default_factory=list)
    """The transactions that are no usual reads or writes, so that the array decoder cannot print
    them. Each was made into a NamedTransaction to print it."""
    text: str = ""
    """The lines of all transactions in the block; empty if the process writes a Parquet file."""
    text_bytes: int = 0
    """The size of `text` as UTF-8, in bytes. The process passes the text itself in a file in
    memory."""

    @property
    def row_count(self) -> int:
        """The number of transactions, for a progress bar."""
        return self.counts.outcomes.total()


def write_pieces(descriptor: int, pieces: Sequence[ReadableBuffer]) -> list[int]:
    """Write `pieces` one after the other to the beginning of the file with this descriptor; return
    their sizes in bytes.
    """
    sizes = []
    at = 0
    for piece in pieces:
        view = memoryview(piece).cast("B")
        sizes.append(len(view))
        while view:
            written = os.pwrite(descriptor, view, at)
            view, at = view[written:], at + written
    return sizes


def read_pieces(descriptor: int, sizes: Sequence[int]) -> list[bytearray]:
    """Read pieces of the given sizes (bytes) one after the other from the beginning of the file
    with this descriptor.
    """
    pieces = [bytearray(size) for size in sizes]
    at = 0
    for piece in pieces:
        view = memoryview(piece)
        while view:
            count = os.preadv(descriptor, [view], at)
            if not count:
                raise EOFError(f"the file in memory ends {len(view)} bytes too early")
            view, at = view[count:], at + count
    return pieces
