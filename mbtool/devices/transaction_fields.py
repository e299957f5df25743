"""Lists the fields of a transaction, as Transaction and NamedTransaction declare them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from msgspec import inspect

from mbtool.devices.named_transaction import NamedTransaction

if TYPE_CHECKING:
    import msgspec

TIME = "time"
"""A column of CSV and Parquet that is no field: the time of the request, or of the response if
there is no request."""
_TIME_PLACES = {"csv": 31, "table": 31}


class TransactionField(NamedTuple):
    """A field of a transaction."""

    name: str
    type: inspect.Type
    """The type of the field, without None."""
    text: str
    """The description of the field for JSON schemas and docs."""
    places: dict[str, int | None]
    """The places of the field among the columns of CSV (`csv`) and Parquet (`table`); None if it
    comes last."""
    bits: int
    """The size in Parquet of a number that has no greatest value."""


@cache
def transaction_fields(
    cls: type[msgspec.Struct] = NamedTransaction,
) -> Sequence[TransactionField]:
    """Return the fields of a transaction in the order of JSON lines."""
    info = inspect.type_info(cls)
    assert isinstance(info, inspect.StructType)
    return [_field(field.name, field.type) for field in info.fields]


def column_names(form: str, cls: type[msgspec.Struct] = NamedTransaction) -> tuple[str, ...]:
    """Return the names of the columns in order; `form` is `csv` or `table` (Parquet)."""
    fields = transaction_fields(cls)
    places = {one.name: one.places.get(form) for one in fields} | {TIME: _TIME_PLACES[form]}
    last = len(places)
    return tuple(sorted(places, key=lambda name: last if (at := places[name]) is None else at))


def without_none(type_: inspect.Type) -> inspect.Type:
    """Return the type of a field without its description, and without None."""
    while isinstance(type_, inspect.Metadata):
        type_ = type_.type
    if isinstance(type_, inspect.UnionType):
        some = [one for one in type_.types if not isinstance(one, inspect.NoneType)]
        if len(some) == 1:
            return without_none(some[0])
    return type_


def _field(name: str, type_: inspect.Type) -> TransactionField:
    assert isinstance(type_, inspect.Metadata)
    text = (type_.extra_json_schema or {}).get("description", "")
    places = dict(type_.extra or {})
    bits = places.pop("bits")
    return TransactionField(name, without_none(type_), text, places, bits)
