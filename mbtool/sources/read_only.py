"""Decides which bytes of a master may reach the slave through a tap that is read-only."""

# A request passes only if it is known to change nothing: READING lists its function, and its PDU
# has exactly the form of that function. Any other request, also one of a function that no standard
# describes, is not passed on; the tap answers it with exception 01.
#
# Why exception 01, illegal function: the specification (V1.1b3, section 7) explains it as "not an
# allowable action for the server". 02 and 03 would blame the address or the value, and a master may
# then try others; 04 to 0B say that a device or a gateway has failed, and masters repeat such
# requests.
#
# A slave might divide the byte stream into requests in another way than this tap. So bytes that are
# no whole request end the connection, and nothing of the read that they came in is passed on.
#
# An exception is sent to the master between two responses of the slave, never inside one. On
# Modbus/TCP it may overtake responses to earlier requests; the transaction id tells the master
# which request it answers.
#
# Memory: an incomplete ADU of each direction, and the exceptions that cannot be sent until a
# response is complete; more than MAX_WAITING of them end the connection.

from __future__ import annotations

from dataclasses import dataclass, field

from mbtool.core import Direction
from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter
from mbtool.modbus.adu import Adu, mbap_adu, rtu_adu
from mbtool.modbus.functions import ExceptionCode, function_name
from mbtool.modbus.pdu import Pdu, exception_pdu, parse_pdu

MAX_WAITING = 256
READING = frozenset((0x01, 0x02, 0x03, 0x04, 0x07, 0x0B, 0x0C, 0x11, 0x14, 0x18))
"""The function codes whose requests change nothing in the slave, whatever else they contain."""
DIAGNOSTICS, READING_DIAGNOSTICS = 0x08, frozenset((0x00, 0x02, *range(0x0B, 0x13)))
"""The function code of diagnostics (08), and its sub-functions that change nothing: return query
data, return the diagnostic register and the counters. The others restart the slave, silence it, or
clear its counters (V1.1b3, 6.8.1)."""
ENCAPSULATED, READ_DEVICE_IDENTIFICATION = 0x2B, 0x0E


@dataclass(slots=True)
class Screened:
    """Says which of the bytes of one read from a master are passed on."""

    onward: bytes = b""
    """The requests, whole ADUs, that are passed on to the slave."""
    refused: list[str] = field(default_factory=list)
    """For each request that is not passed on, a line for the user: the unit and the function."""
    is_broken: bool = False
    """True if the connection must end: the bytes are no whole requests, or more than MAX_WAITING
    exceptions wait to be sent."""


class ReadOnlyScreen:
    """Sorts the requests of one connection through a read-only tap.

    Those that only read are passed on to the slave; the master gets an exception for each other.
    """

    def __init__(self, *, is_rtu: bool) -> None:
        splitter = RtuStreamSplitter if is_rtu else MbapSplitter
        self._requests: MbapSplitter | RtuStreamSplitter = splitter(Direction.REQUEST)
        self._responses: MbapSplitter | RtuStreamSplitter = splitter(Direction.RESPONSE)
        self._waiting: list[bytes] = []

    def ask(self, data: bytes, ts_ns: int) -> Screened:
        """Take bytes that the master sent, and return which of them are passed on.

        `ts_ns` is the time at which they were read, in UTC ns.
        """
        result = Screened()
        for event in self._requests.feed(data, ts_ns):
            if not isinstance(event, Adu):
                return Screened(is_broken=True)
            if only_reads(parse_pdu(event.pdu, Direction.REQUEST)):
                result.onward += event.raw
            else:
                name = function_name(event.pdu[0]) if event.pdu else "a request without function"
                result.refused.append(f"unit {event.unit}: {name} not passed on")
                self._waiting.append(_refusal(event))
        if len(self._waiting) > MAX_WAITING:
            return Screened(is_broken=True)
        return result

    def respond(self, data: bytes, ts_ns: int) -> None:
        """Take bytes of the slave, to know when a response is complete; `ts_ns` is in UTC ns."""
        self._responses.feed(data, ts_ns)

    def due(self) -> bytes:
        """Return the bytes of the waiting exceptions, to send them to the master now.

        Returns b"" if none wait, or while a response of the slave is not complete.
        """
        if not self._waiting or not self._responses.is_idle:
            return b""
        due, self._waiting = b"".join(self._waiting), []
        return due


def only_reads(request: Pdu) -> bool:
    """True if a request has exactly the form of a function that changes nothing in the slave."""
    if request.problem is not None:
        return False
    if request.code == DIAGNOSTICS:
        return request.number("sub_function") in READING_DIAGNOSTICS
    if request.code == ENCAPSULATED:
        return request.number("mei_type") == READ_DEVICE_IDENTIFICATION
    return request.code in READING


def _refusal(request: Adu) -> bytes:
    function = request.pdu[0] if request.pdu else 0
    answer = exception_pdu(function, ExceptionCode.ILLEGAL_FUNCTION)
    if request.transaction_id is None:
        return rtu_adu(request.unit, answer)
    return mbap_adu(request.transaction_id, request.unit, answer)
