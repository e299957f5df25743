"""Bit repair: finds the one wrong bit of a damaged RTU frame, so that the frame can be read."""

# A CRC is linear: after one wrong bit, the remainder depends only on the position of that bit in
# the frame. A frame of 20 bytes has 160 bit positions, and there are 65,536 remainders. So of 400
# frames with other damage, one looks by chance as if it had a single wrong bit.

from __future__ import annotations

from functools import cache

from mbtool.modbus.adu import MAX_RTU_ADU, crc, crc_on


def repaired(frame: bytes) -> bytes | None:
    """Return the frame with one bit changed so that its CRC is correct; None if no bit does that.

    `frame` has at most 256 bytes, and its CRC is wrong.
    """
    place = _wrong_bits().get(crc(frame))
    if place is None or place // 8 >= len(frame):
        return None
    at, bit = len(frame) - 1 - place // 8, place % 8
    return frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]


@cache
def _wrong_bits() -> dict[int, int]:
    """Map the CRC of a whole frame with one wrong bit (0 if all bits are right) to the bit's place.

    The place is 8 times the number of bytes behind the wrong byte, plus the bit's number (0 to 7).
    """
    places = {}
    for behind in range(MAX_RTU_ADU):
        for bit in range(8):
            places[crc_on(0, bytes([1 << bit]) + bytes(behind))] = 8 * behind + bit
    return places
