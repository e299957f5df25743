"""The identity that a device reports: the responses to functions 2B/0E and 11H, as texts."""

# The function read device identification (MODBUS Application Protocol V1.1b3, 6.21) returns
# objects, each with an id and a text. The standard names ids 00 to 06; ids 80 to FF belong to the
# vendor. The function report server id (6.13) returns bytes in the vendor's form: usually an id, a
# run indicator (00 off, FF on) and a text.
#
# Bytes of a text that are not printable ASCII are written as \xNN.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.pdu import parse_pdu, whole_pdu

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

REPORT_SERVER_ID = 0x11
ENCAPSULATED = 0x2B

OBJECT_NAMES = {  # 6.21, object id
    0x00: "vendor",
    0x01: "product code",
    0x02: "revision",
    0x03: "vendor URL",
    0x04: "product",
    0x05: "model",
    0x06: "application",
}
SERVER_ID = "server id"
RUN_INDICATOR = "run indicator"
_RUN_STATES = {0x00: "off", 0xFF: "on"}
_LEAST_TEXT = 3
"""A server id of fewer bytes than this is shown in hexadecimal, not as text, since one or two bytes
may be printable by chance."""


@dataclass(frozen=True, slots=True)
class Identity:
    """One property that a device reports about itself, such as its vendor name."""

    name: str
    text: str
    number: int | None = None
    """The id of the object in a response to 2B/0E; None in a response to 11H."""


def identities(transaction: Transaction) -> list[Identity]:
    """The properties that the response of a transaction reports; empty if it reports none."""
    if transaction.function not in (REPORT_SERVER_ID, ENCAPSULATED):
        return []
    pdu = whole_pdu(transaction.transport, transaction.response_raw)
    if pdu is None or pdu[0] != transaction.function:
        return []
    fields = parse_pdu(pdu, Direction.RESPONSE).fields
    if transaction.function == REPORT_SERVER_ID:
        data = fields.get("data")
        return _server_id(data) if isinstance(data, bytes) else []
    objects = fields.get("objects")
    found = []
    for one in objects if isinstance(objects, tuple) else ():
        match one:
            case (int(number), bytes(value)):
                name = OBJECT_NAMES.get(number, f"object {number:02X}H")
                found.append(Identity(name, text_of(value), number))
    return found


def _server_id(data: bytes) -> list[Identity]:
    # The run indicator is the first byte 00 or FF behind the id's first byte. The specification
    # leaves it to the vendor how long the id is and what follows the run indicator.
    at = next((index for index, byte in enumerate(data) if index and byte in _RUN_STATES), None)
    if not data:
        return []
    if at is None:
        return [Identity(SERVER_ID, _id_text(data))]
    found = [
        Identity(SERVER_ID, _id_text(data[:at])),
        Identity(RUN_INDICATOR, _RUN_STATES[data[at]]),
    ]
    rest = data[at + 1 :]
    return [*found, Identity("additional data", _id_text(rest))] if rest else found


def _id_text(data: bytes) -> str:
    """Return bytes as text if they are printable and _LEAST_TEXT or more, else in hexadecimal."""
    trimmed = data.rstrip(b"\x00 ")
    if len(trimmed) >= _LEAST_TEXT and all(0x20 <= byte < 0x7F for byte in trimmed):
        return text_of(trimmed)
    return data.hex(" ")


def text_of(data: bytes) -> str:
    """Return bytes as text: printable ASCII unchanged, each other byte in hexadecimal.

    Bytes 00 and spaces at the end are left out.
    """
    return "".join(
        chr(byte) if 0x20 <= byte < 0x7F else f"\\x{byte:02x}" for byte in data.rstrip(b"\x00 ")
    )
