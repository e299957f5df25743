"""The results of a splitter: application data units, and bytes that it could not read."""

# Adu and Checksum are msgspec.Structs, not dataclasses, because each frame makes new ones: making a
# frozen Struct takes a tenth of the time, and reading one frame of a line makes about six objects.

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import msgspec
from fastcrc import crc16

from mbtool.core import Direction, EventKind, Origin

MAX_PDU = 253
MAX_RTU_ADU = 256
MAX_TCP_ADU = 260
MAX_ASCII_ADU = 513


class Transport(StrEnum):
    """The form of an ADU (RTU, ASCII, MBAP) and its medium (serial line, TCP or UDP)."""

    RTU = "rtu"
    ASCII = "ascii"
    TCP = "tcp"
    RTU_TCP = "rtu-tcp"
    UDP = "udp"
    RTU_UDP = "rtu-udp"

    @classmethod
    def at_endpoint(cls, *, is_rtu: bool, is_udp: bool) -> Self:
        """The transport at an endpoint of a network."""
        return cls(f"rtu-{'udp' if is_udp else 'tcp'}" if is_rtu else "udp" if is_udp else "tcp")

    @property
    def has_mbap(self) -> bool:
        """True for ADUs with an MBAP header."""
        return self in (Transport.TCP, Transport.UDP)

    @property
    def over_tcp(self) -> Transport:
        """The transport of the same form over TCP for one over UDP; else the transport itself.

        Profiles name no UDP: what holds for a device over TCP holds over UDP.
        """
        return {Transport.UDP: Transport.TCP, Transport.RTU_UDP: Transport.RTU_TCP}.get(self, self)

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


# The code below makes the ADU of a PDU for each transport, and computes the CRC and the LRC.

MBAP_BYTES = 7
CRC_BYTES = 2
RTU_EXTRA_BYTES = 3
"""The number of bytes that an RTU ADU has in addition to the PDU: 1 for the unit, 2 for the CRC."""


crc: Callable[[bytes], int] = crc16.modbus
"""Returns the CRC-16/MODBUS of bytes (Serial Line V1.02, 6.2.2).

It is 0 for a whole RTU frame that ends with its own correct CRC. This is the library's function
itself, as a function around it would cost time with every frame."""


def crc_on(before: int, data: bytes) -> int:
    """Continue a CRC: `before` is the CRC of the bytes that come before `data`."""
    return crc16.modbus(data, before)


CRC_TABLE = tuple(crc_on(0, bytes([byte])) for byte in range(256))
"""For each byte, the CRC of that byte alone, if the register begins with 0. To continue a CRC by
one byte: `CRC_TABLE[(crc ^ byte) & 0xFF] ^ crc >> 8`."""


def lrc(data: bytes) -> int:
    """The LRC: the two's complement of the 8-bit sum of the bytes (Serial Line V1.02, 6.2.1)."""
    return -sum(data) & 0xFF


def rtu_adu(unit: int, pdu: bytes) -> bytes:
    """The RTU ADU of a PDU: unit, PDU and CRC, the low byte of the CRC first."""
    body = bytes([unit]) + pdu
    return body + crc(body).to_bytes(2, "little")


def ascii_adu(unit: int, pdu: bytes) -> bytes:
    """The ASCII ADU of a PDU: colon, unit, PDU and LRC as upper-case hexadecimal digits, CR, LF."""
    body = bytes([unit]) + pdu
    return b":" + (body + bytes([lrc(body)])).hex().upper().encode("ascii") + b"\r\n"


def mbap_size(header: bytes) -> int:
    """Return the size in bytes of the Modbus/TCP ADU with this MBAP header, by its length field."""
    return MBAP_BYTES - 1 + int.from_bytes(header[4:6])


def mbap_adu(transaction_id: int, unit: int, pdu: bytes) -> bytes:
    """The Modbus/TCP ADU: MBAP header and PDU (TCP/IP Implementation Guide V1.0b, 3.1.3)."""
    return struct.pack(">HHHB", transaction_id, 0, 1 + len(pdu), unit) + pdu


# The code below reads one frame of a Modbus ASCII line, even if it differs a little from the
# standard.
#
# A frame is a colon, two hexadecimal digits for each byte including the LRC, CR and LF (Serial
# Line V1.02, 2.5.2.1). Devices differ: some write lower-case digits, some leave out CR or LF, and
# function 08, sub-function 3 replaces LF by another character. All of these frames are read, and
# the result says what is unusual about them.
#
# If a port with 8 data bits receives a line with 7, bit 7 of each character is the parity bit or
# the first of two stop bits. Such a frame is read without bit 7, but only if bit 7 follows one rule
# in all characters (even parity, odd parity, or always set). Otherwise the frame is damaged.

CR = 0x0D
LF = 0x0A
SEVEN_BITS = bytes(character & 0x7F for character in range(256))
"""A translation table that clears bit 7 of each character."""
_ODD_ONES = bytes(character.bit_count() & 1 for character in range(256))

_MIN_BYTES = 3
"""The least number of bytes that a frame's digits stand for: unit, function code and LRC."""
_FRAME = re.compile(
    rb":((?:[0-9A-Fa-f]{2}){%d,})(\r[^:]?|\n)" % _MIN_BYTES,
    re.DOTALL,
)
_INSIDE = re.compile(rb":(.*?)(?:\r?\n|\r.?)?", re.DOTALL)
_NO_DIGIT = re.compile(rb"[^0-9A-Fa-f]")


@dataclass(frozen=True, slots=True)
class AsciiFrame:
    """The contents of a frame, whether its LRC is right or wrong."""

    digits: bytes
    end: bytes
    """The characters at the frame's end: CR and a delimiter (usually LF), or CR alone, or LF
    alone."""
    body: bytes
    """The unit and the PDU, as the bytes that the digits stand for."""
    checksum: Checksum
    parity_in_data: bool
    """True if bit 7 of the characters was a parity bit or a stop bit."""

    @property
    def is_lower_case(self) -> bool:
        return self.digits != self.digits.upper()


def read_frame(raw: bytes, *, eight_bits: bool = True) -> AsciiFrame | None:
    """Read the characters of a whole frame; None if they are no frame.

    `eight_bits` is True if the port has 8 data bits, so that bit 7 may be a parity or stop bit.
    """
    match, parity_in_data = _FRAME.fullmatch(raw), False
    if match is None and eight_bits and _has_parity(raw):
        match, parity_in_data = _FRAME.fullmatch(raw.translate(SEVEN_BITS)), True
    if match is None:
        return None
    digits, end = match.groups()
    binary = bytes.fromhex(digits.decode("ascii"))
    checksum = Checksum(binary[-1], lrc(binary[:-1]))
    return AsciiFrame(digits, end, binary[:-1], checksum, parity_in_data)


def why_unreadable(raw: bytes, *, eight_bits: bool = True) -> str:
    """Return the reason why characters that begin with a colon are no frame, as a text."""
    seen = raw.translate(SEVEN_BITS) if eight_bits and _has_parity(raw) else raw
    inside = _INSIDE.fullmatch(seen)
    digits = inside[1] if inside else seen[1:]
    wrong = _NO_DIGIT.search(digits)
    if wrong is not None:
        # The colon is character 1 of the frame, so the first digit is character 2.
        return (
            f"a frame with {_character_text(wrong[0][0])} as its character {wrong.start() + 2}, "
            "where a hexadecimal digit would be right"
        )
    if len(digits) % 2:
        return f"a frame with {len(digits)} hexadecimal digits, where two make a byte"
    return (
        f"a frame with {len(digits) // 2} bytes, where unit, function and LRC are {_MIN_BYTES} "
        "at least"
    )


def like_parity(characters: bytes, raw: bytes) -> bytes:
    """Return 7-bit characters with the bit 7 that those of `raw`, which begin a frame, have."""
    if raw.isascii():
        return characters
    if min(raw) >= 0x80:
        return bytes(one | 0x80 for one in characters)
    ones = _ODD_ONES[raw[0]]
    return bytes(one | 0x80 if _ODD_ONES[one] != ones else one for one in characters)


def _has_parity(raw: bytes) -> bool:
    """True if bit 7 of the characters can be a parity bit or a stop bit.

    It is set in at least one character, and it is set in all characters or gives all of them the
    same parity.
    """
    if raw.isascii():
        return False
    return len(set(raw.translate(_ODD_ONES))) == 1 or min(raw) >= 0x80


def _character_text(character: int) -> str:
    printed = f"'{chr(character)}' ({character:02X}H)"
    return printed if 0x20 < character < 0x7F else f"{character:02X}H"
