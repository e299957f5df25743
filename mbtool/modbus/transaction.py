"""A request and its response in one record, as in logs, JSON Lines and the Python interface."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import msgspec

from mbtool.modbus.adu import DirectionBy, Transport, Verdict

# These types give the ranges of numbers. They are checked only when JSON is read, as any program
# may have written it.
Byte = Annotated[int, msgspec.Meta(ge=0, le=0xFF)]
Word = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Nanoseconds = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]


class Outcome(StrEnum):
    """The result of a transaction, such as a normal response or none."""

    OK = "ok"
    EXCEPTION = "exception"
    LATE = "late"
    """A normal response or an exception response came after the master had given the request up."""
    NO_ANSWER = "no-answer"
    """The slave sent no response: the capture lacks no bytes here and shows no response."""
    NOT_CAPTURED = "not-captured"
    """The capture lacks the request or the response, or some of their bytes, so that the outcome is
    unknown."""
    UNSOLICITED = "unsolicited"
    """The transaction is a response that no request asked for."""
    BROADCAST = "broadcast"
    """The transaction is a request to all units, to which no slave responds."""
    MALFORMED = "malformed"
    """The response does not have the form of its function."""


RESPONDED = frozenset((Outcome.OK, Outcome.EXCEPTION, Outcome.LATE, Outcome.MALFORMED))
"""The outcomes of requests that the slave answered, in time or not."""


# gc=False saves time: a transaction is in no reference cycle, so no garbage collector is needed.
class Transaction(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """A request and its response. A field that does not apply is None, and absent in JSON.

    Times are UTC nanoseconds. Registers are integers 0..65535, bits 0 or 1.
    """

    link: str
    transport: Transport
    source: str | None = None
    """The master's address and port on a network; None on a serial line."""
    destination: str | None = None
    """The slave's address and port on a network; None on a serial line."""
    unit: Byte
    transaction_id: Word | None = None
    function: Byte
    """The function code, without the bit that marks an exception response."""
    function_name: str
    sub_function: Word | None = None
    """The sub-function of diagnostics (08), or the MEI type of 2B."""
    address: Word | None = None
    """The first address on the wire, 0-based; for function 17H the first that it reads."""
    quantity: Word | None = None
    write_address: Word | None = None
    """The first address that function 17H writes."""
    write_quantity: Word | None = None
    """The number of registers that function 17H writes, from the request's quantity field; a
    malformed request may have another number of values."""
    request_values: list[Word] | None = None
    response_values: list[Word] | None = None
    exception: Byte | None = None
    exception_name: str | None = None
    outcome: Outcome
    request_ns: Nanoseconds | None = None
    """The time at which the last byte of the request was on the wire, in UTC ns."""
    request_parts_ns: Nanoseconds | None = None
    """The time from the first to the last byte of a Modbus/TCP request, in ns, if it is more than 1
    s (verdict late-parts); otherwise None."""
    response_ns: Nanoseconds | None = None
    """The time at which the last byte of the response was on the wire, in UTC ns."""
    latency_ns: Nanoseconds | None = None
    """The time from the end of the request to the start of the response, in ns."""
    retries: Count
    """The number of earlier requests with the same unit and PDU that got no response, since such a
    request last got one."""
    request_raw: bytes | None = None
    response_raw: bytes | None = None
    verdicts: list[Verdict] = []
    direction_by: DirectionBy
    confidence: float
    """The probability, 0 to 1, that the directions of the frames and their pairing are right: the
    lowest of these."""
    file: str | None = None
    """The capture file of the request, or of the response if there is no request, as the user named
    it; None in a live capture."""
    response_file: str | None = None
    """The capture file of the response, if it is another one than `file`."""
    request_packet: Count | None = None
    """The number, in the file, of the packet with the last byte of the request. Packets are counted
    from 1, as in Wireshark."""
    response_packet: Count | None = None
    """The number, in its file, of the packet with the last byte of the response."""
    request_offset: Count | None = None
    """In a file of the bytes of a serial line, the number of bytes before the request."""
    response_offset: Count | None = None
    """In a file of the bytes of a serial line, the number of bytes before the response."""
    source_mac: str | None = None
    """The MAC address that the master's packets have, as `00:0a:e4:01:02:03`."""
    destination_mac: str | None = None
    """The MAC address that the slave's packets have."""
    vlan: Word | None = None
    """The VLAN of the packets: the id of the innermost tag. None if they have no tag."""
    pair_confidence: float | None = None
    """The probability, 0 to 1, that the response is to this request; without a response, or without
    a request, that there is none. None if nothing speaks against it. `confidence` is not higher."""

    @property
    def written_quantity(self) -> int:
        """The number of registers that the request writes.

        The request's field `write_quantity` gives the number; where that is None, as for functions
        other than 17H, the number of written values does.
        """
        if self.write_quantity is not None:
            return self.write_quantity
        return len(self.request_values or ())

    @property
    def start_ns(self) -> int:
        """The end of the request, or of the response if there is no request, in UTC ns."""
        return self.request_ns if self.request_ns is not None else self.response_ns or 0
