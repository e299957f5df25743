"""Answers requests as the simulated device would, from its profile and its register image."""

# The checks, in the standard's order (V1.1b3, section 7 and the state diagrams of section 6):
#
#     0  device     the device accepts requests at all (Behaviour.barred)      the behaviour's code
#     1  function   the profile has the function                               exceptions.function
#     2  value      form, quantity, byte count and value are allowed           exceptions.value,
#                                                                               or the function's
#     3  address    every address lies in an area of the table, and the area
#                   may be written if the function writes                      exceptions.address
#     4  execution  the behaviour refuses it (Behaviour.refusal)               the behaviour's code
#
# The profile says which exception code each check gives; FT1A Touch, for example, has only 01 and
# 02. Nothing is written before every check has passed. A request may span several areas of the
# profile if there is no address without an area between them.
#
# Functions answered: 01-06, 0F, 10, 16, 17, and the device's own (Behaviour.own). Any other gets
# exceptions.function, even if the profile lists it.
#
# Masters poll the same few ranges. A read that has passed its checks once always passes them, as
# profiles do not change. So for at most MAX_KNOWN request PDUs the responder remembers where in the
# image the values are, and skips the checks; with more, it forgets all of them. A read whose values
# may differ from the image (Behaviour.is_live) is not remembered.
#
# A responder is one device. It ignores the unit number: Units (below) passes it only its own
# requests.

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from mbtool.core import Direction, SerialLink, TcpLink
from mbtool.modbus.functions import READ_WRITE_REGISTERS, READS, TABLE_FUNCTIONS
from mbtool.modbus.pdu import Pdu, exception_pdu, parse_pdu
from mbtool.modbus.register_access import RegisterAccess, register_access, response_to, values_after
from mbtool.modbus.response import Responder, Response
from mbtool.slave.device.image import packed_bits

if TYPE_CHECKING:
    from mbtool.devices import FunctionRule, Profile
    from mbtool.modbus.tables import Table
    from mbtool.slave.device.behaviour import Behaviour

MAX_KNOWN = 4096

_PLAIN_READS = READS - {READ_WRITE_REGISTERS}
"""Functions that only read, not 17H: the response consists of a byte count and the values."""


_Known = tuple[bytes, bytearray, slice, bool]
"""The parts of the response to a read that has passed its checks before: the first two bytes of the
response (function code and byte count), the bytes of the whole table, the slice of them that holds
the values, and True if the values are bits."""


class DeviceResponder:
    """A simulated device that answers requests from its register image.

    Between two requests, other code may change the image, such as that of changing values.
    """

    def __init__(self, behaviour: Behaviour) -> None:
        self._profile = behaviour.profile
        self.behaviour = behaviour
        self.image = behaviour.image
        self._known: dict[bytes, _Known] = {}
        """The parts of the responses to reads that have passed all checks once, by request PDU."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        """Return the response to a request PDU, or None if there is none. `unit` is ignored."""
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
        access = register_access(request)
        if access is None or _is_beyond(rule, access):
            raise _RefusedError(self._profile.value_exception(function))
        self._demand_area(access.table, access.reads)
        self._demand_area(access.table, access.writes, writing=True)
        written: tuple[int, ...] = ()
        if access.writes:
            written = values_after(
                request, self.behaviour.present_values(access.table, access.writes)
            )
        refusal = self.behaviour.refusal(function, access, written, now_ns)
        if refusal is not None:
            raise _RefusedError(refusal)
        return self._execute(request, access, written, pdu, now_ns)

    def _demand_area(self, table: Table, span: range, *, writing: bool = False) -> None:
        if not self.behaviour.allows(table, span, writing=writing):
            raise _RefusedError(self._profile.exceptions.address)

    def _execute(
        self, request: Pdu, access: RegisterAccess, written: Sequence[int], pdu: bytes, now_ns: int
    ) -> bytes:
        table, reads, writes = access.table, access.reads, access.writes
        if writes:  # Function 17H writes before it reads (V1.1b3, 6.17).
            self.behaviour.store(table, writes, written)
            self.behaviour.written(table, writes, now_ns)
        values: list[int] = []
        if reads:
            block = self.image.blocks.get(table, reads)
            values = block or self.image.get(table, reads.start, len(reads))
            if self.behaviour.is_live(table, reads):
                values = self.behaviour.shown(table, reads, values, now_ns)
            elif block is None and request.code in _PLAIN_READS:
                self._remember(pdu, access)
        return response_to(request, pdu, values)

    def _remember(self, pdu: bytes, access: RegisterAccess) -> None:
        if len(self._known) >= MAX_KNOWN:
            self._known.clear()
        quantity = len(access.reads)
        count = (quantity + 7) // 8 if access.table.is_bits else 2 * quantity
        cells, part = self.image.cells(access.table, access.reads)
        self._known[pdu] = bytes([pdu[0], count]), cells, part, access.table.is_bits


class _RefusedError(Exception):
    """Raised if a check fails: the request gets an exception response with this code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def _response(known: _Known) -> bytes:
    head, cells, part, is_bits = known
    return head + (packed_bits(cells[part]) if is_bits else cells[part])


def _is_beyond(rule: FunctionRule, access: RegisterAccess) -> bool:
    """True if a request reads or writes more values than the profile's limits permit.

    `rule.limit` limits the values read, or, if the request only writes, the values written. It is
    ignored if the profile marks it as doubtful. `rule.write_limit` limits the values written by a
    request that also reads (17H).
    """
    limit = None if rule.doubtful else rule.limit
    if limit is not None and len(access.reads or access.writes) > limit:
        return True
    if rule.write_limit is None or not access.reads:
        return False
    return len(access.writes) > rule.write_limit


# The code below passes each request to the right slave, where several slaves share a serial line or
# endpoint.
#
# A responder is one device and answers requests for any unit. Units selects the responder for each
# request, by the rules of the link:
#
#     serial line   unit 0 is a broadcast: every slave executes it and none answers (Serial Line
#                   V1.02, 2.1). A unit that no slave here has belongs to another slave: silence.
#     TCP           unit 0 is a unit like any other. A device that answers any unit (FA3) gets the
#                   requests for units that no other slave has. All others get silence.
#
# RTU over TCP follows the rules of a serial line.

BROADCAST_UNIT = 0


class Units:
    """Passes each request to the slave with the request's unit number; is itself a responder."""

    def __init__(
        self,
        slaves: Mapping[int, Responder],
        *,
        any_unit: Responder | None = None,
        broadcast: bool = False,
    ) -> None:
        """Take the slaves by unit number.

        `any_unit` answers requests for units that `slaves` does not have; None for no response. If
        `broadcast` is true, all slaves execute a request for unit 0, and none answers.
        """
        self._slaves = dict(slaves)
        self._any_unit = any_unit
        self._broadcast = broadcast

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        if self._broadcast and unit == BROADCAST_UNIT:
            for each in self._slaves.values():
                each.respond(unit, pdu, now_ns)
            return None
        slave = self._slaves.get(unit) or self._any_unit
        return slave.respond(unit, pdu, now_ns) if slave is not None else None


def units_on(
    link: SerialLink | TcpLink,
    profile: Profile,
    unit: int,
    device: Responder,
    others: Mapping[int, Responder] | None = None,
) -> Units:
    """Return a responder for a device with the number `unit` and other slaves on the same link.

    `others` has those other slaves by unit; None if there are none. Requests are passed on by the
    rules of the link (see the top of this file). A device whose
    profile says that it answers any unit gets the requests for units that no other slave has.
    """
    serial = is_line(link)
    any_unit = device if profile.any_unit and not serial else None
    return Units({**(others or {}), unit: device}, any_unit=any_unit, broadcast=serial)


def is_line(link: SerialLink | TcpLink) -> bool:
    """True for a link that follows the rules of a serial line: serial, or RTU over TCP."""
    return isinstance(link, SerialLink) or link.rtu
