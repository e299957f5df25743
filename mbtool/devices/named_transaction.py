"""A transaction with the names and values of its device: for the log, jsonl and Python."""

from __future__ import annotations

import msgspec

from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.transaction import Outcome, Transaction


# gc=False: a value never refers to itself, so the garbage collector need not look at values.
class PointValue(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """The value of a named point."""

    name: str
    reference: str
    """The point's address, in the vendor's notation."""
    value: int | float | None = None
    """The value as a number: an integer, unless the point has a scale or is a float.

    None if there is no finite number: for a string, an infinite float, digits that are not BCD."""
    text: str
    """The value in the words of the manual: `CH1 CH2 CH6 CH8 enabled`, `27.5 s`."""
    unit: str | None = None
    written: bool = False
    """True for a value that a request with function 17H writes.

    Only function 17H both reads and writes. The points of any other function are either all read or
    all written, and have False here."""


class NamedTransaction(Transaction, frozen=True, kw_only=True, omit_defaults=True):
    """A transaction and its meaning for the device."""

    device: str | None = None
    """The name of the slave's profile; None if the slave has none."""
    reference: str | None = None
    """The addresses of the request, in the vendor's notation: `HR400001..400002`."""
    points: list[PointValue] = []  # noqa: RUF012 - msgspec copies an empty list per record
    """The values that the response contains, or that the request writes, even if the write
    failed."""
    findings: list[str] = []  # noqa: RUF012 - msgspec copies an empty list per record
    """Codes of broken rules (docs/findings.md)."""

    @property
    def written_points(self) -> list[PointValue]:
        """The values that the request writes."""
        if self.write_address is not None:
            return [point for point in self.points if point.written]
        return self.points if self._only_writes else []

    @property
    def read_points(self) -> list[PointValue]:
        """The values that the response contains."""
        if self.write_address is not None:
            return [point for point in self.points if not point.written]
        return [] if self._only_writes else self.points

    @property
    def _only_writes(self) -> bool:
        function = FUNCTIONS.get(self.function)
        return function is not None and function.writes

    @property
    def took_effect(self) -> bool:
        """True if the slave has these values, False if a master only requested to write them."""
        return self.outcome in (Outcome.OK, Outcome.BROADCAST)
