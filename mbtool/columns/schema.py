"""The columns of a table of transactions: their names and pyarrow types. docs/log-format.md
explains each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyarrow as pa
from msgspec import inspect

from mbtool.devices import NamedTransaction
from mbtool.devices.transaction_fields import (
    TIME,
    column_names,
    transaction_fields,
    without_none,
)

if TYPE_CHECKING:
    import msgspec

Table = pa.Table

TIME_TYPE = pa.timestamp("us", "UTC")
"""The type of a column of times. Nanoseconds would be exact, but DuckDB calculates only with
microseconds, and Spark and Python have no finer type (docs/decisions/0027)."""

WORD = pa.dictionary(pa.int32(), pa.string())
"""The type of a column of text with few different values: each different text is stored once, and
each row has its index."""
_POINT = pa.struct(
    [
        ("name", pa.string()),
        ("reference", pa.string()),
        ("value", pa.float64()),
        ("text", pa.string()),
        ("unit", pa.string()),
        ("written", pa.bool_()),
    ]
)

_SIZES = {0xFF: pa.uint8(), 0xFFFF: pa.uint16(), 2**63 - 1: pa.int64()}
"""The type of a number by the greatest number that it can be."""
_OTHERS = {32: pa.uint32(), 64: pa.uint64()}
"""The type of a number that has no greatest value, by its size in bits."""


def _type(type_: inspect.Type, bits: int = 64) -> pa.DataType:
    """Return the type of the column for a field of a transaction."""
    match without_none(type_):
        case inspect.IntType(le=int(le)):
            return _SIZES[le]
        case inspect.IntType():
            return _OTHERS[bits]
        case inspect.FloatType():
            return pa.float64()
        case inspect.BytesType():
            return pa.binary()
        case inspect.ListType(item_type=inspect.StructType()):
            return pa.list_(_POINT)
        case inspect.ListType(item_type=inspect.StrType() | inspect.EnumType()):
            return pa.list_(pa.string())
        case inspect.ListType(item_type=item):
            return pa.list_(_type(item))
        case inspect.StrType() | inspect.EnumType():
            return WORD
        case other:
            raise TypeError(f"{other} has no type of a column")


def schema_of(cls: type[msgspec.Struct] = NamedTransaction) -> pa.Schema:
    """Return the columns of a table of transactions of a class."""
    types = {one.name: _type(one.type, one.bits) for one in transaction_fields(cls)}
    types[TIME] = TIME_TYPE
    return pa.schema([(name, types[name]) for name in column_names("table", cls)])


SCHEMA = schema_of()
"""The columns in order. Other programs rely on them: a column never changes its name, type or
meaning, and new columns come last."""
