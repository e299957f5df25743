"""Chooses how files are read: as arrays where that gives the same result, else one by one."""

from __future__ import annotations

import os
from contextlib import suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING

from mbtool.core import InputError
from mbtool.workflows.shared.part_reading import PartReading

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.workflows.shared.column_reading import ColumnReading
    from mbtool.workflows.shared.reading import ReadingOptions


_WORTH_BYTES = 256 * 1024
"""Bytes of a capture from which its arrays save more time than importing numpy takes, for commands
that count: measured with 1500, 3000 and 6000 packets."""


def part_reading(
    paths: Sequence[str], options: ReadingOptions, *, is_filtered: bool = False
) -> PartReading:
    """A pass over files, as arrays where that is possible.

    `is_filtered` is True if some transactions are left out, by what each of them holds.
    """
    if is_filtered or len(paths) != 1:
        return PartReading(paths, options)
    columns = column_reading(paths, options, at_least=_WORTH_BYTES)
    return columns or PartReading(paths, options)


def column_reading(
    paths: Sequence[str], options: ReadingOptions, *, at_least: float = 0
) -> ColumnReading | None:
    """A pass over files as arrays; None if they cannot be read so.

    None also if the files have fewer bytes than `at_least`; compressed ones count ten times.
    """
    if find_spec("numpy") is None or unpacked_bytes(paths) < at_least:
        return None
    from mbtool.workflows.shared.column_reading import ColumnReading, can_read_columns

    with suppress(InputError):  # Reading the file will raise the error.
        if can_read_columns(paths, options):
            return ColumnReading(paths, options)
    return None


def unpacked_bytes(paths: Sequence[str]) -> int:
    """About how many bytes files have once they are unpacked; a pipe counts nothing."""
    return sum(map(_size, paths))


def _size(path: str) -> int:
    """About how many bytes a file has once it is unpacked; 0 if it cannot be told."""
    try:
        size = os.stat(path).st_size
    except (OSError, ValueError):
        return 0
    return size * 10 if path.endswith((".gz", ".zst")) else size
