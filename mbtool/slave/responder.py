"""Answers requests as a device does, from its profile and its register image."""

# The standard's order of checks (V1.1b3, section 7 and the state diagrams of section 6):
#
#     1  function   the profile has it                                        exceptions.function
#     2  value      form, quantity, byte count and value are allowed          exceptions.value
#     3  address    every address of the range lies in an area of the table,
#                   and the area may be written where the function writes     exceptions.address
#     4  execution
#
# Which code stands for which check is the profile's to say: FT1A Touch, for one, knows only 01 and
# 02. Nothing is written before every check has passed, so a refused write leaves the image alone.
# A range may run from one area into the next where no hole lies between them.
#
# Served: 01-06, 0F, 10, 16, 17, and the functions of the device's own (behaviours.py). A function
# that a profile lists beyond these gets the answer of one that the device lacks.
#
# The unit is whoever called's matter (units.py): a responder is one device.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.answer import Answer
from mbtool.modbus.pdu import exception_pdu, parse_pdu
from mbtool.modbus.reach import REACHING, reach_of, response_to, values_after
from mbtool.slave.behaviours import own_functions

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.modbus.reach import Reach
    from mbtool.modbus.tables import Table
    from mbtool.slave.image import RegisterImage


class DeviceResponder:
    """One device. Its image may be read and written from outside between two requests."""

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        """Raises ProfileError where the profile names a behaviour that does not exist."""
        self._profile = profile
        self._own = own_functions(profile)
        self.image = image

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Answer | None:
        """Answer a request PDU whatever its unit, or None where the device stays silent."""
        if not pdu:
            return None
        try:
            response = self._respond(pdu)
        except _RefusedError as refused:
            response = exception_pdu(pdu[0], refused.code)
        return None if response is None else Answer(response)

    def _respond(self, pdu: bytes) -> bytes | None:
        exceptions = self._profile.exceptions
        function = pdu[0]
        rule = self._profile.rule(function)
        own = self._own.get(function)
        if rule is None or (own is None and function not in REACHING):
            raise _RefusedError(exceptions.function)
        if own is not None:
            return own(self._profile, pdu)
        request = parse_pdu(pdu, Direction.REQUEST)
        reach = reach_of(request)
        if reach is None or (rule.limit is not None and _quantity(reach) > rule.limit):
            raise _RefusedError(exceptions.value)
        self._demand_area(reach.table, reach.reads)
        self._demand_area(reach.table, reach.writes, writing=True)
        if reach.writes:  # Before the read, where a function does both (6.17).
            before = self.image.get(reach.table, reach.writes.start, len(reach.writes))
            self.image.set(reach.table, reach.writes.start, values_after(request, before))
        read = []
        if reach.reads:
            read = self.image.get(reach.table, reach.reads.start, len(reach.reads))
        return response_to(request, pdu, read)

    def _demand_area(self, table: Table, span: range, *, writing: bool = False) -> None:
        if not self._profile.allows(table, span, writing=writing):
            raise _RefusedError(self._profile.exceptions.address)


class _RefusedError(Exception):
    """The request gets an exception response with this code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def _quantity(reach: Reach) -> int:
    """What a profile's limit is about: the reads, where a function does both."""
    return len(reach.reads or reach.writes)
