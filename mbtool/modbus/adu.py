"""The results of a splitter: application data units, and bytes that it could not read."""

# Classes with an instance for every frame are msgspec.Structs, not dataclasses: to make a frozen
# Struct takes a tenth of the time, and to read one frame of a line makes about six objects.

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import msgspec

from mbtool.core import Direction, EventKind

MAX_PDU = 253
MAX_RTU_ADU = 256
MAX_TCP_ADU = 260
MAX_ASCII_ADU = 513


class Transport(StrEnum):
    """The kind of ADU that carries a PDU, and what carries the ADU."""

    RTU = "rtu"
    ASCII = "ascii"
    TCP = "tcp"
    RTU_TCP = "rtu-tcp"

    @property
    def is_serial(self) -> bool:
        """True if the frames are on a serial line: silences part them, and units share a link."""
        return self in (Transport.RTU, Transport.ASCII)


class DirectionBy(StrEnum):
    """The evidence that decided the direction of an ADU."""

    PORT = "port"
    """The TCP port, or the tap that heard the ADU. This is certain."""
    PENDING = "pending"
    """It is a response to the pending request."""
    IDLE = "idle"
    """No request is pending, and it has the form of a request."""
    FORM = "form"
    """Its form fits one direction only."""
    TIMING = "timing"
    """Its form fits both directions, and the silence before it decided."""


class Verdict(StrEnum):
    """Something noticed about a frame, or about the transaction that contains it."""

    GLUED = "glued"
    """In the capture, no silence parts it from its neighbour."""
    SPLIT = "split"
    """It contains a silence longer than t3.5."""
    RESYNCHRONISED = "resynchronised"
    """The splitter was out of step, and is in step again from this ADU on."""
    NOISE_BEFORE = "noise-before"
    """Unreadable bytes precede it, without a silence between."""
    T1_5_BROKEN = "t1.5-broken"
    """It contains a silence longer than t1.5."""
    AMBIGUOUS = "ambiguous"
    """Another direction or another end is nearly as likely for these bytes."""
    PARITY_IN_DATA = "parity-in-data"
    """An ASCII line of 7 data bits is heard with 8: bit 7 is its parity bit, or its stop bit."""
    LOWER_CASE = "lower-case"
    """Its hexadecimal digits are lower case. Some ASCII devices do not read these."""
    OTHER_END = "other-end"
    """It does not end with CR and the line's delimiter, which is LF unless 08/03 changed it."""
    MALFORMED_REQUEST = "malformed-request"
    """The request's body does not have the form of its function."""
    MALFORMED_RESPONSE = "malformed-response"
    """The response's body does not have the form of its function, or does not fit the request."""
    OTHER_TRANSACTION_ID = "other-transaction-id"
    """Its transaction id differs from that of the only request that it can belong to."""
    OVER_LIMIT = "over-limit"
    """Dropped by the decoder's limit of open requests; nothing is known of its response."""


class Checksum(msgspec.Struct, frozen=True, gc=False):
    """A CRC or LRC: the received value and the computed one."""

    received: int
    computed: int

    @property
    def ok(self) -> bool:
        return self.received == self.computed


class Adu(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """One application data unit: a PDU with the address and checks of its transport."""

    start_ns: int
    """UTC ns. On a serial line the start of the first byte; on TCP the time of its segment."""
    end_ns: int
    """The time of the last byte, in UTC ns."""
    transport: Transport
    direction: Direction
    direction_by: DirectionBy
    confidence: float
    """How certain the direction is, from 0 to 1."""
    unit: int
    pdu: bytes
    raw: bytes
    """All bytes of the ADU, as captured."""
    transaction_id: int | None = None
    """Modbus/TCP only."""
    checksum: Checksum | None = None
    """None on Modbus/TCP."""
    silence_before_ns: int | None = None
    """On an RTU line, the silence before the first byte, in ns; None if unknown."""
    longest_silence_ns: int | None = None
    """On an RTU line, the longest silence inside the frame, in ns; None if unknown."""
    verdicts: tuple[Verdict, ...] = ()


@dataclass(frozen=True, slots=True)
class Skipped:
    """Bytes that are no ADU, with the reason."""

    ts_ns: int
    """The time of the first byte, in UTC ns."""
    kind: EventKind
    reason: str
    """One sentence for a reader."""
    raw: bytes
    checksum: Checksum | None = None
    """The wrong CRC or LRC, if the bytes are a frame with one."""
