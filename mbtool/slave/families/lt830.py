"""What CHINO's LT830 does beyond its registers: its rules for several items, values and access."""

# Source: INST. No. INE-350, 6.3.1, 6.4 and 6.5.7, and the error codes of a sister model, as
# mbtool/devices/profiles/chino-lt830.toml quotes them.
#
#     reads     only the start number must exist; of those behind it one that does not reads as 0
#     writes    an error in one value discards all of them, and each number must exist
#     08        diagnosis code 0000H, whose two bytes of data come back
#     11H       a value outside the range that its point has in the profile
#     12H       a point that the profile lets nobody write, in an area that one may write (assumed:
#               the sister model says it while programming is disabled)
#
# The built-in profile states no ranges and no such points, as the table of references was not at
# hand; one of the user's own that extends it can. Another diagnosis code gets 01, which is the
# standard's (V1.1b3, 6.8), other than two bytes of data 03; both are assumed.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices.profile_checks import holds_read_only_point, value_ranges, values_outside
from mbtool.devices.values import point_instances
from mbtool.modbus.pdu import exception_pdu
from mbtool.modbus.tables import Table
from mbtool.slave.device.behaviour import Behaviour
from mbtool.slave.device.image import ADDRESSES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import PointInstance, PointValue, Profile
    from mbtool.modbus.register_access import RegisterAccess
    from mbtool.slave.device.image import RegisterImage

OUT_OF_RANGE = 0x11
PROGRAMMING_DISABLED = 0x12

_DIAGNOSIS_CODE = b"\0\0"
_DIAGNOSIS_BYTES = 5


class Lt830(Behaviour):
    """A digital indicating controller."""

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
        self, function: int, reach: RegisterAccess, values: Sequence[int], now_ns: int
    ) -> int | None:
        table, writes = reach.table, reach.writes
        if holds_read_only_point(self.profile, table, writes):
            return PROGRAMMING_DISABLED
        touched = [
            self._after(place, table, writes, values)
            for place in self._ranged[table]
            if place.address < writes.stop and writes.start < place.address + place.words
        ]
        return OUT_OF_RANGE if values_outside(self._ranges, touched) else None

    def _after(
        self, place: PointInstance, table: Table, writes: range, values: Sequence[int]
    ) -> PointValue:
        """What a place would hold after a write, of which some of its registers may be no part."""
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
