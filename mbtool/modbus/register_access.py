"""Finds the registers or bits that a request reads and writes, and makes its response."""

# Nothing here checks whether a device has these addresses; only the caller knows the device.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from mbtool.core import Direction
from mbtool.modbus.functions import (
    FUNCTIONS,
    READ_WRITE_REGISTERS,
    TABLE_FUNCTIONS,
    WRITE_LIMIT_17H,
)
from mbtool.modbus.layouts import COIL_VALUES
from mbtool.modbus.pdu import Pdu, encode_pdu
from mbtool.modbus.tables import ADDRESSES, Table


@dataclass(frozen=True, slots=True)
class RegisterAccess:
    """The addresses of one table that a request reads, and the addresses that it writes.

    A range is empty if the request reads, or writes, nothing.
    """

    table: Table
    reads: range = range(0)
    writes: range = range(0)


def register_access(request: Pdu) -> RegisterAccess | None:
    """Return the addresses that a request reads and writes.

    None if the request's function accesses no table, or if the request breaks the form of its
    function or the standard's limit of its quantity.
    """
    if request.code not in TABLE_FUNCTIONS or request.problem is not None:
        return None
    function = FUNCTIONS[request.code]
    table = cast("Table", function.table)
    addressed = _addresses(_number(request, "address"), request.number("quantity"))
    if request.code == READ_WRITE_REGISTERS:
        written = _addresses(_number(request, "write_address"), request.number("write_quantity"))
        access = RegisterAccess(table, addressed, written)
    elif function.writes:
        access = RegisterAccess(table, writes=addressed)
    else:
        access = RegisterAccess(table, reads=addressed)
    return access if _is_allowed(access, request, function.limit) else None


def keeps_limits(request: Pdu) -> bool:
    """True if a request has the form of its function and keeps the standard's limits.

    The limits are those of the quantity, and 65535 for the last address.
    """
    if request.code not in TABLE_FUNCTIONS:
        return request.problem is None
    access = register_access(request)
    return access is not None and max(access.reads.stop, access.writes.stop) <= ADDRESSES


def values_after(request: Pdu, before: Sequence[int]) -> tuple[int, ...]:
    """Return the values that the written addresses have after a request.

    `before` are their values before the request; only a mask write (16H), which changes some of the
    bits of a register, depends on them.
    """
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
    """The PDU of the response to a request that succeeds.

    `pdu` is the PDU of the request, `values` are the values of the addresses that it reads.
    """
    match request.code:
        case 0x05 | 0x06 | 0x16:
            return pdu
        case 0x0F | 0x10:
            return pdu[:5]  # Function code, address and quantity.
        case _:
            return encode_pdu(request.code, Direction.RESPONSE, values=tuple(values))


def _is_allowed(access: RegisterAccess, request: Pdu, limit: int) -> bool:
    """True if a request reads or writes at least 1 value and at most `limit` values.

    A request of 17H must do both, and may write at most WRITE_LIMIT_17H registers.
    """
    if request.code == READ_WRITE_REGISTERS:
        return 1 <= len(access.reads) <= limit and 1 <= len(access.writes) <= WRITE_LIMIT_17H
    return 1 <= len(access.reads or access.writes) <= limit


def _addresses(address: int, quantity: int | None) -> range:
    """The `quantity` addresses from `address` on; only `address` if `quantity` is None."""
    return range(address, address + (1 if quantity is None else quantity))


def _number(request: Pdu, name: str) -> int:
    return cast("int", request.fields[name])  # A well-formed PDU has every field.


def _values(request: Pdu) -> tuple[int, ...]:
    return cast("tuple[int, ...]", request.fields["values"])
