"""A request and its response in one record, as in logs, JSON Lines and the Python interface."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import msgspec

from mbtool.core.moments import host_of, utc_time
from mbtool.modbus.adu import DirectionBy, Transport, Verdict

if TYPE_CHECKING:
    from datetime import datetime

_SHOWN = 8
"""The repr of a transaction has at most this many values."""

# These types give the ranges of numbers. They are checked only when JSON is read, as any program
# may have written it.
Byte = Annotated[int, msgspec.Meta(ge=0, le=0xFF)]
Word = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Nanoseconds = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]


def about(
    text: str, csv: int | None = None, table: int | None = None, bits: int = 64
) -> msgspec.Meta:
    """Describe a field of a transaction.

    `text` says in JSON schemas what it is. `csv` and `table` are its places among the columns of
    CSV and Parquet, counted from 0. They never change; a new field gets the next number.
    `bits` is the size in Parquet of a number that has no greatest value.
    """
    return msgspec.Meta(description=text, extra={"csv": csv, "table": table, "bits": bits})


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

    Times are UTC nanoseconds. Registers are integers 0..65535, bits 0 or 1. The class, with
    NamedTransaction, is the only list of the fields: JSON schemas, CSV columns, Parquet columns
    and the kinds of names in --where are made from it (devices/transaction_fields.py).
    """

    link: Annotated[str, about("The bus or the slave's address", 3, 0)]
    transport: Annotated[Transport, about("How the PDU travels", 4, 1)]
    source: Annotated[str | None, about("The master's endpoint, on a network", 5, 2)] = None
    """The master's address and port on a network; None on a serial line."""
    destination: Annotated[str | None, about("The slave's endpoint, on a network", 6, 3)] = None
    """The slave's address and port on a network; None on a serial line."""
    unit: Annotated[Byte, about("The unit id: the slave's number", 7, 4)]
    transaction_id: Annotated[Word | None, about("The transaction id of Modbus/TCP", 8, 5)] = None
    function: Annotated[
        Byte, about("The function code, without the bit that marks an exception response", 9, 6)
    ]
    """The function code, without the bit that marks an exception response."""
    function_name: Annotated[str, about("The function in words", 10, 7)]
    sub_function: Annotated[
        Word | None, about("The sub-function of diagnostics (08), or the MEI type of 2B", 11, 8)
    ] = None
    """The sub-function of diagnostics (08), or the MEI type of 2B."""
    address: Annotated[
        Word | None,
        about("The first address on the wire, counted from 0; function 17H reads there", 12, 9),
    ] = None
    """The first address on the wire, 0-based; for function 17H the first that it reads."""
    quantity: Annotated[Word | None, about("How many registers or bits", 13, 10)] = None
    write_address: Annotated[
        Word | None, about("The first address that function 17H writes, counted from 0", 14, 11)
    ] = None
    """The first address that function 17H writes."""
    write_quantity: Annotated[
        Word | None, about("How many registers function 17H writes, as its request says", 30, 12)
    ] = None
    """The number of registers that function 17H writes, from the request's quantity field; a
    malformed request may have another number of values."""
    request_values: Annotated[
        list[Word] | None,
        about("What the request writes: registers as 0..65535, bits as 0 or 1", 20, 13),
    ] = None
    response_values: Annotated[
        list[Word] | None,
        about("What the response brings: registers as 0..65535, bits as 0 or 1", 21, 14),
    ] = None
    exception: Annotated[Byte | None, about("The exception code of the response", 18, 15)] = None
    exception_name: Annotated[str | None, about("The exception in words", 19, 16)] = None
    outcome: Annotated[Outcome, about("How the transaction ended", 17, 17)]
    request_ns: Annotated[
        Nanoseconds | None,
        about("When the request was complete on the wire, UTC nanoseconds", 0, 18),
    ] = None
    """The time at which the last byte of the request was on the wire, in UTC ns."""
    request_parts_ns: Annotated[
        Nanoseconds | None,
        about(
            "Nanoseconds from the first to the last byte of a Modbus/TCP request, if over 30 ms",
            42,
            42,
        ),
    ] = None
    """The time from the first to the last byte of a Modbus/TCP request, in ns, if it is more than
    30 ms; otherwise None."""
    response_ns: Annotated[
        Nanoseconds | None,
        about("When the response was complete on the wire, UTC nanoseconds", 1, 19),
    ] = None
    """The time at which the last byte of the response was on the wire, in UTC ns."""
    latency_ns: Annotated[
        Nanoseconds | None,
        about("Nanoseconds from the end of the request to the start of the response", 2, 20),
    ] = None
    """The time from the end of the request to the start of the response, in ns."""
    retries: Annotated[
        Count, about("How many equal requests before this one went unanswered", 24, 21, bits=32)
    ]
    """The number of earlier requests with the same unit and PDU that got no response, since such a
    request last got one."""
    request_raw: Annotated[bytes | None, about("The whole ADU of the request", 28, 22)] = None
    response_raw: Annotated[bytes | None, about("The whole ADU of the response", 29, 23)] = None
    verdicts: Annotated[list[Verdict], about("What was noticed about its frames", 25, 24)] = []
    direction_by: Annotated[DirectionBy, about("What decided the direction of its frames", 26, 25)]
    confidence: Annotated[
        float, about("The probability that directions and pairing are right, 0 to 1", 27, 26)
    ]
    """The probability, 0 to 1, that the directions of the frames and their pairing are right: the
    lowest of these."""
    file: Annotated[
        str | None,
        about("The capture file of the request, or of the response if there is no request", 32, 32),
    ] = None
    """The capture file of the request, or of the response if there is no request, as the user named
    it; None in a live capture."""
    response_file: Annotated[
        str | None, about("The capture file of the response, if it is another one", 33, 33)
    ] = None
    """The capture file of the response, if it is another one than `file`."""
    request_packet: Annotated[
        Count | None,
        about("The packet in the file that completed the request, counted from 1", 34, 34),
    ] = None
    """The number, in the file, of the packet with the last byte of the request. Packets are counted
    from 1, as in Wireshark."""
    response_packet: Annotated[
        Count | None,
        about("The packet in the file that completed the response, counted from 1", 35, 35),
    ] = None
    """The number, in its file, of the packet with the last byte of the response."""
    request_offset: Annotated[
        Count | None,
        about("How many bytes of the line precede the request in a file of bytes", 36, 36),
    ] = None
    """In a file of the bytes of a serial line, the number of bytes before the request."""
    response_offset: Annotated[
        Count | None,
        about("How many bytes of the line precede the response in a file of bytes", 37, 37),
    ] = None
    """In a file of the bytes of a serial line, the number of bytes before the response."""
    source_mac: Annotated[str | None, about("The MAC address of the master's packets", 38, 38)] = (
        None
    )
    """The MAC address that the master's packets have, as `00:0a:e4:01:02:03`."""
    destination_mac: Annotated[
        str | None, about("The MAC address of the slave's packets", 39, 39)
    ] = None
    """The MAC address that the slave's packets have."""
    response_mac: Annotated[
        str | None,
        about(
            "The MAC address that the response came from, if the request went to another", 43, 43
        ),
    ] = None
    """The MAC address that the response came from; None if the request was sent to the same one. It
    differs behind a pair of routers, and if somebody has put himself in between (ARP spoofing)."""
    vlan: Annotated[
        Word | None, about("The VLAN of the packets: the id of the innermost tag", 40, 40)
    ] = None
    """The VLAN of the packets: the id of the innermost tag. None if they have no tag."""
    pair_confidence: Annotated[
        float | None, about("The probability that the response is to this request, 0 to 1", 41, 41)
    ] = None
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

    @property
    def time(self) -> datetime:
        """The same time as `start_ns`, rounded down to microseconds, in UTC."""
        return utc_time(self.start_ns)

    @property
    def master(self) -> str | None:
        """The master's address, without the port; None on a serial line."""
        return None if self.source is None else host_of(self.source)

    @property
    def slave(self) -> str | None:
        """The slave's address, without the port; None on a serial line."""
        return None if self.destination is None else host_of(self.destination)

    @property
    def latency_ms(self) -> float | None:
        """The time from the end of the request to the start of the response, in ms."""
        return None if self.latency_ns is None else self.latency_ns / 1e6

    def __repr__(self) -> str:
        what = getattr(self, "reference", None)
        if what is None and self.address is not None:
            what = f"{self.address} x {self.quantity or 1}"
        words = [self.time.isoformat(" "), self.link, f"unit {self.unit}", self.function_name]
        words += [what] if what else []
        words += [f":= {_values_text(self.request_values)}"] if self.request_values else []
        words += [f"-> {_values_text(self.response_values)}"] if self.response_values else []
        words += [self.outcome.value] if self.exception_name is None else [self.exception_name]
        words += [] if self.latency_ms is None else [f"{self.latency_ms:.1f} ms"]
        return f"<{type(self).__name__} {' '.join(words)}>"


def _values_text(values: list[int]) -> str:
    return " ".join(map(str, values[:_SHOWN])) + (" ..." if len(values) > _SHOWN else "")
