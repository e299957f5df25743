"""Remembers the scale factors that slaves hold in registers: powers of ten for other registers."""

# SunSpec has them: the current A stands in one register, and A_SF, -1 for tenths of an ampere, in
# another, which a master often reads only once.
#
# Memory: the factors of at most MAX_SLAVES slaves, those that were read last.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from mbtool.devices.values import PointInstance
    from mbtool.modbus.transaction import Transaction

MAX_SLAVES = 1024
_POWERS = range(-10, 11)
"""The scale factors of SunSpec (Information Model Specification, data type sunssf)."""

_Slave = tuple[str, str | None, int]


class ScaleFactors:
    """The powers of ten that slaves with one profile have given."""

    def __init__(self, names: Collection[str]) -> None:
        """Remember the values of the points with these names."""
        self._names = names
        self._slaves: dict[_Slave, dict[str, int]] = {}

    def after(
        self, transaction: Transaction, read: Sequence[tuple[int, PointInstance]]
    ) -> Mapping[str, int]:
        """The powers by name, as last read from the slave, also by this transaction.

        `read` are the points in its response, each with the index of its value. A value that is no
        power of ten from -10 to 10 makes the factor unknown again.
        """
        key = (transaction.link, transaction.destination, transaction.unit)
        powers = self._slaves.pop(key, None)
        if powers is None:
            powers = {}
            while len(self._slaves) >= MAX_SLAVES:
                del self._slaves[next(iter(self._slaves))]
        self._slaves[key] = powers
        values = transaction.response_values
        if values and transaction.outcome is Outcome.OK:
            for index, point in read:
                if point.name in self._names and index < len(values):
                    power = point.value(values[index : index + 1]).value
                    if isinstance(power, int) and power in _POWERS:
                        powers[point.name] = power
                    else:
                        powers.pop(point.name, None)
        return powers
