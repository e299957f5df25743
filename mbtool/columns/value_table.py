"""Makes a table of values, one in each row, from a table of transactions.

The rows are those of `PointRow` (api/point_rows.py), which makes them from transaction objects.
"""

# This is the long form: a row has one value of one point at one time, so that a query needs no
# lists. If the profile names values in a transaction, each of these points is a row. Otherwise each
# register or bit is a row, named by its reference.

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mbtool.columns.schema import TIME_TYPE, WORD
from mbtool.devices import Profile, write_reference
from mbtool.modbus import FUNCTIONS, TABLE_FUNCTIONS, Outcome

if TYPE_CHECKING:
    from mbtool.columns.arrays import Bools, Int64s

ProfileNamed = Callable[[str], Profile | None]
"""Returns the profile with a name, such as in the column `device`."""

VALUE_SCHEMA = pa.schema(
    [
        ("time", TIME_TYPE),
        ("time_ns", pa.int64()),
        ("link", WORD),
        ("slave", WORD),
        ("unit", pa.uint8()),
        ("device", WORD),
        ("reference", WORD),
        ("name", WORD),
        ("value", pa.float64()),
        ("text", pa.string()),
        ("unit_of_measure", WORD),
        ("written", pa.bool_()),
        ("master", WORD),
        ("request_ns", pa.int64()),
        ("file", WORD),
    ]
)
"""The columns in order; docs/sql.md explains them. They change as those of schema.py do: never, and
new columns come last."""

_SLICE = 4_096
"""The values of this many transactions are put into a table at one time, which bounds the memory:
they have about 500,000 values if each reads 125 registers."""
_EFFECTIVE = pa.array([Outcome.OK.value, Outcome.LATE.value, Outcome.BROADCAST.value])
_MASK_WRITE, _BOTH = 0x16, 0x17
_WRITING = [code for code, one in FUNCTIONS.items() if one.writes and code != _BOTH]
_PLAIN = [
    code for code in TABLE_FUNCTIONS if code != _MASK_WRITE and FUNCTIONS[code].table is not None
]


def value_tables(table: pa.Table, profile_named: ProfileNamed) -> Iterator[pa.Table]:
    """Yield the values that took effect in `table`, which has the columns of schema.py.

    They come in the order of the transactions; in each, values that were read come first.
    """
    for batch in table.to_batches(max_chunksize=_SLICE):
        yield _values_of(batch, profile_named)


def joined_values(table: pa.Table, profile_named: ProfileNamed) -> pa.Table:
    """Return the values of `value_tables` as one table."""
    parts = list(value_tables(table, profile_named))
    return pa.concat_tables(parts) if parts else VALUE_SCHEMA.empty_table()


def _values_of(batch: pa.RecordBatch, profile_named: ProfileNamed) -> pa.Table:
    effective = pc.is_in(batch["outcome"].cast(pa.string()), value_set=_EFFECTIVE)
    is_effective: Bools = effective.to_numpy(zero_copy_only=False)
    has_points: Bools = _sizes(batch["points"]) > 0
    function: Int64s = batch["function"].cast(pa.int64()).to_numpy()
    is_plain = is_effective & ~has_points & np.isin(function, _PLAIN)
    parts = [_point_columns(batch, is_effective & has_points, function)]
    for written in (False, True):
        values = batch["request_values" if written else "response_values"]
        firsts = batch["address"]
        if written:
            firsts = pc.if_else(pa.array(function == _BOTH), batch["write_address"], firsts)
        is_wanted = (function == _BOTH) | (np.isin(function, _WRITING) == written)
        chosen = is_plain & is_wanted & firsts.is_valid().to_numpy(zero_copy_only=False)
        parts.append(_registers(batch, chosen, values, firsts, profile_named, is_written=written))
    rows = np.concatenate([one["row"].to_numpy() for one in parts])
    written_values = np.concatenate(
        [one["written"].to_numpy(zero_copy_only=False) for one in parts]
    )
    order = pa.array(np.lexsort((written_values, rows)))
    values_of = pa.concat_tables([pa.table(one) for one in parts]).take(order)
    row = values_of["row"].combine_chunks()
    of_row = {name: batch[name].take(row) for name in ("link", "unit", "device", "file")}
    request_ns = batch["request_ns"].take(row)
    time_ns = pc.coalesce(batch["response_ns"].take(row), request_ns)
    columns: dict[str, Any] = {
        **of_row,
        **{name: values_of[name] for name in values_of.column_names},
        "time": pc.divide(time_ns, 1000).cast(TIME_TYPE),
        "time_ns": time_ns,
        "slave": batch["destination"].take(row),
        "master": batch["source"].take(row),
        "request_ns": request_ns,
    }
    return pa.table([_column(columns[one.name], one.type) for one in VALUE_SCHEMA], VALUE_SCHEMA)


def _column(values: Any, type_: pa.DataType) -> Any:
    if pa.types.is_dictionary(type_) and not pa.types.is_dictionary(values.type):
        return values.dictionary_encode()
    return values


def _sizes(lists: pa.ListArray) -> Int64s:
    """Return the number of items of each list; 0 for null."""
    sizes: Int64s = pc.fill_null(pc.list_value_length(lists), 0).cast(pa.int64()).to_numpy()
    return sizes


def _point_columns(batch: pa.RecordBatch, chosen: Bools, function: Int64s) -> dict[str, pa.Array]:
    """Return the points of the chosen transactions."""
    at = np.flatnonzero(chosen)
    points = batch["points"].take(pa.array(at))
    flat = points.flatten()
    row = np.repeat(at, _sizes(points))
    is_both = function[row] == _BOTH
    of_both = pc.fill_null(flat.field("written"), False).to_numpy(zero_copy_only=False)
    return {
        "row": pa.array(row),
        "reference": flat.field("reference"),
        "name": flat.field("name"),
        "value": flat.field("value"),
        "text": flat.field("text"),
        "unit_of_measure": flat.field("unit"),
        "written": pa.array(np.where(is_both, of_both, np.isin(function[row], _WRITING))),
    }


def _registers(
    batch: pa.RecordBatch,
    chosen: Bools,
    lists: pa.ListArray,
    firsts: pa.Array,
    profile_named: ProfileNamed,
    *,
    is_written: bool,
) -> dict[str, pa.Array]:
    """Return the registers or bits of the chosen transactions, named by their references.

    `lists` has the values of all transactions, `firsts` the addresses of their first values.
    """
    at = np.flatnonzero(chosen)
    values = lists.take(pa.array(at))
    sizes = _sizes(values)
    row = np.repeat(at, sizes)
    begins = np.repeat(np.cumsum(sizes) - sizes, sizes)
    first: Int64s = firsts.take(pa.array(row)).cast(pa.int64()).to_numpy()
    address = first + np.arange(len(row)) - begins
    function = batch["function"].cast(pa.int64()).to_numpy()[row]
    device = batch["device"].take(pa.array(row)).indices.fill_null(-1).to_numpy()
    names = batch["device"].dictionary.to_pylist()
    keys = (device.astype(np.int64) + 1) << 40 | function << 32 | address
    kinds, like = np.unique(keys, return_inverse=True)
    profiles = [None, *(profile_named(name) for name in names)]
    references = []
    for key in kinds.tolist():
        table = FUNCTIONS[key >> 32 & 0xFF].table
        assert table is not None
        where = (profiles[key >> 40], table, key & 0xFFFFFFFF)
        references.append(write_reference(*where, writing=is_written))
    reference = pa.array(references, pa.string()).take(pa.array(like))
    flat = values.flatten()
    return {
        "row": pa.array(row),
        "reference": reference,
        "name": reference,
        "value": flat.cast(pa.float64()),
        "text": flat.cast(pa.string()),
        "unit_of_measure": pa.nulls(len(row), pa.string()),
        "written": pa.array(np.full(len(row), is_written)),
    }
