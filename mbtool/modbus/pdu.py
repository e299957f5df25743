"""Parses protocol data units into named fields, and encodes them."""

# Field names by function (functions.py has the layouts):
#
#     address quantity                01-04, 0F, 10; for 17 the read part
#     values                          several registers or bits; for 08 the data words
#     value                           05, 06
#     write_address write_quantity    17
#     and_mask or_mask                16
#     sub_function                    08
#     status event_count data         07, 0B, 0C, 11
#     groups                          14, 15: see FileGroups and FileResponses in layouts.py
#     fifo                            18: the count and the registers
#     mei_type ... objects            2B
#     exception_code                  every exception response
#
# The PDU of a function that functions.py does not list has one field, `data`.

from __future__ import annotations

import msgspec

from mbtool.core import Direction
from mbtool.modbus.adu import MAX_PDU, Transport, mbap_size, read_frame
from mbtool.modbus.functions import EXCEPTION_BIT, FUNCTIONS, READ_WRITE_REGISTERS, WRITE_SEVERAL
from mbtool.modbus.layouts import Bytes, Fields, Layout, Value

_EXCEPTION = Layout(("exception_code", 1))
_UNKNOWN = Layout(tail=Bytes(count_width=0))

_REQUESTS = [
    FUNCTIONS[code].request if code in FUNCTIONS else _UNKNOWN for code in range(EXCEPTION_BIT << 1)
]
_RESPONSES = [
    FUNCTIONS[code].response if code in FUNCTIONS else _UNKNOWN for code in range(EXCEPTION_BIT)
] + [_EXCEPTION] * EXCEPTION_BIT
LAYOUTS = {
    Direction.REQUEST: _REQUESTS,
    Direction.RESPONSE: _RESPONSES,
    Direction.UNKNOWN: _REQUESTS,
}
"""The layout of a PDU, by direction and function code. A PDU of unknown direction is parsed as a
request. The function code is the index of a list, not the key of a dict, because a splitter looks
up nearly every byte of a line as a function code and a list is faster."""


class Pdu(msgspec.Struct, frozen=True):
    """A parsed PDU.

    If the PDU breaks the form of its function, `fields` holds only the fields that could be read.
    """

    code: int
    """The function code as it is on the wire: an exception response has the exception bit, 80H."""
    fields: Fields
    problem: str | None
    """A text that says why the PDU does not have the form of its function; None if it has."""

    @property
    def function(self) -> int:
        return self.code & ~EXCEPTION_BIT

    @property
    def exception_code(self) -> int | None:
        return self.number("exception_code")

    def number(self, name: str) -> int | None:
        """The value of an integer field; None if the PDU has no integer field of this name."""
        value = self.fields.get(name)
        return value if isinstance(value, int) else None

    def numbers(self, name: str = "values") -> tuple[int, ...] | None:
        """The values of a field of registers or bits; None if the PDU has no such field."""
        value = self.fields.get(name)
        return value if isinstance(value, tuple) else None  # type: ignore[return-value]


def parse_pdu(pdu: bytes, direction: Direction) -> Pdu:
    """Parse one PDU of known direction. Never raises."""
    if not pdu:
        return Pdu(0, {}, "no function code")
    fields, problem = LAYOUTS[direction][pdu[0]].parse(pdu)
    if problem is None and len(pdu) > MAX_PDU:
        problem = f"{len(pdu)} bytes, where a PDU has at most {MAX_PDU}"
    return Pdu(pdu[0], fields, problem)


def encode_pdu(code: int, direction: Direction, **fields: Value) -> bytes:
    """Make a PDU. Raises ValueError if a field is missing or does not fit, or the PDU is too long.

    Byte counts are computed from the values. So are `quantity` in a request of 0FH or 10H and
    `write_quantity` in a request of 17H, unless they are given.
    """
    if not 0 <= code <= 0xFF:
        raise ValueError(f"function code {code} is not in 0..255")
    values = fields.get("values")
    if direction is Direction.REQUEST and isinstance(values, tuple | list):
        if code in WRITE_SEVERAL:
            fields.setdefault("quantity", len(values))
        elif code == READ_WRITE_REGISTERS:
            fields.setdefault("write_quantity", len(values))
    pdu = bytes([code]) + LAYOUTS[direction][code].encode(fields)
    if len(pdu) > MAX_PDU:
        raise ValueError(f"{len(pdu)} bytes, where a PDU has at most {MAX_PDU}")
    return pdu


def exception_pdu(function: int, exception_code: int) -> bytes:
    """The PDU of an exception response."""
    return bytes([function | EXCEPTION_BIT, exception_code])


def pdu_length(pdu: bytes, direction: Direction, at: int = 0) -> int | None:
    """The length in bytes of the PDU that begins at offset `at` of `pdu`, from its first bytes.

    None if more bytes are needed to know; 0 if no byte of the PDU tells the length, as for an
    unknown function. For function 08, where no byte tells it either, the usual length of 5.
    """
    if len(pdu) <= at:
        return None
    return LAYOUTS[direction][pdu[at]].length(pdu, at)


def pdu_of(transport: Transport, raw: bytes) -> tuple[int, bytes]:
    """The unit and the PDU of a whole ADU. Its CRC or LRC is not checked.

    Raises IndexError if the ADU is too short to have a unit, ValueError if it is no ASCII frame.
    """
    match transport:
        case Transport.TCP | Transport.UDP:
            return raw[6], raw[7:]
        case Transport.RTU | Transport.RTU_TCP | Transport.RTU_UDP:
            return raw[0], raw[1:-2]
        case Transport.ASCII:
            frame = read_frame(raw)
            if frame is None:
                raise ValueError(f"no ASCII frame: {raw!r}")
            return frame.body[0], frame.body[1:]


def whole_pdu(transport: Transport, raw: bytes | None) -> bytes | None:
    """The PDU of an ADU; None if `raw` is None or is not a whole ADU.

    `raw` may be incomplete because a capture cut the ADU, or because another program wrote wrong
    bytes to a log.
    """
    if raw is None:
        return None
    if transport.has_mbap and len(raw) != mbap_size(raw):
        return None
    try:
        _, pdu = pdu_of(transport, raw)
    except (IndexError, ValueError):
        return None
    return pdu or None
