"""Follows the values of points and registers that transactions read and write."""

# A transaction whose values are those of the last one of its poll is passed over at once. Of a
# slave with a profile the points of the manual are followed, else registers and bits.
#
# Memory: MAX_SERIES points and registers (value_series.py); MAX_OF_POLL registers of one poll;
# MAX_POLLS polls, of which the last values are kept. Beyond that, `left_out` counts the registers
# and points that are not followed.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.modbus import FUNCTIONS
from mbtool.series.value_series import ValueSeries

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import NamedTransaction
    from mbtool.modbus.tables import Table

MAX_SERIES = 256
MAX_OF_POLL = 64
MAX_POLLS = 2048
_MASK_WRITE = 0x16


class SeriesKey(NamedTuple):
    """What identifies a series: the slave, and its point or register."""

    link: str
    unit: int
    name: str
    """The name of a point; of a register `holding 12`."""


class Values:
    """The values of points and registers over time."""

    def __init__(self, most: int = MAX_SERIES) -> None:
        self._most = most
        self.series: dict[SeriesKey, ValueSeries] = {}
        self._left_out: set[SeriesKey] = set()
        self._last: dict[tuple[object, ...], list[int]] = {}

    @property
    def left_out(self) -> int:
        """The number of points and registers that were seen and are not followed."""
        return len(self._left_out)

    def add(self, one: NamedTransaction) -> None:
        function = FUNCTIONS.get(one.function)
        if function is None or function.table is None or not one.took_effect:
            return
        only_writes = function.writes and one.write_address is None
        values = one.request_values if only_writes else one.response_values
        if values is None or one.function == _MASK_WRITE:
            return
        poll = (one.link, one.unit, one.function, one.address, one.quantity)
        before = self._last.get(poll)
        if before == values:
            return
        if before is not None or len(self._last) < MAX_POLLS:
            self._last[poll] = values
        at_ns = one.response_ns or one.start_ns
        if one.points:
            self._add_points(one, at_ns)
        elif one.address is not None:
            self._add_registers(one, function.table, values, at_ns)

    def _add_points(self, one: NamedTransaction, at_ns: int) -> None:
        for point in one.points:
            series = self._series(SeriesKey(one.link, one.unit, point.name))
            if series is None:
                continue
            series.reference, series.unit = point.reference, point.unit or ""
            series.add(at_ns, point.value, point.text)

    def _add_registers(
        self, one: NamedTransaction, table: Table, values: Sequence[int], at_ns: int
    ) -> None:
        word, is_bits = table.partition("_")[0], table.is_bits
        for address, value in enumerate(values[:MAX_OF_POLL], one.address or 0):
            key = SeriesKey(one.link, one.unit, f"{word} {address}")
            series = self._series(key, is_bit=is_bits)
            if series is not None:
                series.add(at_ns, value)

    def _series(self, key: SeriesKey, *, is_bit: bool = False) -> ValueSeries | None:
        series = self.series.get(key)
        if series is None:
            if len(self.series) >= self._most:
                if len(self._left_out) < MAX_POLLS:
                    self._left_out.add(key)
                return None
            series = self.series[key] = ValueSeries(key.name, bit=is_bit)
        return series
