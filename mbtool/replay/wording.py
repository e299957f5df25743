"""The words in which differences are told, wherever they come from."""

from __future__ import annotations

from statistics import median_low
from typing import TYPE_CHECKING

from mbtool.devices import Side, write_reference
from mbtool.devices.values import PointInstance as NamedPlace
from mbtool.modbus import Table, short_name

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.replay.traffic import Held, Sample, ValueKey

SHOWN_VALUES = 4


class DeviceWording:
    """The words of a device for its registers."""

    def __init__(self, profile: Profile | None) -> None:
        self._profile = profile
        self._points = {
            (point.table, address): point
            for point in (profile.points if profile is not None else ())
            for address in point.addresses
        }

    def reference(self, table: Table, address: int, quantity: int = 1) -> str:
        return write_reference(self._profile, table, address, quantity)

    def of(self, place: ValueKey) -> tuple[str | None, NamedPlace | None]:
        """The name of a register, and what puts its value into words where it is one word."""
        point = self._points.get((place.table, place.address))
        if point is None:
            return None, None
        named = NamedPlace(point, place.address, self.reference(place.table, place.address))
        return named.name, named if named.words == 1 else None


def function_text(function: int, name: str, sub_function: int = -1) -> str:
    """The code in hexadecimal and the function's short name, or the maker's own."""
    sub = f" {sub_function:02X}" if sub_function >= 0 else ""
    return f"{function:02X} {short_name(function, name)}{sub}"


def held_text(held: Held, named: NamedPlace | None) -> str:
    count = len(held.values)
    if count > SHOWN_VALUES or not held.is_all:
        more = "" if held.is_all else "more than "
        return f"{held.least}..{held.greatest}, {more}{count} values"
    return ", ".join(
        named.value([value]).text if named is not None else str(value) for value in held.values
    )


def latency_side(sample: Sample) -> Side:
    """The median and the 95th percentile of at least one latency."""
    ordered = sorted(sample.values)
    median, p95 = median_low(ordered), ordered[min(len(ordered) - 1, len(ordered) * 95 // 100)]
    return Side(
        text=f"{_milliseconds(median)}, p95 {_milliseconds(p95)}", median_ns=median, p95_ns=p95
    )


def _milliseconds(ns: int) -> str:
    return f"{ns / 1e6:.3g} ms" if ns < 10_000_000 else f"{ns / 1e6:,.0f} ms"
