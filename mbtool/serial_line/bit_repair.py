"""Finds the one bit that is wrong in a damaged RTU frame, so that its sense is known."""

# A CRC is linear: what a frame with a wrong bit leaves of it depends on where that bit is, and on
# nothing else. Each bit of a frame has one of the 65,536 values, so that a frame of 20 bytes which
# is damaged otherwise has one chance in 400 to look like one with a single wrong bit.

from __future__ import annotations

from functools import cache

from mbtool.modbus.adu import MAX_RTU_ADU
from mbtool.modbus.adu_bytes import crc, crc_on


def mended(frame: bytes) -> bytes | None:
    """A frame with one bit changed so that its CRC is right; None where no bit would do.

    Takes at most 256 bytes, with a CRC that is wrong.
    """
    place = _wrong_bits().get(crc(frame))
    if place is None or place // 8 >= len(frame):
        return None
    at, bit = len(frame) - 1 - place // 8, place % 8
    return frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]


@cache
def _wrong_bits() -> dict[int, int]:
    """By what is left of the CRC, which bit is wrong: 8 for each byte behind it, and its own."""
    places = {}
    for behind in range(MAX_RTU_ADU):
        for bit in range(8):
            places[crc_on(0, bytes([1 << bit]) + bytes(behind))] = 8 * behind + bit
    return places
