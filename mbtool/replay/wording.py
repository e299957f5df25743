"""Formats the names and values in differences between two recordings, or between recorded and new
responses.
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median_low
from typing import TYPE_CHECKING, Self

from mbtool.devices import Profile, Side, write_reference
from mbtool.devices.values import PointInstance
from mbtool.modbus import Table, short_name

if TYPE_CHECKING:
    from mbtool.replay.traffic import ObservedValues, Sample, ValueKey

SHOWN_VALUES = 4
"""If a register had more different values than this, only their range is shown."""


class DeviceWording:
    """The names that a device's profile has for its registers, and their notation, such as
    HR400001.
    """

    @classmethod
    def of_device(cls, device: str | None, profiles: Mapping[str, Profile]) -> Self:
        """Take the names from the profile called `device`; if there is none, use the notation of
        the Modbus standard.
        """
        return cls(profiles.get(device) if device is not None else None)

    def __init__(self, profile: Profile | None) -> None:
        self._profile = profile
        self._points = {
            (point.table, address): point
            for point in (profile.points if profile is not None else ())
            for address in point.addresses
        }

    def reference(self, table: Table, address: int, quantity: int = 1) -> str:
        return write_reference(self._profile, table, address, quantity)

    def of(self, key: ValueKey) -> tuple[str | None, PointInstance | None]:
        """Return the name of a register's point, and the point, which formats its values.

        Both are None if the profile has no point at this address. If the point takes several
        registers, the value of one register says nothing; then only the name is returned, with
        None.
        """
        point = self._points.get((key.table, key.address))
        if point is None:
            return None, None
        named = PointInstance(point, key.address, self.reference(key.table, key.address))
        return named.name, named if named.words == 1 else None


def function_text(function: int, name: str, sub_function: int = -1) -> str:
    """A request's function as text: the code in hexadecimal, the short name, and the sub-function
    if it is not -1.

    `name` is used for a vendor's function, which has no short name.
    """
    sub = f" {sub_function:02X}" if sub_function >= 0 else ""
    return f"{function:02X} {short_name(function, name)}{sub}"


def values_text(observed: ObservedValues, point: PointInstance | None) -> str:
    """The values of a register as text, formatted by `point`; as numbers if `point` is None.

    If there are more than SHOWN_VALUES, only their range and number.
    """
    count = len(observed.values)
    if count > SHOWN_VALUES or not observed.is_all:
        more = "" if observed.is_all else "more than "
        return f"{observed.least}..{observed.greatest}, {more}{count} values"
    return ", ".join(
        point.value([value]).text if point is not None else str(value) for value in observed.values
    )


def latency_side(sample: Sample) -> Side:
    """Return the median and the 95th percentile of latencies (ns), also as a text. The sample must
    not be empty.
    """
    ordered = sorted(sample.values)
    median, p95 = median_low(ordered), ordered[min(len(ordered) - 1, len(ordered) * 95 // 100)]
    return Side(
        text=f"{_milliseconds(median)}, p95 {_milliseconds(p95)}", median_ns=median, p95_ns=p95
    )


def _milliseconds(ns: int) -> str:
    return f"{ns / 1e6:.3g} ms" if ns < 10_000_000 else f"{ns / 1e6:,.0f} ms"
