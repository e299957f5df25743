"""The data that the decoding process exchanges with the processes that print decoded blocks."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from struct import Struct
from typing import TYPE_CHECKING

from mbtool.columns.table_counts import TransactionCounts
from mbtool.devices import NamedTransaction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from _typeshed import ReadableBuffer

NO_FILE = "-"
"""The argument in place of a Parquet file's descriptor, if the process makes lines of text."""
SIZE = Struct("<Q")
"""The header of a pickled reply: its size in bytes."""


@dataclass(slots=True)
class PrintedBlock:
    """The reply of a printing process: the lines of a block of packets, and its counts."""

    counts: TransactionCounts
    made: list[NamedTransaction] = field(default_factory=list)
    """Those transactions that arrays could not print, because they are no common reads or writes.
    A NamedTransaction was made of each to print it."""
    text: str = ""
    """The lines of all transactions; empty if the process writes a Parquet file."""
    text_bytes: int = 0
    """The size of `text` as UTF-8, in bytes; the process passes it in a file in memory."""


def write_pieces(descriptor: int, pieces: Sequence[ReadableBuffer]) -> list[int]:
    """Write `pieces` in a row from the beginning of a file; return their sizes in bytes."""
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
    """Read from the beginning of a file, one after the other, pieces of the given sizes (bytes)."""
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
