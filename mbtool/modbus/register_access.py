"""Which registers or bits a request reads and writes, what it leaves there, and its response."""

# REACHING lists the functions whose form says where they read and write (V1.1b3, section 6). What
# a mask write (16) leaves depends on what was there before. Whether the addresses exist is for the
# one who asks: a device's areas, or what a recording has seen.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from mbtool.core import Direction
from mbtool.modbus.functions import FUNCTIONS, WRITE_LIMIT_17H
from mbtool.modbus.layouts import COIL_VALUES
from mbtool.modbus.pdu import encode_pdu
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.modbus.pdu import Pdu

REACHING = frozenset({0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F, 0x10, 0x16, 0x17})

ADDRESSES = 0x10000
"""How many addresses a table has."""


@dataclass(frozen=True, slots=True)
class RegisterAccess:
    """The addresses that a request reads and those that it writes, of one table."""

    table: Table
    reads: range = range(0)
    writes: range = range(0)


def register_access(request: Pdu) -> RegisterAccess | None:
    """What a request reaches; None where it is not among REACHING, or breaks its form or limits."""
    if request.code not in REACHING or request.problem is not None:
        return None
    function = FUNCTIONS[request.code]
    table, address = cast("Table", function.table), _number(request, "address")
    match request.code:
        case 0x01 | 0x02 | 0x03 | 0x04:
            reach = RegisterAccess(table, reads=_span(address, _number(request, "quantity")))
        case 0x05 if _number(request, "value") not in COIL_VALUES:
            return None
        case 0x05 | 0x06 | 0x16:
            reach = RegisterAccess(table, writes=_span(address, 1))
        case 0x0F | 0x10:
            reach = RegisterAccess(table, writes=_span(address, _number(request, "quantity")))
        case _:  # 17
            reach = RegisterAccess(
                table,
                reads=_span(address, _number(request, "quantity")),
                writes=_span(_number(request, "write_address"), _number(request, "write_quantity")),
            )
    return reach if _is_allowed(reach, request, function.limit) else None


def keeps_limits(request: Pdu) -> bool:
    """Whether a request keeps its form and the standard's limits, the last address among them."""
    if request.code not in REACHING:
        return request.problem is None
    reach = register_access(request)
    return reach is not None and max(reach.reads.stop, reach.writes.stop) <= ADDRESSES


def values_after(request: Pdu, before: Sequence[int]) -> tuple[int, ...]:
    """What a request leaves in the range that it writes; `before` is what stands there."""
    match request.code:
        case 0x05:
            return (COIL_VALUES[_number(request, "value")],)
        case 0x06:
            return (_number(request, "value"),)
        case 0x16:
            and_mask, or_mask = _number(request, "and_mask"), _number(request, "or_mask")
            return ((before[0] & and_mask) | (or_mask & ~and_mask),)
        case _:
            return _values(request)


def response_to(request: Pdu, pdu: bytes, values: Sequence[int]) -> bytes:
    """The standard's response to a request that went well; `values` are those that it reads."""
    match request.code:
        case 0x05 | 0x06 | 0x16:
            return pdu
        case 0x0F | 0x10:
            return pdu[:5]
        case _:
            return encode_pdu(request.code, Direction.RESPONSE, values=tuple(values))


def _is_allowed(reach: RegisterAccess, request: Pdu, limit: int) -> bool:
    """Whether the quantities are within the standard's limits."""
    if request.code == 0x17:
        return 1 <= len(reach.reads) <= limit and 1 <= len(reach.writes) <= WRITE_LIMIT_17H
    return 1 <= len(reach.reads or reach.writes) <= limit


def _span(address: int, quantity: int) -> range:
    return range(address, address + quantity)


def _number(request: Pdu, name: str) -> int:
    return cast("int", request.fields[name])  # A PDU without a problem has every field.


def _values(request: Pdu) -> tuple[int, ...]:
    return cast("tuple[int, ...]", request.fields["values"])
