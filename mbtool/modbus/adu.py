"""What a splitter gives: application data units, and the bytes it could not read."""

# What is made for every frame, here and beside it, is a msgspec.Struct and no dataclass: a frozen
# one is made in a tenth of the time, and reading a frame of a line makes half a dozen.

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
    """How a PDU travels."""

    RTU = "rtu"
    ASCII = "ascii"
    TCP = "tcp"
    RTU_TCP = "rtu-tcp"

    @property
    def is_serial(self) -> bool:
        """Whether its frames are on a serial line, where silences count and units share a link."""
        return self in (Transport.RTU, Transport.ASCII)


class DirectionBy(StrEnum):
    """What decided an ADU's direction."""

    PORT = "port"
    """The TCP port, or the tap that heard it: certain."""
    PENDING = "pending"
    """It answers the request that waits for an answer."""
    IDLE = "idle"
    """No request waits, and it has the form of a request."""
    FORM = "form"
    """Its form fits one direction only."""
    TIMING = "timing"
    """Its form fits both, and the silence before it decided."""


class Verdict(StrEnum):
    """What was noticed about a frame, or about the transaction it became part of."""

    GLUED = "glued"
    """No silence parts it from its neighbour in the capture."""
    SPLIT = "split"
    """A silence longer than t3.5 stands inside it."""
    RESYNCHRONISED = "resynchronised"
    """The splitter had lost its place and found it here."""
    NOISE_BEFORE = "noise-before"
    """Unreadable bytes precede it without a silence."""
    T1_5_BROKEN = "t1.5-broken"
    """A silence longer than t1.5 stands inside it."""
    AMBIGUOUS = "ambiguous"
    """Another reading of its bytes is nearly as likely: of its direction, or of where it ends."""
    PARITY_IN_DATA = "parity-in-data"
    """An ASCII line of 7 data bits is heard with 8: bit 7 is its parity bit, or its stop bit."""
    LOWER_CASE = "lower-case"
    """Its hexadecimal digits are lower case, which not every ASCII device reads."""
    OTHER_END = "other-end"
    """It ends otherwise than with CR and the delimiter of its ASCII line, which is LF at first."""
    MALFORMED_REQUEST = "malformed-request"
    """The request's body does not have the form of its function."""
    MALFORMED_RESPONSE = "malformed-response"
    """The response's body does not have the form of its function, or not of the request's."""
    OTHER_TRANSACTION_ID = "other-transaction-id"
    """The answer carries another transaction id than the only request it can belong to."""


class Checksum(msgspec.Struct, frozen=True, gc=False):
    """A CRC or LRC as received and as it should be."""

    received: int
    computed: int

    @property
    def ok(self) -> bool:
        return self.received == self.computed


class Adu(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """One application data unit: a PDU and what the line adds to it."""

    start_ns: int
    """When its first byte began on a line; in a stream, when the segment with it was captured."""
    end_ns: int
    """The time of the byte that completed it."""
    transport: Transport
    direction: Direction
    direction_by: DirectionBy
    confidence: float
    """How sure the direction is, 0 to 1."""
    unit: int
    pdu: bytes
    raw: bytes
    """All its bytes as captured."""
    transaction_id: int | None = None
    """Modbus/TCP only."""
    checksum: Checksum | None = None
    """Absent on Modbus/TCP."""
    silence_before_ns: int | None = None
    """On an RTU line, how long it was silent before the first byte, where that is known."""
    longest_silence_ns: int | None = None
    """On an RTU line, the longest silence inside the frame, where the bytes' times are known."""
    verdicts: tuple[Verdict, ...] = ()


@dataclass(frozen=True, slots=True)
class Skipped:
    """Bytes that are no ADU, with the reason."""

    ts_ns: int
    """The time of the first of them."""
    kind: EventKind
    reason: str
    """One sentence for a reader."""
    raw: bytes
    checksum: Checksum | None = None
    """Where they are a frame whose CRC or LRC is wrong."""
