"""Makes a pyarrow table from transaction objects, such as those that the Decoder made packet by
packet.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa

from mbtool.columns.schema import SCHEMA
from mbtool.core import InputError

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction


def row_table(transactions: Sequence[NamedTransaction]) -> pa.Table:
    """Return a table with a row per transaction and the columns of schema.py.

    Raises InputError for a number that its column cannot hold. The decoder gives no such number,
    but a log written by another program may.
    """
    rows = [_row(one) for one in transactions]
    columns = [_column(field, [row[field.name] for row in rows]) for field in SCHEMA]
    return pa.Table.from_arrays(columns, schema=SCHEMA)


def _row(transaction: NamedTransaction) -> dict[str, Any]:
    row = msgspec.structs.asdict(transaction)
    row["time"] = transaction.start_ns // 1000
    row["points"] = [msgspec.structs.asdict(point) for point in transaction.points]
    return row


def _column(field: pa.Field, values: list[Any]) -> pa.Array:
    try:
        if pa.types.is_dictionary(field.type):
            return pa.array(values, pa.string()).dictionary_encode()
        return pa.array(values, field.type)
    except (pa.ArrowInvalid, pa.ArrowTypeError, OverflowError) as error:
        raise InputError(f"{field.name}: a value does not fit its column: {error}") from error


def whole_table(parts: Sequence[pa.Table]) -> pa.Table:
    """Join tables with the columns of schema.py, in the order given. No tables give an empty
    one.
    """
    return pa.concat_tables(parts) if parts else SCHEMA.empty_table()
