"""What a device does that its profile's data cannot say, as the responder asks for it."""

# A Behaviour stands between the responder and the image of one device. This one adds nothing; a
# device's own overrides what differs:
#
#     own          functions that the standard's table of registers and bits has no place for
#     watches      whether it learns of each request: of `barred` before, of `answered` behind it
#     barred       an exception for any request, before it is looked at (check 0)
#     allows       whether a range may be read, or written (check 3)
#     refusal      an exception for a request that has passed every other check (check 4)
#     is_live      which reads give more than what the image holds
#     shown        what such a read gives
#     standing     what stands where a master writes, for a write that leaves part of it
#     store        where what a master writes goes
#     written      what that sets off
#     answered     what a request came to
#     units        which numbers it can have on a line
#     rules        the rules of its connections, where it has any
#     kept         what outlasts a restart
#     inputs_set   what is at its inputs has changed
#     outputs      what it puts out: for people, as no master reads it
#
# All of it is called from the thread of the slave, with the time as an argument; `outputs` from
# whichever thread shows them.
#
# Holds what `allows` has answered, for at most MAX_ALLOWED ranges: a profile's blocks take longer
# to look through than all the rest of a request.

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices import Access
from mbtool.devices.block_reads import can_be_read

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.modbus.register_access import RegisterAccess
    from mbtool.modbus.tables import Table
    from mbtool.slave.device.connection_policy import ConnectionPolicy
    from mbtool.slave.device.image import RegisterImage

MAX_ALLOWED = 4096

OwnFunction = Callable[[bytes, int], bytes | None]
"""Gets a request PDU and the time, gives the response PDU, or None for silence."""


@dataclass(frozen=True, slots=True)
class DeviceOutput:
    """What stands at one of a device's outputs."""

    name: str
    value: int
    text: str
    """The value as it leaves the device, with its unit."""


class Behaviour:
    """A device that does what its profile says and nothing else."""

    kept: tuple[tuple[Table, range], ...] = ()
    """The addresses whose values outlast a restart."""
    watches = False
    units = range(1, 248)
    """The unit numbers that it can be given on a serial line."""

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        self.profile = profile
        self.image = image
        self.own: Mapping[int, OwnFunction] = {}
        self.rules: ConnectionPolicy | None = None
        self.keep: Callable[[], None] | None = None
        """Stores what is `kept`; the device calls it when any of that has changed."""
        self._allowed: dict[tuple[Table, int, int, bool], bool] = {}
        """What `allows` has answered, at most MAX_ALLOWED."""
        self._has_write_areas = any(area.access is Access.WRITE for area in profile.areas)

    def barred(self, pdu: bytes, now_ns: int) -> int | None:
        """The exception code that a request gets whatever it is, or None; if it `watches`."""
        return None

    def allows(self, table: Table, span: range, *, writing: bool = False) -> bool:
        """Whether a master may read, or write, all of a range. The answer never changes."""
        asked = table, span.start, span.stop, writing
        known = self._allowed.get(asked)
        if known is None:
            if len(self._allowed) >= MAX_ALLOWED:
                self._allowed.clear()
            allows = (
                self.profile.allows(table, span, writing=True)
                if writing
                else (can_be_read(self.profile, table, span))
            )
            known = self._allowed[asked] = allows
        return known

    def refusal(
        self, function: int, reach: RegisterAccess, values: Sequence[int], now_ns: int
    ) -> int | None:
        """The exception code for a request that could be executed otherwise, or None.

        `values` are those that it would leave where it writes.
        """
        return None

    def is_live(self, table: Table, span: range) -> bool:
        """Whether a read of this range must ask `refusal` and `shown` each time.

        The answer for a range never changes.
        """
        return False

    def shown(self, table: Table, span: range, values: list[int], now_ns: int) -> list[int]:
        """What a master reads where a range is live; `values` is what the image holds."""
        return values

    def standing(self, table: Table, span: range) -> list[int]:
        """What stands where a master writes: a mask write (16) leaves part of it."""
        return self.image.get(table, span.start, len(span))

    def store(self, table: Table, span: range, values: Sequence[int]) -> None:
        """Keep what a master writes; the range is one that it may write.

        An address that is one thing to write and another to read keeps what is read: what was
        written there went out, and the image has no place for it.
        """
        if not self._has_write_areas:
            self.image.set(table, span.start, values)
            return
        for address, value in zip(span, values, strict=True):
            area = self.profile.area(table, address)
            if area is not None and area.access is not Access.READ:
                self.image.set(table, address, [value])

    def written(self, table: Table, span: range, now_ns: int) -> None:
        """Learn that a master has written a range, which is stored already."""

    def answered(self, pdu: bytes, response: bytes | None, now_ns: int) -> None:
        """Learn what a request came to; if it `watches`."""

    def inputs_set(self, now_ns: int) -> None:
        """Learn that inputs in the image may have been set; for a device that averages them."""

    def outputs(self) -> tuple[DeviceOutput, ...]:
        """What stands at the outputs."""
        return ()
