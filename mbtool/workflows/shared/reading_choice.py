"""Chooses how files are read: as arrays where that gives the same result, else one by one."""

from __future__ import annotations

from contextlib import suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING

from mbtool.core import InputError
from mbtool.workflows.shared.part_reading import PartReading

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.workflows.shared.reading import ReadingOptions


def part_reading(
    paths: Sequence[str], options: ReadingOptions, *, is_filtered: bool = False
) -> PartReading:
    """A pass over files, as arrays where that is possible.

    `is_filtered` is True if some transactions are left out, by what each of them holds.
    """
    if is_filtered or find_spec("numpy") is None:
        return PartReading(paths, options)
    from mbtool.workflows.shared.column_reading import ColumnReading, can_read_columns

    with suppress(InputError):  # Reading the file will raise the error.
        if can_read_columns(paths, options):
            return ColumnReading(paths, options)
    return PartReading(paths, options)
