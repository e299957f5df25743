"""Reads one frame of a Modbus ASCII line, even if it differs a little from the standard."""

# A frame is a colon, two hexadecimal digits for each byte including the LRC, CR and LF (Serial
# Line V1.02, 2.5.2.1). Devices differ: some write lower-case digits, some leave out CR or LF, and
# function 08, sub-function 3 replaces LF by another character. All of these frames are read, and
# the result says what is unusual about them.
#
# If a port with 8 data bits receives a line with 7, bit 7 of each character is the parity bit or
# the first of two stop bits. Such a frame is read without bit 7, but only if bit 7 follows one rule
# in all characters (even parity, odd parity, or always set). Otherwise the frame is damaged.

from __future__ import annotations

import re
from dataclasses import dataclass

from mbtool.modbus.adu import Checksum
from mbtool.modbus.adu_bytes import lrc

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
            f"a frame with {_shown(wrong[0][0])} as its character {wrong.start() + 2}, "
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


def _shown(character: int) -> str:
    printed = f"'{chr(character)}' ({character:02X}H)"
    return printed if 0x20 < character < 0x7F else f"{character:02X}H"
