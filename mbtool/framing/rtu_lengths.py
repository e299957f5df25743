"""Tells the size of an RTU frame from its structure and its CRC, and why bytes are no frame."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from functools import cache
from itertools import accumulate
from operator import getitem, xor

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
    if code not in _VARIABLE:
        return 0
    length = LAYOUTS[direction][code].length(start, 1)
    return length + RTU_EXTRA_BYTES if length else length


MAX_SUMMED = 2 * MAX_RTU_ADU
"""The most bytes that CrcSums takes: two frames of full size."""


def has_frame(data: bytes, directions: Iterable[Direction]) -> bool:
    """True if `data`, at most MAX_SUMMED bytes, contains a frame with a correct CRC, at any offset.

    The frame must have the size that its function tells for one of `directions`.
    """
    return any(CrcSums(data).frame_starts(0, len(data), tuple(directions)))


def is_frame_between(data: bytes, cuts: Sequence[int]) -> bool:
    """True if a frame of any function, with a correct CRC, lies between two silences.

    `cuts` are the offsets, in order, at which silences divide `data`. There is also a silence
    before `data` and one behind it.
    """
    bursts = zip((0, *cuts), (*cuts, len(data)), strict=True)
    return any(b - a >= MIN_FRAME and crc(data[a:b]) == 0 for a, b in bursts)


class CrcSums:
    """Tells which pieces of some bytes, at most MAX_SUMMED of them, have a correct CRC."""

    # A CRC is linear: the register behind a piece is the XOR of what its start value and each of
    # its bytes become when the register is moved on by the bytes behind them. If all are moved
    # back to the first byte instead, one running XOR of all bytes serves every piece: a piece is
    # correct if the XOR of its bytes equals its start value, moved back.

    __slots__ = ("_data", "_starts", "_sums")

    def __init__(self, data: bytes) -> None:
        rows, self._starts = _moved_back()
        self._data = data
        self._sums = list(accumulate(map(getitem, rows, data), xor, initial=0))
        """For each offset, the XOR of the bytes before it."""

    def is_correct(self, first: int, end: int) -> bool:
        """True if the bytes from offset `first` up to `end` end with their CRC."""
        return self._sums[end] == self._sums[first] ^ self._starts[first]

    def frame_starts(self, first: int, end: int, directions: Iterable[Direction]) -> list[bool]:
        """For each offset from `first` up to `end`, return True if a frame begins there.

        The frame has a correct CRC, and the size that its function tells for one of `directions`.
        """
        data, sums, have = self._data, self._sums, len(self._data)
        found = [False] * (end - first)
        for offset in range(first, min(end, have - MIN_FRAME + 1)):
            code = data[offset + 1]
            if code not in _MEASURED:
                continue
            wanted = sums[offset] ^ self._starts[offset]
            for direction in directions:
                stop = offset + _FIXED[direction][code]
                if stop == offset and code in _VARIABLE:
                    head = data[offset : offset + MAX_RTU_ADU]
                    stop = offset + (frame_size(head, direction) or 0)
                if offset < stop <= have and sums[stop] == wanted:
                    found[offset - first] = True
        return found

    def sizes(self, first: int, most: int) -> list[int]:
        """Return the sizes, in bytes, at which a frame that begins at `first` has a correct CRC.

        Only the smallest ones are returned, at most `most`, in order. One in 65,536 sizes has a
        correct CRC by chance. Where the CRC is correct and a byte 00 follows, it is also correct
        one byte further.
        """
        last = min(first + MAX_RTU_ADU, len(self._data))
        sums, wanted = self._sums, self._sums[first] ^ self._starts[first]
        found: list[int] = []
        end = first + MIN_FRAME - 1
        while len(found) < most:
            try:
                end = sums.index(wanted, end + 1, last + 1)
            except ValueError:
                break
            found.append(end - first)
        return found


@cache
def _moved_back() -> tuple[list[array[int]], list[int]]:
    """For each offset up to MAX_SUMMED, return what each byte, and the start value of a CRC, become
    when the register is moved back by as many bytes. Takes 10 ms and 300 KB.
    """
    low_bytes = {value >> 8: low for low, value in enumerate(CRC_TABLE)}

    def back(register: int) -> int:
        low = low_bytes[register >> 8]
        return low | (register ^ CRC_TABLE[low] & 0xFF) << 8 & 0xFFFF

    start, bits = 0xFFFF, [1 << bit for bit in range(8)]
    rows, starts = [], []
    for _ in range(MAX_SUMMED + 1):
        row = [0]
        for bit in bits:
            row += [bit ^ other for other in row]
        rows.append(array("H", row))
        starts.append(start)
        start, bits = back(start), [back(bit) for bit in bits]
    return rows, starts


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
