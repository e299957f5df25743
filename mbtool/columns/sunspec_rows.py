"""Finds the plain rows that may tell the SunSpec models of a slave: each of them is looked at."""

# These are all reads of holding registers of a slave in whose answer the mark of a map was seen, in
# this block or an earlier one (devices/sunspec_map.py): in a row, or in a transaction that was
# decoded one by one.
#
# Memory: at most MAX_SLAVES slaves; the reads of others are not found.

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import gather
from mbtool.columns.column_decoder import order_of
from mbtool.columns.plain_transactions import plain_transaction
from mbtool.columns.usual_rows import UsualRows
from mbtool.core import WireEvent
from mbtool.devices import Namer
from mbtool.devices.sunspec_map import BASES, MARK, READ_HOLDING, mark_in
from mbtool.modbus.adu_bytes import MBAP_BYTES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.columns.arrays import Bools, Int64s
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.decode.decoder import Record

MAX_SLAVES = 1024

_MARK = MARK[0] << 16 | MARK[1]
_MARK_BYTES = _MARK.to_bytes(4)
_VALUES = MBAP_BYTES + 2
"""The offset of the first register in the ADU of an answer."""
_TWO_REGISTERS = np.dtype(">u4")


class SunSpecRows:
    """Finds the rows in the blocks of a capture, in order."""

    def __init__(self) -> None:
        self._slaves: set[tuple[str, str, int]] = set()
        """Link, address and unit of each slave with a mark."""

    @property
    def has_slaves(self) -> bool:
        return bool(self._slaves)

    def note(self, records: Iterable[tuple[int, Record]]) -> None:
        """Look for marks in the transactions of the next block that were decoded one by one."""
        for _, one in records:
            if isinstance(one, WireEvent) or one.function != READ_HOLDING:
                continue
            values, slave = one.response_values, one.destination
            if not values or MARK[0] not in values or one.address is None or slave is None:
                continue
            if mark_in(one.address, values) is not None and len(self._slaves) < MAX_SLAVES:
                self._slaves.add((one.link, slave, one.unit))

    def find(self, rows: PlainRows, usual: UsualRows) -> Bools:
        """True for each row of usual form that may tell models."""
        reads = usual.is_usual & (rows.code == READ_HOLDING) & (usual.exception < 0)
        for place in _with_mark(rows, usual, np.flatnonzero(reads)):
            if len(self._slaves) < MAX_SLAVES:
                end = rows.connections[rows.connection[place]]
                self._slaves.add((end.link, str(end.slave), int(rows.unit[place])))
        found = np.zeros(len(reads), np.bool_)
        for link, slave, unit in self._slaves:
            is_there = [(one.link, str(one.slave)) == (link, slave) for one in rows.connections]
            found |= reads & np.array(is_there)[rows.connection] & (rows.unit == unit)
        return found


class SunSpecReads:
    """Gives the transactions of blocks that may tell SunSpec models, in order."""

    def __init__(self) -> None:
        self._rows = SunSpecRows()
        self._namer = Namer()

    def records(self, decoded: DecodedBlock) -> list[Record]:
        """The records of a block, and its rows that may tell models."""
        records = decoded.sorted_records()
        self._rows.note(records)
        rows = decoded.plain
        if rows is not None and (self._rows.has_slaves or _MARK_BYTES in rows.data.tobytes()):
            found = np.flatnonzero(self._rows.find(rows, UsualRows(rows)))
            places = order_of(rows.response[found]).tolist()
            made = (self._namer.name(plain_transaction(rows, one)) for one in found.tolist())
            records += zip(places, made, strict=True)
            records.sort(key=lambda one: one[0])
        return [record for _, record in records]


def _with_mark(rows: PlainRows, usual: UsualRows, places: Int64s) -> list[int]:
    """The rows among `places` that have the mark where a map may begin."""
    found: list[int] = []
    for base in BASES:
        at = base - usual.address[places]
        some = (at >= 0) & (at < usual.quantity[places] - 1)
        chosen = places[some]
        values = gather(
            rows.data, rows.response_begin[chosen] + _VALUES + 2 * at[some], _TWO_REGISTERS
        )
        found += chosen[values == _MARK].tolist()
    return found
