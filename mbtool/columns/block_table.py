"""Makes a pyarrow table of the transactions in a block of packets, in the order in which packets
completed them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from mbtool.columns.arrays import Bools, Int64s, Octets, distinct, pieces
from mbtool.columns.column_decoder import DecodedBlock, result_sort_keys
from mbtool.columns.plain_transactions import PlainObjects, RowObjects, origin_fields
from mbtool.columns.row_table import row_table
from mbtool.columns.schema import SCHEMA
from mbtool.columns.usual_values import UsualValues, ValueLists
from mbtool.core import WireEvent
from mbtool.decode.decoder import Record
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus.adu import DirectionBy, Transport
from mbtool.modbus.functions import exception_name
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.columns.plain_rows import PlainRows

# The code below makes a pyarrow table of the transactions that were read from arrays.
#
# The table has a row per transaction. The columns of usual reads and writes (usual_rows.py) are
# computed from the arrays. For every other transaction, an object equal to the Decoder's is made
# first (plain_transactions.py).
#
# The function's name, the reference and the findings of a usual read or write depend only on its
# function, address and quantity. So one transaction object is made for each combination of these
# three, and all rows with this combination take these fields from it.


_EMPTY = (
    "sub_function", "write_address", "write_quantity", "verdicts", "device", "points",
    "response_file", "request_offset", "response_offset", "request_parts_ns", "pair_confidence",
)  # fmt: skip
"""The columns that are null or an empty list in every row that is computed from the arrays."""


class PlainTables:
    """Makes a pyarrow table of those transactions of a block that were read from arrays."""

    def __init__(self, namer: Namer) -> None:
        self._objects = PlainObjects(namer)
        self._names: dict[int, NamedTransaction] = {}
        """An example transaction for each combination of function, address and quantity; the key is
        function << 32 | address << 16 | quantity."""

    def table(self, rows: PlainRows) -> tuple[pa.Table, list[NamedTransaction]]:
        """Return a table of all transactions in `rows`, and a list of those that are not common
        reads or writes, for which objects had to be made.
        """
        usual = UsualValues(rows)
        objects = self._objects.of(rows, usual)
        usual.is_usual &= ~objects.have_profile()
        chosen, others = np.flatnonzero(usual.is_usual), np.flatnonzero(~usual.is_usual)
        made = [*objects.chosen(others)]
        parts = [self._usual_table(rows, usual, chosen, objects)]
        if not made:
            return parts[0], made
        parts.append(row_table(made))
        order = np.argsort(np.concatenate([chosen, others]), kind="stable")
        return pa.concat_tables(parts).take(pa.array(order)), made

    def _usual_table(
        self, rows: PlainRows, usual: UsualValues, chosen: Int64s, objects: RowObjects
    ) -> pa.Table:
        names, name = self._names_of(rows, usual, chosen, objects)
        ends = rows.connection[chosen]
        connections = rows.connections
        origins = [origin_fields(*one) for one in rows.addresses]
        source_macs, destination_macs, response_macs, vlans = zip(*origins, strict=True)
        exception = usual.exception[chosen]
        is_exception = exception >= 0
        codes = np.array(distinct(exception[is_exception]), np.int64)
        columns: dict[str, Any] = {
            "link": _text_column([one.link for one in connections], ends),
            "transport": _text_column([Transport.TCP.value], np.zeros(len(chosen), np.int64)),
            "source": _text_column([str(one.master) for one in connections], ends),
            "destination": _text_column([str(one.slave) for one in connections], ends),
            "unit": rows.unit[chosen],
            "transaction_id": rows.transaction_id[chosen],
            "function": rows.code[chosen],
            "function_name": _text_column([one.function_name for one in names], name),
            "address": usual.address[chosen],
            "quantity": usual.quantity[chosen],
            "request_values": _list(usual.request_values(chosen)),
            "response_values": _list(usual.response_values(chosen)),
            "exception": pa.array(exception, mask=~is_exception).cast(pa.uint8()),
            "exception_name": _text_column(
                [exception_name(code) for code in codes.tolist()],
                np.searchsorted(codes, exception),
                ~is_exception,
            ),
            "outcome": _text_column(
                [Outcome.OK.value, Outcome.EXCEPTION.value], is_exception.astype(np.int64)
            ),
            "request_ns": rows.request_ns[chosen],
            "response_ns": rows.response_ns[chosen],
            "latency_ns": (rows.response_ns - rows.request_ns)[chosen],
            "retries": np.zeros(len(chosen), np.uint32),
            "request_raw": _raw(rows, rows.request_begin[chosen], rows.request_size[chosen]),
            "response_raw": _raw(rows, rows.response_begin[chosen], rows.response_size[chosen]),
            "direction_by": _text_column([DirectionBy.PORT.value], np.zeros(len(chosen), np.int64)),
            "confidence": np.ones(len(chosen)),
            "reference": _words_or_none([one.reference for one in names], name),
            "findings": _lists([one.findings for one in names], name),
            "time": rows.request_ns[chosen] // 1000,
            "file": _text_column([rows.block.file], np.zeros(len(chosen), np.int64)),
            "request_packet": rows.block.first_number + rows.request[chosen],
            "response_packet": rows.block.first_number + rows.response[chosen],
            "source_mac": _words_or_none(source_macs, ends),
            "destination_mac": _words_or_none(destination_macs, ends),
            "response_mac": _words_or_none(response_macs, ends),
            "vlan": pa.array(vlans, pa.uint16()).take(pa.array(ends)),
            **dict.fromkeys(_EMPTY),
        }
        return pa.Table.from_arrays(
            [_column(field, columns[field.name], len(chosen)) for field in SCHEMA],
            schema=SCHEMA,
        )

    def _names_of(
        self, rows: PlainRows, usual: UsualValues, chosen: Int64s, objects: RowObjects
    ) -> tuple[list[NamedTransaction], Int64s]:
        """Return an example transaction for each combination of function, address and quantity in
        the rows with the indices `chosen`, and for each of these rows the index of its example.
        """
        keys = rows.code[chosen] << 32 | usual.address[chosen] << 16 | usual.quantity[chosen]
        kinds, first, like = np.unique(keys, return_index=True, return_inverse=True)
        keys_of = kinds.tolist()
        missing = [place for place, key in enumerate(keys_of) if key not in self._names]
        made = objects.chosen(chosen[first[missing]])
        self._names.update(zip([keys_of[place] for place in missing], made, strict=True))
        return [self._names[key] for key in keys_of], like


def _column(field: pa.Field, values: Any, count: int) -> pa.Array:
    if values is None:
        if pa.types.is_list(field.type):
            return pa.array([[]] * count, field.type)
        return pa.nulls(count, field.type)
    if isinstance(values, np.ndarray):
        return pa.array(values).cast(field.type)
    return values


def _text_column(texts: list[str], indices: Int64s, missing: Bools | None = None) -> pa.Array:
    """Return a column of texts. Row i has the text `texts[indices[i]]`, or null if `missing[i]` is
    True. If `missing` is None, no row has null.
    """
    index = pa.array(
        np.where(missing, 0, indices) if missing is not None else indices, mask=missing
    )
    return pa.DictionaryArray.from_arrays(index.cast(pa.int32()), pa.array(texts, pa.string()))


def _words_or_none(texts: Sequence[str | None], indices: Int64s) -> pa.Array:
    """Return a column of texts. Row i has `texts[indices[i]]`, which is null if it is None."""
    missing = np.array([text is None for text in texts], np.bool_)
    return _text_column([text or "" for text in texts], indices, missing[indices])


def _raw(rows: PlainRows, begins: Int64s, sizes: Int64s) -> pa.Array:
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    data: Octets = pieces(rows.data, begins, sizes)
    buffers = [None, pa.py_buffer(offsets), pa.py_buffer(data)]
    return pa.Array.from_buffers(pa.binary(), len(sizes), buffers)


def _list(lists: ValueLists) -> pa.Array:
    return pa.ListArray.from_arrays(
        pa.array(lists.offsets.astype(np.int32)),
        pa.array(lists.numbers),
        mask=pa.array(lists.missing),
    )


def _lists(texts: list[list[str]], indices: Int64s) -> pa.Array:
    if not any(texts):
        return None
    return pa.array(texts, pa.list_(pa.string())).take(pa.array(indices))


@dataclass(slots=True)
class TransactionBatch:
    """The transactions and events that were completed by the packets of a block."""

    table: pa.Table
    """All transactions, in the order in which packets completed them, with the columns of
    schema.py."""
    records: list[Record]
    """First the events and the transactions that the Decoder read packet by packet, in the order in
    which packets completed them; then the transactions of `made`. All these transactions are in
    `table`, too. The opening and closing events are missing for a connection that was read from
    arrays as a whole, from SYN to FIN."""
    made: list[NamedTransaction] = field(default_factory=list)
    """The transactions that were read from arrays but are not usual reads or writes
    (usual_rows.py), so that an object was made for each."""

    @property
    def row_count(self) -> int:
        """The number of transactions, for a progress bar."""
        return len(self.table)


class BlockTables:
    """Makes a pyarrow table of each block of a capture."""

    def __init__(self, namer: Namer | None = None) -> None:
        self._plain = PlainTables(namer or Namer())

    def batch(self, decoded: DecodedBlock) -> TransactionBatch:
        records = decoded.sorted_records()
        rows = [one for _, one in records if not isinstance(one, WireEvent)]
        if decoded.plain is None:
            return TransactionBatch(row_table(rows), [one for _, one in records])
        plain, made = self._plain.table(decoded.plain)
        if rows:
            places = [place for place, one in records if not isinstance(one, WireEvent)]
            order = np.concatenate([result_sort_keys(decoded.plain.response), places])
            both = pa.concat_tables([plain, row_table(rows)])
            plain = both.take(pa.array(np.argsort(order, kind="stable")))
        return TransactionBatch(plain, [*(one for _, one in records), *made], made)
