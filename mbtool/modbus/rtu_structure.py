"""What the bytes of an RTU frame say about its size, and about what is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.modbus.framing import RTU_EXTRA_BYTES, crc
from mbtool.modbus.pdu import pdu_length

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.core import Direction

MIN_FRAME = 4
"""Unit, function code and CRC."""


def frame_size(head: bytes, direction: Direction) -> int | None:
    """How long a frame is by its structure, from its first bytes.

    None where more bytes are needed to know, 0 where nothing in it says.
    """
    length = pdu_length(head[1:], direction)
    return length + RTU_EXTRA_BYTES if length else length


def why_skipped(raw: bytes, directions: Iterable[Direction]) -> tuple[EventKind, str]:
    """What bytes are that were taken for no frame."""
    if len(raw) >= MIN_FRAME and len(raw) in [frame_size(raw, each) for each in directions]:
        received, computed = int.from_bytes(raw[-2:], "little"), crc(raw[:-2])
        if received != computed:
            reason = f"a frame with CRC {received:04X}H, where {computed:04X}H would be right"
            return EventKind.BAD_CHECK, reason
    return EventKind.SKIPPED, "no frame with a correct CRC begins here"
