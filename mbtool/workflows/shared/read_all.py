"""Reads files to their end, also where one is cut or damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from mbtool.core import CutError, DamageError
from mbtool.workflows.shared.reading import Reading

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record

Watch = Callable[[Reading, "Iterator[Record]"], "Iterator[Record]"]
"""Passes records on, and may show how much of the files has been read."""


def unwatched(_: Reading, records: Iterator[Record]) -> Iterator[Record]:
    return records


def read_all(
    reading: Reading,
    on_remark: Callable[[str], None],
    told_as: str = "{error}",
    watch: Watch = unwatched,
) -> Iterator[Record]:
    """Give all records; those of a file that is cut or damaged as far as they can be read.

    `on_remark` gets a line if a file is cut or damaged: `told_as`, with its error put in. In any
    case it then gets a line for each thing that a user should know of the files. Raises InputError
    for a file that cannot be read at all, UsageError if the options do not fit the file.
    """
    try:
        yield from watch(reading, reading.records())
    except (CutError, DamageError) as error:
        on_remark(told_as.format(error=error))
    for remark in reading.remarks:
        on_remark(remark)
