"""Answers requests as a device does, from its profile and its register image."""

# The standard's order of checks (V1.1b3, section 7 and the state diagrams of section 6):
#
#     0  device     it takes requests at all (behaviour.py)                   its own
#     1  function   the profile has it                                        exceptions.function
#     2  value      form, quantity, byte count and value are allowed          exceptions.value
#     3  address    every address of the range lies in an area of the table,
#                   and the area may be written where the function writes     exceptions.address
#     4  execution  what the device's behaviour refuses (behaviour.py)        its own
#
# Which code stands for which check is the profile's to say: FT1A Touch, for one, knows only 01 and
# 02. Nothing is written before every check has passed, so a refused write leaves the image alone.
# A range may run from one area into the next where no hole lies between them.
#
# Served: 01-06, 0F, 10, 16, 17, and the functions of the device's own (behaviours.py). A function
# that a profile lists beyond these gets the answer of one that the device lacks.
#
# Masters ask for the same few ranges again and again. A read that has passed its checks passes them
# the next time too, as profiles do not change, so the responder remembers which bytes ask for which
# range: at most MAX_KNOWN requests, then it begins anew. Reads that a behaviour calls live are not
# remembered.
#
# The unit is whoever called's matter (units.py): a responder is one device.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.functions import READS, TABLE_FUNCTIONS
from mbtool.modbus.pdu import exception_pdu, parse_pdu
from mbtool.modbus.register_access import register_access, response_to, values_after
from mbtool.modbus.response import Response
from mbtool.slave.device.image import packed_bits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import FunctionRule
    from mbtool.modbus.pdu import Pdu
    from mbtool.modbus.register_access import RegisterAccess
    from mbtool.modbus.tables import Table
    from mbtool.slave.device.behaviour import Behaviour

MAX_KNOWN = 4096

_PLAIN_READS = READS - {0x17}
"""Functions whose response is a byte count and what they read."""


_Known = tuple[bytes, bytearray, slice, bool]
"""Of a read: the head of the response, where the rest stands, and whether that is bits."""


class DeviceResponder:
    """One device. Its image may be read and written from outside between two requests."""

    def __init__(self, behaviour: Behaviour) -> None:
        self._profile = behaviour.profile
        self.behaviour = behaviour
        self.image = behaviour.image
        self._known: dict[bytes, _Known] = {}
        """Of reads by their PDU."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        """Answer a request PDU whatever its unit, or None where the device stays silent."""
        known = self._known.get(pdu)
        if known is not None and not self.behaviour.watches:
            return Response(_response(known))
        if not pdu:
            return None
        try:
            response = self._respond(pdu, now_ns, known)
        except _RefusedError as refused:
            response = exception_pdu(pdu[0], refused.code)
        if self.behaviour.watches:
            self.behaviour.answered(pdu, response, now_ns)
        return None if response is None else Response(response)

    def _respond(self, pdu: bytes, now_ns: int, known: _Known | None) -> bytes | None:
        exceptions = self._profile.exceptions
        function = pdu[0]
        if self.behaviour.watches:
            barred = self.behaviour.barred(pdu, now_ns)
            if barred is not None:
                raise _RefusedError(barred)
        if known is not None:
            return _response(known)
        rule = self._profile.rule(function)
        own = self.behaviour.own.get(function)
        if rule is None or (own is None and function not in TABLE_FUNCTIONS):
            raise _RefusedError(exceptions.function)
        if own is not None:
            return own(pdu, now_ns)
        request = parse_pdu(pdu, Direction.REQUEST)
        reach = register_access(request)
        if reach is None or _is_beyond(rule, reach):
            raise _RefusedError(exceptions.value)
        self._demand_area(reach.table, reach.reads)
        self._demand_area(reach.table, reach.writes, writing=True)
        written: tuple[int, ...] = ()
        if reach.writes:
            written = values_after(request, self.behaviour.standing(reach.table, reach.writes))
        refusal = self.behaviour.refusal(function, reach, written, now_ns)
        if refusal is not None:
            raise _RefusedError(refusal)
        return self._execute(request, reach, written, pdu, now_ns)

    def _demand_area(self, table: Table, span: range, *, writing: bool = False) -> None:
        if not self.behaviour.allows(table, span, writing=writing):
            raise _RefusedError(self._profile.exceptions.address)

    def _execute(
        self, request: Pdu, reach: RegisterAccess, written: Sequence[int], pdu: bytes, now_ns: int
    ) -> bytes:
        table, reads, writes = reach.table, reach.reads, reach.writes
        if writes:  # Before the read, where a function does both (6.17).
            self.behaviour.store(table, writes, written)
            self.behaviour.written(table, writes, now_ns)
        values: list[int] = []
        if reads:
            block = self.image.blocks.get(table, reads)
            values = block or self.image.get(table, reads.start, len(reads))
            if self.behaviour.is_live(table, reads):
                values = self.behaviour.shown(table, reads, values, now_ns)
            elif block is None and request.code in _PLAIN_READS:
                self._remember(pdu, reach)
        return response_to(request, pdu, values)

    def _remember(self, pdu: bytes, reach: RegisterAccess) -> None:
        if len(self._known) >= MAX_KNOWN:
            self._known.clear()
        quantity = len(reach.reads)
        count = (quantity + 7) // 8 if reach.table.is_bits else 2 * quantity
        cells, part = self.image.cells(reach.table, reach.reads)
        self._known[pdu] = bytes([pdu[0], count]), cells, part, reach.table.is_bits


class _RefusedError(Exception):
    """The request gets an exception response with this code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def _response(known: _Known) -> bytes:
    head, cells, part, is_bits = known
    return head + (packed_bits(cells[part]) if is_bits else cells[part])


def _is_beyond(rule: FunctionRule, reach: RegisterAccess) -> bool:
    """Whether a quantity is more than the profile allows; `limit` is of reads, if there are any."""
    if rule.limit is not None and len(reach.reads or reach.writes) > rule.limit:
        return True
    if rule.write_limit is None or not reach.reads:
        return False
    return len(reach.writes) > rule.write_limit
