"""The base class of what a simulated device does beyond its profile: methods that the responder
calls.
"""

# A profile lists the registers, functions and exceptions of a device. A Behaviour adds code for
# what a list cannot describe, such as an output that follows a register. The base class adds
# nothing; the class of a device family overrides some of these members:
#
#     own          the functions that neither read nor write registers or bits, by function code
#     watches      True if `barred` and `answered` are to be called for each request
#     barred       the exception for any request, checked first (check 0 of responder.py)
#     allows       True if a range may be read, or written (check 3)
#     refusal      the exception for a request that has passed every other check (check 4)
#     is_live      True if a read of a range may give other values than the image holds
#     shown        the values that such a read gives
#     standing     the values that a write replaces; a mask write (16H) keeps some of their bits
#     store        stores what a master writes
#     written      called after a write
#     answered     called with each request and its response
#     units        the unit numbers that the device can have on a serial line
#     rules        the device's rules for TCP connections, if it has any
#     kept         the addresses whose values survive a restart
#     inputs_set   called when values at the device's inputs may have changed
#     outputs      the state of the device's outputs; shown to people, no master reads it
#
# All methods run in the slave's thread, and those that need the time get it as an argument. Only
# `outputs` may be called from another thread.
#
# Memory: the results of `allows` for at most MAX_ALLOWED ranges. They are kept because searching
# the profile's areas and blocks takes longer than all other work on a request.

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices import Access, Profile
from mbtool.devices.block_reads import can_be_read

if TYPE_CHECKING:
    from mbtool.modbus.register_access import RegisterAccess
    from mbtool.modbus.tables import Table
    from mbtool.slave.device.connection_policy import ConnectionPolicy
    from mbtool.slave.device.image import RegisterImage

MAX_ALLOWED = 4096

OwnFunction = Callable[[bytes, int], bytes | None]
"""Takes a request PDU and the time in ns; returns the response PDU, or None for no response."""


@dataclass(frozen=True, slots=True)
class DeviceOutput:
    """The state of one of a device's outputs."""

    name: str
    value: int
    text: str
    """The value as text for people, with its unit, such as "1.900 V" or "on"."""


class Behaviour:
    """A device that does only what its profile says; the base class of all device families."""

    kept: tuple[tuple[Table, range], ...] = ()
    """The address ranges whose values survive a restart of the simulated device."""
    watches = False
    units = range(1, 248)
    """The unit numbers that the device can have on a serial line."""

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        self.profile = profile
        self.image = image
        self.own: Mapping[int, OwnFunction] = {}
        self.rules: ConnectionPolicy | None = None
        self.keep: Callable[[], None] | None = None
        """Called when a register in `kept` has changed: saves them to a file. None if nothing is
        saved."""
        self._allowed: dict[tuple[Table, int, int, bool], bool] = {}
        """Results of `allows` by its arguments: table, first address, address behind the last,
        `writing`. At most MAX_ALLOWED; when there are more, all are forgotten."""
        self._has_write_areas = any(area.access is Access.WRITE for area in profile.areas)

    def barred(self, pdu: bytes, now_ns: int) -> int | None:
        """Return the exception code with which `pdu` is refused before any other check, or None.

        Called only if `watches`.
        """
        return None

    def allows(self, table: Table, span: range, *, writing: bool = False) -> bool:
        """True if a master may read (with `writing`: write) all addresses of `span` in the table.

        The result never changes.
        """
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
        self, function: int, access: RegisterAccess, values: Sequence[int], now_ns: int
    ) -> int | None:
        """Return the exception code for a request that has passed all other checks, or None.

        `function` is its function code, `access` has the addresses that it reads and writes, and
        `values` are the contents that the written addresses would have after it.
        """
        return None

    def is_live(self, table: Table, span: range) -> bool:
        """True if a read of this range may return other values than the image holds.

        Then each read of it calls `refusal` and `shown`. The result for a range never changes.
        """
        return False

    def shown(self, table: Table, span: range, values: list[int], now_ns: int) -> list[int]:
        """Return the values that a master reads from the addresses `span`.

        It is called if `is_live` is True for them. `values` are those in the image, and may be
        changed and returned.
        """
        return values

    def present_values(self, table: Table, span: range) -> list[int]:
        """Return the present values of the registers or bits that a write to `span` would replace.

        A mask write (16H) needs them, as it changes only some bits of a register.
        """
        return self.image.get(table, span.start, len(span))

    def store(self, table: Table, span: range, values: Sequence[int]) -> None:
        """Store the values that a master writes to a range that `allows` permits.

        Some addresses have one register for reads and another for writes. The image holds the one
        for reads, so a value written to such an address is not stored.
        """
        if not self._has_write_areas:
            self.image.set(table, span.start, values)
            return
        for address, value in zip(span, values, strict=True):
            area = self.profile.area(table, address)
            if area is not None and area.access is not Access.READ:
                self.image.set(table, address, [value])

    def written(self, table: Table, span: range, now_ns: int) -> None:
        """Called after a master has written the addresses `span` and `store` was called."""

    def answered(self, pdu: bytes, response: bytes | None, now_ns: int) -> None:
        """Called with each request PDU and its response PDU, if `watches` is True.

        `response` is None if the request gets no response.
        """

    def inputs_set(self, now_ns: int) -> None:
        """Called when input values in the image may have changed.

        A device that averages its inputs must know when they change.
        """

    def outputs(self) -> tuple[DeviceOutput, ...]:
        """Return the state of all outputs of the device, to be shown to people."""
        return ()
