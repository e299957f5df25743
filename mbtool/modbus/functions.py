"""The functions of Modbus: names, tables, limits and layouts, in one table."""

# Source: MODBUS Application Protocol V1.1b3; the comment of each entry names the section. Codes 65
# to 72 and 100 to 110 are user-defined (section 5.1). The data of a function without an entry is
# kept as bytes.

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from mbtool.modbus.layouts import (
    Bits,
    Bytes,
    Choice,
    CoilValue,
    FileGroups,
    FileResponses,
    Layout,
    Objects,
    Registers,
    UncountedRegisters,
)
from mbtool.modbus.tables import Table

EXCEPTION_BIT = 0x80

WRITE_SINGLE_COIL = 0x05
DIAGNOSTICS = 0x08
MASK_WRITE_REGISTER = 0x16
READ_WRITE_REGISTERS = 0x17
FORCE_LISTEN_ONLY = 4
"""The sub-function of DIAGNOSTICS that has no response (V1.1b3, 6.8.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Function:
    """The properties of one function code in the standard."""

    name: str
    short: str
    """A short form of the name, for narrow columns."""
    request: Layout
    response: Layout
    table: Table | None = None
    """The table that the function's addresses belong to; None if the function has no addresses in a
    table."""
    limit: int = 1
    """The most registers or bits that a request may read or write. For 17H, which does both, the
    most that it may read; WRITE_LIMIT_17H limits what it writes."""
    writes: bool = False
    """True if a request writes registers or coils of the slave."""
    serial_only: bool = False
    """True if the standard defines the function for serial lines only."""


ADDRESS = ("address", 2)
QUANTITY = ("quantity", 2)
VALUE = ("value", 2)

_READ = Layout(ADDRESS, QUANTITY)
_WRITE_ONE = Layout(ADDRESS, VALUE)
_MASKS = Layout(ADDRESS, ("and_mask", 2), ("or_mask", 2))
_DIAGNOSTICS = Layout(("sub_function", 2), tail=UncountedRegisters())
_EMPTY = Layout()

FUNCTIONS: dict[int, Function] = {  # Comments give the section of the standard.
    0x01: Function(  # V1.1b3, 6.1
        name="read coils", short="read coils", table=Table.COILS, limit=2000,
        request=_READ, response=Layout(tail=Bits()),
    ),
    0x02: Function(  # V1.1b3, 6.2
        name="read discrete inputs", short="read discrete", table=Table.DISCRETE_INPUTS, limit=2000,
        request=_READ, response=Layout(tail=Bits()),
    ),
    0x03: Function(  # V1.1b3, 6.3
        name="read holding registers", short="read holding",
        table=Table.HOLDING_REGISTERS, limit=125,
        request=_READ, response=Layout(tail=Registers()),
    ),
    0x04: Function(  # V1.1b3, 6.4
        name="read input registers", short="read input", table=Table.INPUT_REGISTERS, limit=125,
        request=_READ, response=Layout(tail=Registers()),
    ),
    0x05: Function(  # V1.1b3, 6.5
        name="write single coil", short="write coil", table=Table.COILS, writes=True,
        request=Layout(ADDRESS, tail=CoilValue()), response=_WRITE_ONE,
    ),
    0x06: Function(  # V1.1b3, 6.6
        name="write single register", short="write register", table=Table.HOLDING_REGISTERS,
        writes=True, request=_WRITE_ONE, response=_WRITE_ONE,
    ),
    0x07: Function(  # V1.1b3, 6.7
        name="read exception status", short="read exc status", serial_only=True,
        request=_EMPTY, response=Layout(("status", 1)),
    ),
    0x08: Function(  # V1.1b3, 6.8
        name="diagnostics", short="diagnostics", serial_only=True,
        request=_DIAGNOSTICS, response=_DIAGNOSTICS,
    ),
    0x0B: Function(  # V1.1b3, 6.9
        name="get comm event counter", short="event counter", serial_only=True,
        request=_EMPTY, response=Layout(("status", 2), ("event_count", 2)),
    ),
    0x0C: Function(  # V1.1b3, 6.10
        name="get comm event log", short="event log", serial_only=True,
        request=_EMPTY, response=Layout(tail=Bytes()),
    ),
    0x0F: Function(  # V1.1b3, 6.11
        name="write multiple coils", short="write coils", table=Table.COILS,
        limit=1968, writes=True,
        request=Layout(ADDRESS, QUANTITY, tail=Bits(quantity="quantity")), response=_READ,
    ),
    0x10: Function(  # V1.1b3, 6.12
        name="write multiple registers", short="write registers", table=Table.HOLDING_REGISTERS,
        limit=123, writes=True,
        request=Layout(ADDRESS, QUANTITY, tail=Registers(quantity="quantity")), response=_READ,
    ),
    0x11: Function(  # V1.1b3, 6.13
        name="report server id", short="report server id", serial_only=True,
        request=_EMPTY, response=Layout(tail=Bytes()),
    ),
    0x14: Function(  # V1.1b3, 6.14
        name="read file record", short="read file",
        request=Layout(tail=FileGroups(with_data=False)), response=Layout(tail=FileResponses()),
    ),
    0x15: Function(  # V1.1b3, 6.15
        name="write file record", short="write file", writes=True,
        request=Layout(tail=FileGroups(with_data=True)),
        response=Layout(tail=FileGroups(with_data=True)),
    ),
    0x16: Function(  # V1.1b3, 6.16
        name="mask write register", short="mask write", table=Table.HOLDING_REGISTERS, writes=True,
        request=_MASKS, response=_MASKS,
    ),
    0x17: Function(  # V1.1b3, 6.17
        name="read/write multiple registers", short="read/write", table=Table.HOLDING_REGISTERS,
        limit=125, writes=True,
        request=Layout(
            ADDRESS, QUANTITY, ("write_address", 2), ("write_quantity", 2),
            tail=Registers(quantity="write_quantity"),
        ),
        response=Layout(tail=Registers()),
    ),
    0x18: Function(  # V1.1b3, 6.18; the first register is the count of those that follow
        name="read fifo queue", short="read fifo", limit=31,
        request=Layout(ADDRESS), response=Layout(tail=Registers("fifo", count_width=2)),
    ),
    0x2B: Function(  # V1.1b3, 6.19 to 6.21
        name="encapsulated interface transport", short="encapsulated",
        request=Layout(tail=Choice("mei_type", {
            0x0D: Layout(tail=Bytes(count_width=0)),
            0x0E: Layout(("read_code", 1), ("object_id", 1)),
        })),
        response=Layout(tail=Choice("mei_type", {
            0x0D: Layout(tail=Bytes(count_width=0)),
            0x0E: Layout(
                ("read_code", 1), ("conformity", 1), ("more_follows", 1), ("next_object_id", 1),
                tail=Objects(),
            ),
        })),
    ),
}  # fmt: skip

TABLE_FUNCTIONS = frozenset(code for code, one in FUNCTIONS.items() if one.table is not None)
"""The codes of the functions that read or write addresses of one of the four tables."""
READ_BITS = frozenset({0x01, 0x02})
READ_REGISTERS = frozenset({0x03, 0x04, 0x17})
READS = READ_BITS | READ_REGISTERS
"""Functions whose response is a byte count and the requested values, and nothing else."""
WRITE_ONE = frozenset({0x05, 0x06, 0x16})
"""Functions whose response repeats the request."""
WRITE_SEVERAL = frozenset({0x0F, 0x10})
"""Functions whose response repeats the address and the quantity of the request."""

ECHOING = WRITE_ONE | {0x08, 0x15}
"""Functions whose response may be equal to its request."""
NEVER_ECHOED = frozenset(FUNCTIONS) - ECHOING - {0x2B}
"""Functions whose response is never equal to its request. For 2B it depends on the MEI type."""

QUERY_DATA = 0
"""The sub-function of 08 that returns the data of the request, of any length (V1.1b3, 6.8.1)."""

READ_LIMIT = FUNCTIONS[0x03].limit
"""The most registers that a request may read (V1.1b3, 6.3)."""
WRITE_LIMIT_17H = 121
"""The most registers that function 17H may write (V1.1b3, 6.17)."""


class ExceptionCode(IntEnum):
    """Exception codes (V1.1b3, section 7). Further codes of devices are plain integers."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_DATA_ADDRESS = 0x02
    ILLEGAL_DATA_VALUE = 0x03
    SERVER_DEVICE_FAILURE = 0x04
    ACKNOWLEDGE = 0x05
    SERVER_DEVICE_BUSY = 0x06
    NEGATIVE_ACKNOWLEDGE = 0x07
    """Only older editions of the standard have this code."""
    MEMORY_PARITY_ERROR = 0x08
    GATEWAY_PATH_UNAVAILABLE = 0x0A
    GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B


GATEWAY_EXCEPTIONS = frozenset(
    (ExceptionCode.GATEWAY_PATH_UNAVAILABLE, ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND)
)
"""The exceptions with which a gateway answers for a unit that it did not reach (V1.1b3, 7)."""


def function_name(code: int) -> str:
    """The standard's name of a function; `function 41H` if the standard has none for code 41H."""
    function = FUNCTIONS.get(code)
    return function.name if function is not None else f"function {code:02X}H"


def short_name(code: int, name: str) -> str:
    """The short form of `name` if it is the standard's name of function `code`; else `name`."""
    function = FUNCTIONS.get(code)
    return function.short if function is not None and name == function.name else name


def exception_name(code: int) -> str:
    """The standard's name of an exception code; `exception 11H` if it has none for code 11H."""
    try:
        return ExceptionCode(code).name.lower().replace("_", " ")
    except ValueError:
        return f"exception {code:02X}H"
