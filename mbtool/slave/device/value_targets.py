"""Finds the register, bit or point that a key of a values file (image_file.py) names."""

# A key may be, in upper or lower case:
#
#     the name of a point    "CH1 digital operation value", "T5 preset value". Its value is in the
#                            point's unit and type.
#     a reference            HR400001, X1F, T5. A whole number is the register's content. A number
#                            with a fraction, a text, and any number for a point of several
#                            registers are values in the unit of the point at this address.
#     a table and address    "holding 9005". The value is read in the same way as for a reference.
#
# A reference (the vendor's notation of an address) may stand for several points: T5 of FT1A
# SmartAXIS is a contact, a current value and a preset value. Such a reference does not say which
# point is meant, so it is refused, and the error lists the points' names.

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import UsageError
from mbtool.devices import (
    Access,
    Point,
    PointType,
    Profile,
    parse_reference,
    parse_span,
    registers_of,
    write_reference,
)
from mbtool.devices.values import PointInstance
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.slave.device.image import RegisterImage

_LOWEST, _HIGHEST = -0x8000, 0xFFFF


@dataclass(frozen=True, slots=True)
class ValueTarget:
    """The register, bit or point that a value is for; converts values to register contents."""

    table: Table
    address: int
    point: Point | None
    """The point that begins at this address, if there is one."""
    is_named: bool = False
    """True if the key was the point's name."""
    is_reference: bool = False
    """True if the point's name is also its reference, as for X0 of an FA3 module."""

    @property
    def words(self) -> int:
        """The number of registers that one value takes: that of the point, or 1; 1 for a bit."""
        return self.point.words if self.point is not None else 1

    def registers(self, value: object, *, stored: bool = False) -> list[int]:
        """Convert a value of the file to the contents of the target's registers, or of its bit.

        With `stored`, a whole number is taken as a register's content. Without it, a whole number
        for a named point, for BCD, or for one of several registers, is in the point's unit. Raises
        UsageError for a value that the registers or the bit cannot hold.
        """
        if isinstance(value, bool):
            if not self.table.is_bits:
                raise UsageError(f"{str(value).lower()}: {self._range()}")
            value = int(value)
        if isinstance(value, int) and (stored or not self._is_measured):
            return [self._stored(value)]
        if self.point is None or not isinstance(value, int | float | str):
            raise UsageError(f"{reprlib.repr(value)}: {self._range()}")
        return self._encoded(self.point, value)

    def all_registers(self, value: object, *, stored: bool = False) -> list[int]:
        """Convert a value as `registers` does, or a list of numbers to as many registers or bits.

        Each number of a list is the content of one register or bit, beginning at the target's
        address. Raises UsageError as `registers` does, for an empty list, and for a list where the
        key is the name of a point.
        """
        if not isinstance(value, list):
            return self.registers(value, stored=stored)
        if not value:
            raise UsageError("the list is empty; write a number or numbers")
        if self.is_named and not self.is_reference:
            raise UsageError(
                f"{reprlib.repr(value)}: a name is one value; list values at a reference"
            )
        plain = ValueTarget(self.table, self.address, None)
        return [one for each in value for one in plain.registers(each, stored=True)]

    def nearest(self, value: float) -> list[int]:
        """Convert a value in the point's unit to registers, rounded to what they can hold.

        Raises UsageError for a value above or below what they can hold.
        """
        if self.point is None:
            return [self._stored(round(value))]
        if self.point.type.is_float or self.point.scale != 1 or self.point.offset:
            return self._encoded(self.point, value)
        return self._encoded(self.point, round(value))

    def _encoded(self, point: Point, value: float | str) -> list[int]:
        """Return the register contents of a value in the point's unit.

        Some points have their scale in another register of the device. It is applied only if the
        key was the point's name; a value for an address is stored without it.
        """
        if point.scale_from is not None and not self.is_named:
            point = replace(point, scale_from=None)
        return registers_of(point, value)

    def put(self, image: RegisterImage, values: list[int]) -> None:
        """Write the registers or bits of this target into an image."""
        if self.point is not None and self.point.block is not None:
            image.put(self.point, self.address, values)
        else:
            image.set(self.table, self.address, values)

    @property
    def _is_measured(self) -> bool:
        """True if a whole number in the file is in the point's unit, not a register's content."""
        return self.point is not None and (
            self.is_named
            or self.point.type is PointType.BCD16
            or (self.point.words > 1 and self.point.type is not PointType.STRING)
        )

    def _stored(self, value: int) -> int:
        lowest, highest = (0, 1) if self.table.is_bits else (_LOWEST, _HIGHEST)
        if not lowest <= value <= highest:
            raise UsageError(f"{reprlib.repr(value)}: {self._range()}")
        return value & _HIGHEST

    def _range(self) -> str:
        lowest, highest = (0, 1) if self.table.is_bits else (_LOWEST, _HIGHEST)
        return f"write a number from {lowest} to {highest}"


class ValueTargets:
    """Finds the register, bit or point of one device that a key of a values file names."""

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self._by_name: dict[str, ValueTarget] = {}
        self._names: dict[tuple[Table, int], str] = {}
        self._points: dict[tuple[Table, int], Point] = {}
        points = sorted(profile.points, key=lambda point: point.access is Access.WRITE)
        for point in points:
            for address in point.addresses:
                reference = write_reference(profile, point.table, address, point.words)
                name = PointInstance(point, address, reference).name
                target = ValueTarget(
                    point.table,
                    address,
                    point,
                    is_named=True,
                    is_reference=name.casefold() == reference.casefold(),
                )
                self._by_name.setdefault(name.casefold(), target)
                if point.block in (None, address):
                    self._names.setdefault((point.table, address), name)
                    self._points.setdefault((point.table, address), point)

    def find(self, key: str) -> ValueTarget:
        """Return the target that a key names.

        Raises UsageError for a key that names nothing, or that may mean several points.
        """
        named = self._by_name.get(key.strip().casefold())
        if named is not None:
            return named
        try:
            neutral = parse_span(key)
        except UsageError:
            table, address = self._referred(key)
        else:
            if neutral.last > neutral.first:
                raise UsageError(f"{key!r}: name the first address, and list the values behind it")
            table, address = neutral.table, neutral.first
        return ValueTarget(table, address, self._points.get((table, address)))

    def _referred(self, key: str) -> tuple[Table, int]:
        try:
            table, address = parse_reference(self._profile, key)
        except UsageError as error:
            near = difflib.get_close_matches(key.strip().casefold(), self._by_name, n=1)
            if not near:
                raise
            target = self._by_name[near[0]]
            name = self._names.get((target.table, target.address), near[0])
            raise UsageError(
                f"{key!r} is no name and no reference; did you mean {name!r}?"
            ) from error
        names = list(dict.fromkeys(self._meanings(key)))
        if len(names) > 1:
            few = ", ".join(repr(name) for name in names)
            raise UsageError(f"{key!r} may mean {few}; write which as the key, in quotes")
        return table, address

    def _meanings(self, key: str) -> Iterator[str]:
        """Yield the names of all points that the reference `key` may mean, one in each area.

        The same reference, such as T5, may stand for points in several areas.
        """
        for area in self._profile.areas:
            try:
                place = parse_reference(replace(self._profile, areas=[area]), key)
            except UsageError:
                continue
            if place in self._names:
                yield self._names[place]
