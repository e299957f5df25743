"""CHINO's LT830: which requests the device refuses, and its answer to the diagnosis function."""

# Source: the manual INST. No. INE-350, 6.3.1, 6.4 and 6.5.7, and the error codes of a similar
# model, as mbtool/devices/profiles/chino-lt830.toml quotes them.
#
#     reads     only the first address must exist; a missing one behind it reads as 0
#     writes    every address must exist, and one wrong value discards all values
#     08        diagnosis code 0000H returns its two bytes of data
#     11H       the exception for a value outside the range of its point in the profile
#     12H       the exception for a write to a read-only point in a writable area (assumed: the
#               similar model gives it while programming is disabled)
#
# The built-in profile has no ranges and no read-only points, as the manual's table of references
# was not available; a user's own profile that extends the built-in one can have them. Another
# diagnosis code than 0000H gets exception 01, as in the standard (V1.1b3, 6.8), and more or fewer
# than two bytes of data get 03; both are assumed.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mbtool.devices.profile_checks import holds_read_only_point, value_ranges, values_outside
from mbtool.devices.values import point_instances
from mbtool.modbus.pdu import exception_pdu
from mbtool.modbus.tables import ADDRESSES, Table
from mbtool.slave.device.behaviour import Behaviour

if TYPE_CHECKING:
    from mbtool.devices import PointInstance, PointValue, Profile
    from mbtool.modbus.register_access import RegisterAccess
    from mbtool.slave.device.image import RegisterImage

OUT_OF_RANGE = 0x11
PROGRAMMING_DISABLED = 0x12

_DIAGNOSIS_CODE = b"\0\0"
_DIAGNOSIS_BYTES = 5


class Lt830(Behaviour):
    """The behaviour of an LT830, a digital indicating controller."""

    units = range(1, 100)

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        self.own = {0x08: self._diagnose}
        self._ranges = value_ranges(profile)
        self._ranged = {
            table: [
                place
                for place in point_instances(profile, table, writing=True)
                if place.name in self._ranges
            ]
            for table in Table
        }

    def allows(self, table: Table, span: range, *, writing: bool = False) -> bool:
        if writing:
            return super().allows(table, span, writing=True)
        return span.stop <= ADDRESSES and super().allows(table, span[:1])

    def refusal(
        self, function: int, access: RegisterAccess, values: Sequence[int], now_ns: int
    ) -> int | None:
        table, writes = access.table, access.writes
        if holds_read_only_point(self.profile, table, writes):
            return PROGRAMMING_DISABLED
        touched = [
            self._value_after_write(place, table, writes, values)
            for place in self._ranged[table]
            if place.address < writes.stop and writes.start < place.address + place.words
        ]
        return OUT_OF_RANGE if values_outside(self._ranges, touched) else None

    def _value_after_write(
        self, place: PointInstance, table: Table, writes: range, values: Sequence[int]
    ) -> PointValue:
        """Return the value that the point at `place` would have after a write.

        The write puts `values` into the addresses `writes`, which may be part of the point.
        """
        raw = self.image.get(table, place.address, place.words)
        for at in range(place.words):
            if place.address + at in writes:
                raw[at] = values[place.address + at - writes.start]
        return place.value(raw)

    def _diagnose(self, pdu: bytes, now_ns: int) -> bytes:
        if pdu[1:3] != _DIAGNOSIS_CODE:
            return exception_pdu(pdu[0], self.profile.exceptions.function)
        if len(pdu) != _DIAGNOSIS_BYTES:
            return exception_pdu(pdu[0], self.profile.exceptions.value)
        return pdu
