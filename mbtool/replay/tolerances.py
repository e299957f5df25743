"""Says by how much the values of points may differ from the recorded ones: `--tolerate`."""

# A text is NAME=AMOUNT. NAME is, in upper or lower case,
#
#     the name of a point     Temperature; the {n} of a series stands for all of its points
#     a type of points        float32, int16, as in a profile
#     a range of registers    HR400010..400019 or holding 9..18: the points in it; a register of it
#                             that is no point counts as a number from 0 to 65535
#
# and AMOUNT is a number in the unit of the point (0.5), a share of the recorded value (2%), or the
# word counter. With counter, any value is right that is not below the value read before in this
# run; a counter may also begin again at the end of its range.
#
# If several texts are for one point, the last one counts. If a point cannot be decoded, for example
# because its scale is in another register, its registers must be as recorded.

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import UsageError
from mbtool.devices import Point, PointType, Profile, Span, parse_span, write_reference
from mbtool.devices.values import PointInstance

if TYPE_CHECKING:
    from mbtool.modbus import Table

_AMOUNT = re.compile(r"(\d{1,15}(?:\.\d{1,15})?)(%?)|counter", re.ASCII | re.IGNORECASE)
_BEGINS_AGAIN = 0.5
"""A counter has begun again, and has not run backwards, if it fell by more than this share of its
range."""


@dataclass(frozen=True, slots=True)
class Amount:
    """How far a value may be from the recorded one."""

    limit: float = 0.0
    is_share: bool = False
    """True if `limit` is a share of the recorded value: 0.02 is 2 %."""
    is_counter: bool = False

    def allows(self, recorded: float, answered: float) -> bool:
        limit = abs(recorded) * self.limit if self.is_share else self.limit
        # In binary, a difference of decimal numbers may be a little too large: 21.3 - 21.2 is
        # greater than 0.1.
        return abs(answered - recorded) <= limit * (1 + 1e-9)


@dataclass(frozen=True, slots=True)
class _Tolerated:
    """A point whose value may differ."""

    point: PointInstance
    amount: Amount
    full_range: float
    """The greatest value minus the least one that its registers can hold; 0 if unknown."""


class Tolerances:
    """The points whose values may differ, by device and address."""

    def __init__(self, texts: Iterable[str], profiles: Mapping[str, Profile]) -> None:
        """Take texts such as `Temperature=0.5`; `profiles` are those of the recording, by name.

        Raises UsageError for a text that names no point, type or range, or no amount.
        """
        self._by_device: dict[str | None, dict[tuple[Table, int], _Tolerated]] = {}
        """By profile name (None for a device without profile), table and first address."""
        self._last: dict[tuple[int, Table, int], float] = {}
        """The last value that each counter had, by unit, table and first address."""
        for text in texts:
            self._add(text, profiles)

    @property
    def has_counters(self) -> bool:
        return any(
            each.amount.is_counter for some in self._by_device.values() for each in some.values()
        )

    def judged(
        self,
        unit: int,
        device: str | None,
        table: Table,
        reads: Sequence[int],
        recorded: Sequence[int],
        answered: Sequence[int],
    ) -> tuple[set[int], set[int]]:
        """Return the addresses of the tolerated points whose values are right, and those of
        counters that have run backwards. Other addresses are in neither set.

        `reads` are the addresses of a read, `recorded` and `answered` their values.
        """
        right: set[int] = set()
        wrong: set[int] = set()
        of_device = self._by_device.get(device, {})
        for index, address in enumerate(reads):
            one = of_device.get((table, address))
            if one is None or index + one.point.words > min(len(recorded), len(answered)):
                continue
            end = index + one.point.words
            before, now = (one.point.value(each[index:end]).value for each in (recorded, answered))
            if not isinstance(before, int | float) or not isinstance(now, int | float):
                continue
            if self._is_right((unit, table, address), one, before, now):
                right.update(reads[index:end])
            elif one.amount.is_counter:
                wrong.update(reads[index:end])
        return right, wrong

    def _is_right(
        self, key: tuple[int, Table, int], one: _Tolerated, recorded: float, answered: float
    ) -> bool:
        if not one.amount.is_counter:
            return one.amount.allows(recorded, answered)
        before = self._last.get(key)
        self._last[key] = answered
        if before is None or answered >= before:
            return True
        return one.full_range > 0 and before - answered > _BEGINS_AGAIN * one.full_range

    def _add(self, text: str, profiles: Mapping[str, Profile]) -> None:
        name, _, amount_text = text.rpartition("=")
        match = _AMOUNT.fullmatch(amount_text.strip())
        name = name.strip()
        if match is None or not name:
            raise UsageError(
                f"--tolerate {text!r}: write NAME=AMOUNT, for example 'Temperature=0.5', "
                "float32=2% or 'holding 9=counter'"
            )
        number, percent = match.groups()
        amount = Amount(is_counter=True)
        if number is not None:
            amount = Amount(float(number) / (100 if percent else 1), bool(percent))
        found = 0
        for device, profile in profiles.items():
            for point, instance in _points(profile):
                names = (instance.name, instance.reference, point.name, point.type.value)
                if name.casefold() in (each.casefold() for each in names):
                    self._note(device, point, instance, amount)
                    found += 1
        if found:
            return
        try:
            span = parse_span(name, profiles.values())
        except UsageError as error:
            raise UsageError(
                f"--tolerate {text!r}: no point or type of that name in the recording's profiles "
                f"(--device gives one), and no range of registers: {error}"
            ) from error
        self._add_span(span, amount, profiles)

    def _add_span(self, span: Span, amount: Amount, profiles: Mapping[str, Profile]) -> None:
        kind = PointType.BIT if span.table.is_bits else PointType.UINT16
        for device, profile in (None, None), *profiles.items():
            numbers = set(range(span.first, span.last + 1))
            for point, instance in _points(profile) if profile is not None else ():
                own = range(instance.address, instance.address + instance.words)
                if point.table is span.table and own[0] in span and own[-1] in span:
                    self._note(device, point, instance, amount)
                if point.table is span.table:
                    numbers.difference_update(own)
            for at in numbers:
                point = Point(name="", table=span.table, address=at, type=kind)
                instance = PointInstance(point, at, write_reference(None, span.table, at))
                self._note(device, point, instance, amount)

    def _note(
        self, device: str | None, point: Point, instance: PointInstance, amount: Amount
    ) -> None:
        numbers = point.type.whole_numbers
        full_range = 0.0 if numbers is None else (numbers[-1] - numbers[0]) * abs(point.scale)
        of_device = self._by_device.setdefault(device, {})
        of_device[point.table, instance.address] = _Tolerated(instance, amount, full_range)


def _points(profile: Profile) -> Iterable[tuple[Point, PointInstance]]:
    """Yield the points of a profile, each of a series on its own."""
    for point in profile.points:
        for address in point.addresses:
            reference = write_reference(profile, point.table, address, point.words)
            yield point, PointInstance(point, address, reference)
