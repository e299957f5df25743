"""Finds those transactions in arrays from which the inventory may learn which SunSpec models a
slave has.
"""

# A SunSpec slave has the mark "SunS" in two holding registers at the start of its map
# (devices/sunspec_map.py). Once a response with the mark was seen, in the arrays or in a
# transaction object, all reads of holding registers of that slave are found, in this block and in
# later ones. Each of these reads is then made a transaction object and examined.
#
# Memory: at most MAX_SLAVES slaves are remembered; the reads of further ones are not found.

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s, gather
from mbtool.columns.column_decoder import DecodedBlock, result_sort_keys
from mbtool.columns.plain_transactions import PlainObjects
from mbtool.columns.usual_values import UsualValues
from mbtool.core import WireEvent
from mbtool.devices import Namer
from mbtool.devices.sunspec_map import BASES, MARK, READ_HOLDING, mark_in
from mbtool.modbus.adu import MBAP_BYTES

if TYPE_CHECKING:
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.usual_rows import UsualRows
    from mbtool.decode.decoder import Record

MAX_SLAVES = 1024
"""At most this many slaves with a SunSpec map are remembered; the reads of further ones are not
found."""

_MARK = MARK[0] << 16 | MARK[1]
_MARK_BYTES = _MARK.to_bytes(4)
_VALUES = MBAP_BYTES + 2
"""The offset, in bytes, at which the register values begin in the ADU of a response to a read."""
_TWO_REGISTERS = np.dtype(">u4")


class SunSpecRows:
    """Finds the reads of SunSpec slaves among the transactions in arrays.

    The blocks of a capture must be given in order.
    """

    def __init__(self) -> None:
        self._slaves: set[tuple[str, str, int]] = set()
        """Link name, HOST:PORT and unit of each slave that has shown the SunSpec mark."""

    @property
    def has_slaves(self) -> bool:
        return bool(self._slaves)

    def note(self, records: Iterable[tuple[int, Record]]) -> None:
        """Remember the slaves that show the SunSpec mark in the transactions among `records`.

        `records` are the Decoder's records of the block that `find` is called with next.
        """
        for _, one in records:
            if isinstance(one, WireEvent) or one.function != READ_HOLDING:
                continue
            values, slave = one.response_values, one.destination
            if not values or MARK[0] not in values or one.address is None or slave is None:
                continue
            if mark_in(one.address, values) is not None and len(self._slaves) < MAX_SLAVES:
                self._slaves.add((one.link, slave, one.unit))

    def find(self, rows: PlainRows, usual: UsualRows) -> Bools:
        """Return for each row True if it reads holding registers of a slave that has shown the
        SunSpec mark.
        """
        reads = usual.is_usual & (rows.code == READ_HOLDING) & (usual.exception < 0)
        for place in _rows_with_sunspec_mark(rows, usual, np.flatnonzero(reads)):
            if len(self._slaves) < MAX_SLAVES:
                end = rows.connections[rows.connection[place]]
                self._slaves.add((end.link, str(end.slave), int(rows.unit[place])))
        found = np.zeros(len(reads), np.bool_)
        for link, slave, unit in self._slaves:
            is_there = [(one.link, str(one.slave)) == (link, slave) for one in rows.connections]
            found |= reads & np.array(is_there)[rows.connection] & (rows.unit == unit)
        return found


class SunSpecReads:
    """Makes transaction objects of the reads of SunSpec slaves, whose responses may show SunSpec
    models.

    The blocks of a capture must be given in order.
    """

    def __init__(self) -> None:
        self._rows = SunSpecRows()
        self._objects = PlainObjects(Namer())

    def records(self, decoded: DecodedBlock) -> list[Record]:
        """Return the Decoder's records of a block together with the reads of SunSpec slaves in its
        arrays, in the order in which packets completed them.
        """
        records = decoded.sorted_records()
        self._rows.note(records)
        rows = decoded.plain
        if rows is not None and (self._rows.has_slaves or _MARK_BYTES in rows.data.tobytes()):
            usual = UsualValues(rows)
            found = np.flatnonzero(self._rows.find(rows, usual))
            places = result_sort_keys(rows.response[found]).tolist()
            made = self._objects.of(rows, usual).chosen(found)
            records += zip(places, made, strict=True)
            records.sort(key=lambda one: one[0])
        return [record for _, record in records]


def _rows_with_sunspec_mark(rows: PlainRows, usual: UsualRows, places: Int64s) -> list[int]:
    """Return those of the row indices `places` whose response has the SunSpec mark at an address
    where a map may begin. These rows must be reads of holding registers.
    """
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
