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

from typing import TYPE_CHECKING, cast

from mbtool.core import Direction
from mbtool.devices.model import Access
from mbtool.modbus.answer import Answer
from mbtool.modbus.functions import FUNCTIONS, WRITE_LIMIT_17H
from mbtool.modbus.pdu import encode_pdu, exception_pdu, parse_pdu
from mbtool.slave.behaviours import own_functions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import Profile
    from mbtool.modbus.pdu import Pdu
    from mbtool.modbus.tables import Table
    from mbtool.slave.image import RegisterImage

_COIL_VALUES = {0x0000: 0, 0xFF00: 1}  # V1.1b3, 6.5


class DeviceResponder:
    """One device. Its image may be read and written from outside between two requests."""

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        """Raises ProfileError where the profile names a behaviour that does not exist."""
        self._profile = profile
        self._own = own_functions(profile)
        self._served: dict[int, Callable[[Pdu, bytes], bytes]] = {
            **dict.fromkeys((0x01, 0x02, 0x03, 0x04), self._read),
            **dict.fromkeys((0x05, 0x06), self._write_one),
            **dict.fromkeys((0x0F, 0x10), self._write_several),
            0x16: self._mask_write,
            0x17: self._read_and_write,
        }
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
        function = pdu[0]
        own = self._own.get(function)
        served = self._served.get(function)
        if self._profile.rule(function) is None or (own is None and served is None):
            raise _RefusedError(self._profile.exceptions.function)
        if own is not None:
            return own(self._profile, pdu)
        assert served is not None
        request = parse_pdu(pdu, Direction.REQUEST)
        if request.problem is not None:
            raise _RefusedError(self._profile.exceptions.value)
        return served(request, pdu)

    def _read(self, request: Pdu, pdu: bytes) -> bytes:
        address, quantity = _number(request, "address"), _number(request, "quantity")
        self._demand_value(1 <= quantity <= self._limit(request.code))
        table = _table(request)
        self._demand_area(table, address, quantity)
        values = tuple(self.image.get(table, address, quantity))
        return encode_pdu(request.code, Direction.RESPONSE, values=values)

    def _write_one(self, request: Pdu, pdu: bytes) -> bytes:
        address, value = _number(request, "address"), _number(request, "value")
        table = _table(request)
        if table.is_bits:
            self._demand_value(value in _COIL_VALUES)
            value = _COIL_VALUES[value]
        self._demand_area(table, address, 1, writing=True)
        self.image.set(table, address, [value])
        return pdu

    def _write_several(self, request: Pdu, pdu: bytes) -> bytes:
        address, quantity = _number(request, "address"), _number(request, "quantity")
        table = _table(request)
        expected_bytes = (quantity + 7) // 8 if table.is_bits else 2 * quantity
        self._demand_value(1 <= quantity <= self._limit(request.code) and pdu[5] == expected_bytes)
        self._demand_area(table, address, quantity, writing=True)
        self.image.set(table, address, _values(request))
        return pdu[:5]

    def _mask_write(self, request: Pdu, pdu: bytes) -> bytes:
        address, table = _number(request, "address"), _table(request)
        and_mask, or_mask = _number(request, "and_mask"), _number(request, "or_mask")
        self._demand_area(table, address, 1, writing=True)
        (before,) = self.image.get(table, address)
        self.image.set(table, address, [(before & and_mask) | (or_mask & ~and_mask)])
        return pdu

    def _read_and_write(self, request: Pdu, pdu: bytes) -> bytes:
        address, quantity = _number(request, "address"), _number(request, "quantity")
        write_address = _number(request, "write_address")
        write_quantity = _number(request, "write_quantity")
        values, table = _values(request), _table(request)
        self._demand_value(
            1 <= quantity <= self._limit(request.code)
            and 1 <= write_quantity <= WRITE_LIMIT_17H
            and len(values) == write_quantity
        )
        self._demand_area(table, address, quantity)
        self._demand_area(table, write_address, write_quantity, writing=True)
        self.image.set(table, write_address, values)  # Before the read (6.17).
        read = tuple(self.image.get(table, address, quantity))
        return encode_pdu(request.code, Direction.RESPONSE, values=read)

    def _limit(self, function: int) -> int:
        rule = self._profile.rule(function)
        return (rule.limit if rule is not None else None) or FUNCTIONS[function].limit

    def _demand_value(self, allowed: bool) -> None:
        if not allowed:
            raise _RefusedError(self._profile.exceptions.value)

    def _demand_area(
        self, table: Table, address: int, quantity: int, *, writing: bool = False
    ) -> None:
        at = address
        while at < address + quantity:
            area = self._profile.area(table, at)
            if area is None or (writing and area.access is Access.READ):
                raise _RefusedError(self._profile.exceptions.address)
            at = area.last + 1


class _RefusedError(Exception):
    """The request gets an exception response with this code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def _table(request: Pdu) -> Table:
    return cast("Table", FUNCTIONS[request.code].table)


def _number(request: Pdu, name: str) -> int:
    return cast("int", request.fields[name])  # A PDU without a problem has every field.


def _values(request: Pdu) -> Sequence[int]:
    return cast("tuple[int, ...]", request.fields["values"])
