"""What passes between a process that decodes blocks, and those that print them."""

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
"""In place of the descriptor of a Parquet file, if lines are printed."""
SIZE = Struct("<Q")
"""The size, in bytes, of a pickled reply; it stands before the reply."""


@dataclass(slots=True)
class PrintedBlock:
    """What became of a block."""

    counts: TransactionCounts
    made: list[NamedTransaction] = field(default_factory=list)
    """The transactions of unusual form among those that were read as arrays."""
    text: str = ""
    """The lines; empty if they went to a file."""
    text_bytes: int = 0
    """The size of the text as UTF-8, in the file in memory."""


def write_pieces(descriptor: int, pieces: Sequence[ReadableBuffer]) -> list[int]:
    """Write pieces to the beginning of a file, one behind the other; return their sizes."""
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
    """Read pieces of some sizes from the beginning of a file."""
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
