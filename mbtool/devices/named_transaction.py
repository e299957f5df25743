"""A transaction in the words of its device: what the log, jsonl and Python show."""

from __future__ import annotations

import msgspec

from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.transaction import Outcome, Transaction


# No cycle passes through one, so the garbage collector need not visit the many that are kept.
class PointValue(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """The value of a named point."""

    name: str
    reference: str
    """Where it stands, in the vendor's notation."""
    value: int | float | None = None
    """An integer, unless the point has a scale or is a float.

    Absent where it is no number: a float that is infinite or not a number, a string, digits that
    are not BCD.
    """
    text: str
    """The value as the manual would put it: `CH1 CH2 CH6 CH8 enabled`, `27.5 s`."""
    unit: str | None = None
    written: bool = False
    """Of function 17H, which reads and writes: that it is what the request asks to write.

    Of any other function `points` has either what was read or what was to be written.
    """


class NamedTransaction(Transaction, frozen=True, kw_only=True, omit_defaults=True):
    """A transaction and what it means for its device."""

    device: str | None = None
    """The profile's name."""
    reference: str | None = None
    """What is addressed, in the vendor's notation: `HR400001..400002`."""
    points: list[PointValue] = []  # noqa: RUF012 - msgspec copies an empty list per record
    """What the response brought and what the request asks to write, whether or not it was done."""
    findings: list[str] = []  # noqa: RUF012 - msgspec copies an empty list per record
    """Codes of broken rules (docs/devices.md)."""

    @property
    def written_points(self) -> list[PointValue]:
        """What the request asks to write."""
        if self.write_address is not None:
            return [point for point in self.points if point.written]
        return self.points if self._only_writes else []

    @property
    def read_points(self) -> list[PointValue]:
        """What the response brought."""
        if self.write_address is not None:
            return [point for point in self.points if not point.written]
        return [] if self._only_writes else self.points

    @property
    def _only_writes(self) -> bool:
        function = FUNCTIONS.get(self.function)
        return function is not None and function.writes

    @property
    def took_effect(self) -> bool:
        """Whether its points are the device's values, and not only what a master asked for."""
        return self.outcome in (Outcome.OK, Outcome.BROADCAST)
