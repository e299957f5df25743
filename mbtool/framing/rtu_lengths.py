"""Tells the size of an RTU frame from its structure and its CRC, and why bytes are no frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from mbtool.core import Direction, EventKind
from mbtool.modbus.adu import (
    CRC_BYTES,
    CRC_TABLE,
    MAX_RTU_ADU,
    RTU_EXTRA_BYTES,
    Checksum,
    crc,
)
from mbtool.modbus.pdu import LAYOUTS

MIN_FRAME = 4
"""The least size of an RTU frame in bytes: unit, function code and CRC."""

_FIXED = {
    direction: tuple(length + RTU_EXTRA_BYTES if length else 0 for length in lengths)
    for direction, lengths in (
        (direction, [layout.length(b"") for layout in layouts])
        for direction, layouts in LAYOUTS.items()
    )
}
"""By direction and function code, the frame size in bytes if the function code alone tells it, as
for most requests; 0 otherwise."""
_COUNT_AT = {
    direction: tuple(layout.count_at and 1 + layout.count_at for layout in layouts)
    for direction, layouts in LAYOUTS.items()
}
"""By direction and function code, the offset in the frame of a byte count that tells its size, as
for most responses; 0 if there is none."""
_VARIABLE = frozenset(
    code
    for layouts in LAYOUTS.values()
    for code, layout in enumerate(layouts)
    if layout.length(b"") is None
)
"""The functions whose frame length depends on more bytes than the function code."""
_MEASURED = _VARIABLE.union(
    *({code for code, size in enumerate(sizes) if size} for sizes in _FIXED.values())
)
"""The functions whose frames tell their length."""


def doubled_size(data: bytes, directions: Iterable[Direction]) -> int:
    """Return the size of the frame that `data` begins with if a copy of it follows; 0 otherwise.

    The frame has a correct CRC, and the size that its structure tells for one of the directions.
    """
    for direction in directions:
        size = frame_size(data, direction)
        if size and data[:size] == data[size : 2 * size] and crc(data[:size]) == 0:
            return size
    return 0


def frame_size(start: bytes, direction: Direction) -> int | None:
    """Return the size in bytes of the RTU frame that begins with `start`.

    The function code and the byte count tell the size. None if `start` ends before them, 0 if the
    frame's bytes do not tell its size, as for an unknown function.
    """
    if len(start) < 2:
        return None
    code = start[1]
    fixed = _FIXED[direction][code]
    if fixed:
        return fixed
    count_at = _COUNT_AT[direction][code]
    if count_at:
        return count_at + 1 + start[count_at] + CRC_BYTES if len(start) > count_at else None
    length = LAYOUTS[direction][code].length(start, 1)
    return length + RTU_EXTRA_BYTES if length else length


def has_frame(data: bytes, directions: Iterable[Direction]) -> bool:
    """True if `data` contains a frame with a correct CRC, at any offset.

    The frame must have the size that its function tells for one of `directions`.
    """
    directions = tuple(directions)
    return any(begins_frame(data, offset, directions) for offset in range(len(data)))


def begins_frame(data: bytes, offset: int, directions: Iterable[Direction]) -> bool:
    """True if a frame with a correct CRC begins at an offset of `data`.

    The frame must have the size that its function tells for one of `directions`.
    """
    most = len(data) - offset
    if most < MIN_FRAME:
        return False
    code = data[offset + 1]
    for direction in directions:
        size = _FIXED[direction][code]
        if not size and code in _VARIABLE:
            size = frame_size(data[offset : offset + MAX_RTU_ADU], direction) or 0
        if size and size <= most and crc(data[offset : offset + size]) == 0:
            return True
    return False


def frame_starts(data: bytes, first: int, end: int, directions: Iterable[Direction]) -> list[bool]:
    """For each offset from `first` up to `end`, return True if a frame begins there.

    `begins_frame` defines what a frame is.
    """
    last = len(data) - MIN_FRAME
    return [
        offset <= last and data[offset + 1] in _MEASURED and begins_frame(data, offset, directions)
        for offset in range(first, end)
    ]


def is_frame_between(data: bytes, cuts: Sequence[int]) -> bool:
    """True if a frame of any function, with a correct CRC, lies between two silences.

    `cuts` are the offsets, in order, at which silences divide `data`. There is also a silence
    before `data` and one behind it.
    """
    bursts = zip((0, *cuts), (*cuts, len(data)), strict=True)
    return any(b - a >= MIN_FRAME and crc(data[a:b]) == 0 for a, b in bursts)


def crc_ends(start: bytes, most: int) -> list[int]:
    """Return the sizes, in bytes, at which a frame that begins with `start` has a correct CRC.

    Only the smallest ones are returned, at most `most`, in order. One in 65,536 sizes has a correct
    CRC by chance. Where the CRC is correct and a byte 00 follows, it is also correct one byte
    further.
    """
    sizes = []
    residue = crc(start[: MIN_FRAME - 1])
    for size, byte in enumerate(start[MIN_FRAME - 1 :], MIN_FRAME):
        residue = CRC_TABLE[(residue ^ byte) & 0xFF] ^ residue >> 8
        if residue == 0:
            sizes.append(size)
            if len(sizes) == most:
                break
    return sizes


def why_skipped(
    raw: bytes, directions: Iterable[Direction]
) -> tuple[EventKind, str, Checksum | None]:
    """Return why `raw` was skipped: the event's kind, the reason as a text, and the wrong CRC.

    The CRC is None unless `raw` has the length of one frame of one of `directions`.
    """
    if len(raw) >= MIN_FRAME and len(raw) in [frame_size(raw, each) for each in directions]:
        check = Checksum(int.from_bytes(raw[-2:], "little"), crc(raw[:-2]))
        if not check.ok:
            reason = (
                f"a frame with CRC {check.received:04X}H, "
                f"where {check.computed:04X}H would be right"
            )
            return EventKind.BAD_CHECK, reason, check
    return EventKind.SKIPPED, "no frame with a correct CRC begins here", None


def begins_with_frame(head: bytes, direction: Direction) -> bool | None:
    """True if `head` begins with an RTU frame with a correct CRC, False if not.

    None if `head` is the incomplete beginning of a possible frame.
    """
    size = frame_size(head, direction)
    if size is None or size > len(head):
        return None if (size or 0) <= MAX_RTU_ADU and len(head) <= MAX_RTU_ADU else False
    return size > 0 and crc(head[:size]) == 0
