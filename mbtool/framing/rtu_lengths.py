"""What the bytes of an RTU frame say about its size, and about what is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.modbus.adu import Checksum
from mbtool.modbus.adu_bytes import RTU_EXTRA_BYTES, crc, crc_on
from mbtool.modbus.pdu import LAYOUTS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.core import Direction

MIN_FRAME = 4
"""Unit, function code and CRC."""

_FIXED = {
    direction: tuple(length + RTU_EXTRA_BYTES if length else 0 for length in lengths)
    for direction, lengths in (
        (direction, [layout.length(b"") for layout in layouts])
        for direction, layouts in LAYOUTS.items()
    )
}
"""The sizes that a function alone says, which most requests have; 0 for others."""


def frame_size(head: bytes, direction: Direction) -> int | None:
    """How long a frame is by its structure, from its first bytes.

    None where more bytes are needed to know, 0 where nothing in it says.
    """
    if len(head) < 2:
        return None
    fixed = _FIXED[direction][head[1]]
    if fixed:
        return fixed
    length = LAYOUTS[direction][head[1]].length(head, 1)
    return length + RTU_EXTRA_BYTES if length else length


def crc_ends(head: bytes, most: int) -> list[int]:
    """The sizes at which a frame of these first bytes would have a correct CRC, the shortest first.

    At most so many. One in 65,536 sizes is right by chance, and each 00 behind a right one.
    """
    sizes = []
    residue = crc(head[: MIN_FRAME - 1])
    for size in range(MIN_FRAME, len(head) + 1):
        residue = crc_on(residue, head[size - 1 : size])
        if residue == 0:
            sizes.append(size)
            if len(sizes) == most:
                break
    return sizes


def why_skipped(
    raw: bytes, directions: Iterable[Direction]
) -> tuple[EventKind, str, Checksum | None]:
    """What bytes are that were taken for no frame."""
    if len(raw) >= MIN_FRAME and len(raw) in [frame_size(raw, each) for each in directions]:
        check = Checksum(int.from_bytes(raw[-2:], "little"), crc(raw[:-2]))
        if not check.ok:
            reason = (
                f"a frame with CRC {check.received:04X}H, "
                f"where {check.computed:04X}H would be right"
            )
            return EventKind.BAD_CHECK, reason, check
    return EventKind.SKIPPED, "no frame with a correct CRC begins here", None
