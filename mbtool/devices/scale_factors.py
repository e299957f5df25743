"""Remembers scale factors that slaves hold in registers.

A scale factor is a power of ten by which the number in another register is multiplied.
"""

# SunSpec devices have scale factors. One register holds the current A; another one, A_SF, holds -1
# if the current is in tenths of an ampere. A master often reads A_SF only once.
#
# Memory: the scale factors of the MAX_SLAVES slaves that were read last.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from mbtool.devices.values import PointInstance
    from mbtool.modbus.transaction import Transaction

MAX_SLAVES = 1024
_POWERS = range(-10, 11)
"""The exponents that a scale factor of SunSpec can have (Information Model Specification, data type
sunssf)."""

_Slave = tuple[str, str | None, int]


class ScaleFactors:
    """Remembers the powers of ten that slaves with one profile hold in registers."""

    def __init__(self, names: Collection[str]) -> None:
        """Take the names of the points that hold a power of ten."""
        self._names = names
        self._slaves: dict[_Slave, dict[str, int]] = {}

    def after(
        self, transaction: Transaction, read: Sequence[tuple[int, PointInstance]]
    ) -> Mapping[str, int]:
        """Take a transaction into account, and return the slave's powers of ten, by the name of the
        point that holds them.

        `read` are the points in the response, each with the index of its first value. If such a
        point should hold a power of ten, but its value is not from -10 to 10, its power becomes
        unknown.
        """
        key = (transaction.link, transaction.destination, transaction.unit)
        powers = self._slaves.pop(key, None)
        if powers is None:
            powers = {}
            while len(self._slaves) >= MAX_SLAVES:
                del self._slaves[next(iter(self._slaves))]
        self._slaves[key] = powers
        values = transaction.response_values
        if values and transaction.outcome in (Outcome.OK, Outcome.LATE):
            for index, point in read:
                if point.name in self._names and index < len(values):
                    power = point.value(values[index : index + 1]).value
                    if isinstance(power, int) and power in _POWERS:
                        powers[point.name] = power
                    else:
                        powers.pop(point.name, None)
        return powers
