"""The results of a splitter: application data units, and bytes that it could not read."""

# Adu and Checksum are msgspec.Structs, not dataclasses, because each frame makes new ones: making a
# frozen Struct takes a tenth of the time, and reading one frame of a line makes about six objects.

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import msgspec

from mbtool.core import Direction, EventKind, Origin

MAX_PDU = 253
MAX_RTU_ADU = 256
MAX_TCP_ADU = 260
MAX_ASCII_ADU = 513


class Transport(StrEnum):
    """The form of an ADU (RTU, ASCII, MBAP) and its medium (serial line or TCP)."""

    RTU = "rtu"
    ASCII = "ascii"
    TCP = "tcp"
    RTU_TCP = "rtu-tcp"

    is_serial: bool
    """True for RTU and ASCII on a serial line, which all units share."""

    def __new__(cls, value: str) -> Self:
        self = str.__new__(cls, value)
        self._value_ = value
        self.is_serial = value in ("rtu", "ascii")  # Asked for each transaction several times.
        return self


class DirectionBy(StrEnum):
    """The evidence that decided the direction of an ADU."""

    PORT = "port"
    """The TCP ports of the connection, or the tap that received the ADU, tell the direction. It is
    certain."""
    PENDING = "pending"
    """The ADU fits as a response to the pending request."""
    IDLE = "idle"
    """No request is pending, and the ADU has the form of a request."""
    FORM = "form"
    """Only a request, or only a response, can have the form of the ADU."""
    TIMING = "timing"
    """The form of the ADU fits both directions, and the silence before the ADU decided."""


class Verdict(StrEnum):
    """A remarkable property of a frame, or of the transaction that contains it."""

    GLUED = "glued"
    """In the capture, no silence separates the frame from the frame before or after it."""
    SPLIT = "split"
    """The frame contains a silence of t3.5 or longer."""
    ONLY_REQUEST_SPLIT = "only-request-split"
    """The request contains a silence of t3.5 or longer, and its response none."""
    RESYNCHRONISED = "resynchronised"
    """Before this ADU, bytes were skipped because the boundaries of ADUs were lost; from this ADU
    on they are known again."""
    NOISE_BEFORE = "noise-before"
    """Unreadable bytes precede the frame, without a silence between them and the frame."""
    T1_5_BROKEN = "t1.5-broken"
    """The frame contains a silence longer than t1.5, but none as long as t3.5."""
    AMBIGUOUS = "ambiguous"
    """Another explanation is nearly as likely: another direction or end of the frame, or, in a TCP
    connection, another request for this response."""
    PARITY_IN_DATA = "parity-in-data"
    """A port with 8 data bits received an ASCII line with 7: bit 7 of each character is a parity
    bit or a stop bit."""
    LOWER_CASE = "lower-case"
    """The frame has lower-case hexadecimal digits. Some ASCII devices do not read these."""
    OTHER_END = "other-end"
    """The frame does not end with CR and the line's delimiter, which is LF unless function 08,
    sub-function 3 changed it."""
    MALFORMED_REQUEST = "malformed-request"
    """The request's body does not have the form of its function."""
    MALFORMED_RESPONSE = "malformed-response"
    """The response's body does not have the form of its function, or does not fit the request."""
    OTHER_TRANSACTION_ID = "other-transaction-id"
    """The response has another transaction id than the only request that it can belong to."""
    OTHER_UNIT = "other-unit"
    """The response has another unit than the only request that it can belong to, and the same
    transaction id."""
    CUT = "cut"
    """The capture has only the first bytes of the ADU, with the unit and the function."""
    OVER_LENGTH = "over-length"
    """The ADU is longer than the standard allows, 260 bytes on Modbus/TCP."""
    LATE_PARTS = "late-parts"
    """More than 1 s passed between the first and the last byte of a Modbus/TCP request."""
    OVER_LIMIT = "over-limit"
    """The decoder dropped this request because of its limit of pending requests; or this is the
    response to such a request. The two are not joined."""
    CAPTURE_END = "capture-end"
    """The capture of this link ends, or is interrupted, sooner than the response may come."""


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
    """The time of the ADU's first byte, in UTC ns: its beginning on a serial line, the time of its
    segment on TCP."""
    end_ns: int
    """The time of the ADU's last byte, in UTC ns: its end on a serial line, the time of its segment
    on TCP."""
    transport: Transport
    direction: Direction
    direction_by: DirectionBy
    confidence: float
    """The probability, 0 to 1, that the direction is right."""
    unit: int
    pdu: bytes
    """The PDU; its first bytes if `missing` is not 0."""
    raw: bytes
    """All bytes of the ADU, as captured."""
    missing: int = 0
    """Number of bytes at the end of the ADU that the capture lacks. Always 0 on serial lines: only
    the header of a Modbus/TCP ADU tells the length."""
    transaction_id: int | None = None
    """The transaction id of the MBAP header; None unless the transport is Modbus/TCP."""
    checksum: Checksum | None = None
    """The ADU's CRC or LRC; None on Modbus/TCP, which has neither."""
    silence_before_ns: int | None = None
    """On an RTU line, the silence before the first byte, in ns; None if unknown."""
    longest_silence_ns: int | None = None
    """On an RTU line, the longest silence inside the frame, in ns; None if unknown."""
    verdicts: tuple[Verdict, ...] = ()
    origin: Origin | None = None
    """The packet with the ADU's last byte, or the position of the first byte in a file of serial
    bytes; None if unknown."""

    @property
    def size(self) -> int:
        """The length of the whole ADU in bytes."""
        return len(self.raw) + self.missing


@dataclass(frozen=True, slots=True)
class Skipped:
    """Bytes that are no ADU, with the reason."""

    ts_ns: int
    """The time of the first byte, in UTC ns."""
    kind: EventKind
    reason: str
    """The reason, as a text for the user, why the bytes could not be read."""
    raw: bytes
    checksum: Checksum | None = None
    """The wrong CRC or LRC, if the bytes are a frame with one."""
