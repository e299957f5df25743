"""Changes the names of capture files in tables of transactions, and splits a table by file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc

if TYPE_CHECKING:
    from mbtool.columns.schema import Table

_COLUMNS = ("file", "response_file")
"""The columns with names of capture files."""


def with_file_names(table: Table, names: Mapping[str, str]) -> Table:
    """Return the table with other file names for its transactions.

    `names` maps an old file name to the new one; a name that is not in it stays.
    """
    for column in _COLUMNS:
        place = table.schema.get_field_index(column)
        chunks = [
            pa.DictionaryArray.from_arrays(
                one.indices,
                pa.array(
                    [names.get(each, each) for each in one.dictionary.to_pylist()], pa.string()
                ),
            )
            for one in table[column].chunks
        ]
        field = table.schema.field(place)
        table = table.set_column(place, field, pa.chunked_array(chunks, field.type))
    return table


def tables_by_file(table: Table) -> dict[str, Table]:
    """Return one table per capture file, by the file's name.

    A transaction belongs to the file that has its request, or its response if it has no request. A
    transaction without a file name is left out.
    """
    names = table["file"].cast(pa.string())
    found = [one for one in pc.unique(names).to_pylist() if one is not None]
    if len(found) == 1 and not names.null_count:
        return {found[0]: table}
    return {one: table.filter(pc.equal(names, one)) for one in found}
