"""Transactions with names and values from the profile of their device."""

from __future__ import annotations

from typing import Annotated

import msgspec

from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.transaction import Outcome, Transaction, about


# gc=False: values never form a reference cycle, so the garbage collector need not track them.
class PointValue(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """The value that a transaction read or wrote, with the name of its point in the profile."""

    name: str
    reference: str
    """The point's address, in the vendor's notation."""
    value: int | float | None = None
    """The value as a number: an integer, unless the point has a scale or is a float.

    None if the value is no finite number: a string, an infinite float, digits that are not BCD."""
    text: str
    """The value in the words of the manual: `CH1 CH2 CH6 CH8 enabled`, `27.5 s`."""
    unit: str | None = None
    written: bool = False
    """True if a request with function 17H writes the value.

    False for all other functions: they do not read and write in one request, so the function tells
    whether a value is read or written."""


class NamedTransaction(Transaction, frozen=True, kw_only=True, omit_defaults=True):
    """A transaction with the names and values that the device's manual gives to its addresses."""

    device: Annotated[str | None, about("The name of the device's profile", 15, 27)] = None
    """The name of the slave's profile; None if the slave has none."""
    reference: Annotated[
        str | None, about("What is addressed, in the vendor's notation", 16, 28)
    ] = None
    """The addresses of the request, in the vendor's notation: `HR400001..400002`. None if the
    request has no addresses."""
    points: Annotated[
        list[PointValue],
        about("The named values that the response brought or the request asks to write", 22, 29),
    ] = []  # noqa: RUF012 - msgspec copies an empty list per record
    """The named values in the response, or in the request if it writes. A failed write has them,
    too."""
    findings: Annotated[list[str], about("Codes of broken rules", 23, 30)] = []  # noqa: RUF012 - msgspec copies an empty list per record
    """The codes of the rules that the transaction breaks (docs/findings.md)."""

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
        """True if the slave holds the transaction's values, as far as is known.

        That is so if it answered the read or write, or if a write was a broadcast. False if a
        master only asked for a write.
        """
        return self.outcome in (Outcome.OK, Outcome.LATE, Outcome.BROADCAST)
