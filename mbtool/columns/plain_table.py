"""Makes a table of columns from plain rows: transactions that are read from arrays."""

# Rows of usual form (usual_rows.py) are made from the arrays. The row of every other PDU is made as
# the decoder makes it (plain_transactions.py).
#
# The name of the function, the reference and the findings of a usual row depend on its function,
# address and quantity alone. The first row of each of these is named as the decoder names it.

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from mbtool.columns.arrays import Bools, Int64s, Octets, gather, pieces, ranges
from mbtool.columns.plain_transactions import origin_fields, plain_transaction
from mbtool.columns.row_table import row_table
from mbtool.columns.schema import SCHEMA
from mbtool.columns.usual_rows import COUNTED, WRITE_COIL, WRITE_WORD, UsualRows
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus.adu import DirectionBy, Transport
from mbtool.modbus.functions import exception_name
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.columns.plain_rows import PlainRows

_PAIR = np.dtype(">u2")


class PlainTables:
    """Makes the tables of plain rows, which have no device profile."""

    def __init__(self) -> None:
        self._namer = Namer()
        self._names: dict[int, NamedTransaction] = {}
        """The first row of each function, address and quantity, with its names."""

    def table(self, rows: PlainRows) -> tuple[pa.Table, list[NamedTransaction]]:
        """The table of all rows, and again the transactions among them that are of unusual form."""
        usual = _UsualValues(rows)
        chosen = np.flatnonzero(usual.is_usual)
        others = np.flatnonzero(~usual.is_usual).tolist()
        made = [self._named(rows, index) for index in others]
        parts = [self._usual_table(rows, usual, chosen)]
        if not made:
            return parts[0], made
        parts.append(row_table(made))
        order = np.argsort(np.concatenate([chosen, others]), kind="stable")
        return pa.concat_tables(parts).take(pa.array(order)), made

    def _named(self, rows: PlainRows, index: int) -> NamedTransaction:
        return self._namer.name(plain_transaction(rows, index))

    def _usual_table(self, rows: PlainRows, usual: _UsualValues, chosen: Int64s) -> pa.Table:
        names, name = self._names_of(rows, usual, chosen)
        ends = rows.connection[chosen]
        connections = rows.connections
        origins = [origin_fields(*one) for one in rows.addresses]
        source_macs, destination_macs, vlans = zip(*origins, strict=True)
        exception = usual.exception[chosen]
        is_exception = exception >= 0
        codes = np.unique(exception[is_exception])
        columns: dict[str, Any] = {
            "link": _words([one.link for one in connections], ends),
            "transport": _words([Transport.TCP.value], np.zeros(len(chosen), np.int64)),
            "source": _words([str(one.master) for one in connections], ends),
            "destination": _words([str(one.slave) for one in connections], ends),
            "unit": rows.unit[chosen],
            "transaction_id": rows.transaction_id[chosen],
            "function": rows.code[chosen],
            "function_name": _words([one.function_name for one in names], name),
            "address": usual.address[chosen],
            "quantity": usual.quantity[chosen],
            "request_values": usual.request_values(chosen),
            "response_values": usual.response_values(chosen),
            "exception": pa.array(exception, mask=~is_exception).cast(pa.uint8()),
            "exception_name": _words(
                [exception_name(code) for code in codes.tolist()],
                np.searchsorted(codes, exception),
                ~is_exception,
            ),
            "outcome": _words(
                [Outcome.OK.value, Outcome.EXCEPTION.value], is_exception.astype(np.int64)
            ),
            "request_ns": rows.request_ns[chosen],
            "response_ns": rows.response_ns[chosen],
            "latency_ns": (rows.response_ns - rows.request_ns)[chosen],
            "retries": np.zeros(len(chosen), np.uint32),
            "request_raw": _raw(rows, rows.request_begin[chosen], rows.request_size[chosen]),
            "response_raw": _raw(rows, rows.response_begin[chosen], rows.response_size[chosen]),
            "direction_by": _words([DirectionBy.PORT.value], np.zeros(len(chosen), np.int64)),
            "confidence": np.ones(len(chosen)),
            "reference": _words_or_none([one.reference for one in names], name),
            "findings": _lists([one.findings for one in names], name),
            "time": rows.request_ns[chosen],
            "file": _words([rows.block.file], np.zeros(len(chosen), np.int64)),
            "request_packet": rows.block.first_number + rows.request[chosen],
            "response_packet": rows.block.first_number + rows.response[chosen],
            "source_mac": _words_or_none(source_macs, ends),
            "destination_mac": _words_or_none(destination_macs, ends),
            "vlan": pa.array(vlans, pa.uint16()).take(pa.array(ends)),
        }
        return pa.Table.from_arrays(
            [_column(field, columns.get(field.name), len(chosen)) for field in SCHEMA],
            schema=SCHEMA,
        )

    def _names_of(
        self, rows: PlainRows, usual: _UsualValues, chosen: Int64s
    ) -> tuple[list[NamedTransaction], Int64s]:
        """A named row for each function, address and quantity; by row, the index of its name."""
        keys = rows.code[chosen] << 32 | usual.address[chosen] << 16 | usual.quantity[chosen]
        kinds, first, like = np.unique(keys, return_index=True, return_inverse=True)
        for key, index in zip(kinds.tolist(), chosen[first].tolist(), strict=True):
            if key not in self._names:
                self._names[key] = self._named(rows, index)
        return [self._names[key] for key in kinds.tolist()], like


class _UsualValues(UsualRows):
    """The registers and bits of usual rows."""

    def request_values(self, chosen: Int64s) -> pa.Array:
        """The values that the requests write; null for reads."""
        code, value = self._code[chosen], self._value[chosen]
        words, bits = self._writes_words[chosen], self._writes_bits[chosen]
        single = np.isin(code, [WRITE_COIL, *WRITE_WORD])
        begin = self._request[chosen] + np.where(single, 3, COUNTED)
        words = words | single
        counts = np.where(single, 1, value)
        values = self._values(begin, counts, words, bits)
        if (code == WRITE_COIL).any():
            numbers, offsets = values
            coils = offsets[:-1][code == WRITE_COIL]
            numbers[coils] = numbers[coils] != 0  # FF00H is 1 (layouts.COIL_VALUES).
        return _list(*values, ~(words | bits))

    def response_values(self, chosen: Int64s) -> pa.Array:
        """The values in the responses; null for writes and exception responses."""
        is_ok = self.exception[chosen] < 0
        words, bits = self._reads_words[chosen] & is_ok, self._reads_bits[chosen] & is_ok
        begin = self._response[chosen] + 2
        return _list(*self._values(begin, self._value[chosen], words, bits), ~(words | bits))

    def _values(
        self, begin: Int64s, counts: Int64s, words: Bools, bits: Bools
    ) -> tuple[Any, Int64s]:
        """The registers and bits of all rows in one array, and the index where each row begins."""
        counts = np.where(words | bits, counts, 0)
        offsets = np.concatenate([[0], np.cumsum(counts)])
        if not bits.any():
            places = ranges(begin[words], 2 * counts[words])
            return self._data[places].view(_PAIR).astype(np.uint16), offsets
        numbers = np.zeros(int(offsets[-1]), np.uint16)
        for chosen, is_bits in ((words, False), (bits, True)):
            row = np.flatnonzero(chosen)
            inside = ranges(np.zeros(len(row), np.int64), counts[row])
            starts = np.repeat(begin[row], counts[row])
            targets = np.repeat(offsets[row], counts[row]) + inside
            if is_bits:
                numbers[targets] = self._data[starts + inside // 8] >> (inside % 8) & 1
            else:
                numbers[targets] = gather(self._data, starts + 2 * inside, _PAIR)
        return numbers, offsets


def _column(field: pa.Field, values: Any, count: int) -> pa.Array:
    if values is None:
        if pa.types.is_list(field.type):
            return pa.array([[]] * count, field.type)
        return pa.nulls(count, field.type)
    if isinstance(values, np.ndarray):
        return pa.array(values).cast(field.type)
    return values


def _words(texts: list[str], indices: Int64s, missing: Bools | None = None) -> pa.Array:
    """A column of texts: each row has the text at its index in `texts`, or null if missing."""
    index = pa.array(
        np.where(missing, 0, indices) if missing is not None else indices, mask=missing
    )
    return pa.DictionaryArray.from_arrays(index.cast(pa.int32()), pa.array(texts, pa.string()))


def _words_or_none(texts: Sequence[str | None], indices: Int64s) -> pa.Array:
    """A column of texts: each row has the text at its index in `texts`; null if that is None."""
    missing = np.array([text is None for text in texts], np.bool_)
    return _words([text or "" for text in texts], indices, missing[indices])


def _raw(rows: PlainRows, begins: Int64s, sizes: Int64s) -> pa.Array:
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    data: Octets = pieces(rows.data, begins, sizes)
    buffers = [None, pa.py_buffer(offsets), pa.py_buffer(data)]
    return pa.Array.from_buffers(pa.binary(), len(sizes), buffers)


def _list(numbers: Any, offsets: Int64s, missing: Bools) -> pa.Array:
    return pa.ListArray.from_arrays(
        pa.array(offsets.astype(np.int32)), pa.array(numbers), mask=pa.array(missing)
    )


def _lists(texts: list[list[str]], indices: Int64s) -> pa.Array:
    if not any(texts):
        return None
    return pa.array(texts, pa.list_(pa.string())).take(pa.array(indices))
