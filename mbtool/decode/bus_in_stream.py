"""Tells if one direction of an RTU connection carries both requests and responses of a whole line.

Some serial servers and port redirectors send all that they hear on a line to whoever connects.
"""

# The splitter of one direction skips the frames of the other direction. This direction carries a
# whole line if the skipped bytes are whole frames of the other direction with correct CRCs, and if
# one of them and the frame next to it are a request and its response. Two CRCs, unit, function and
# length agree by chance less than once in 2^40 times.

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.framing.rtu_lengths import frame_size
from mbtool.modbus.adu import Adu, Skipped, crc
from mbtool.modbus.expected_response import ExpectedResponse

if TYPE_CHECKING:
    from collections.abc import Sequence


def begin_of_bus(
    events: Sequence[Adu | Skipped], before: Adu | None, direction: Direction
) -> int | None:
    """Return the index of the first event from which on the bytes are a whole line; else None.

    `events` are those of a splitter of `direction`, `before` the frame that preceded them, None if
    there was none. The index is -1 if the line begins with `before`.
    """
    frames: list[Adu | Skipped | None] = [before, *events]
    for at, (one, after) in enumerate(pairwise(frames)):
        if direction is Direction.RESPONSE and isinstance(one, Skipped) and isinstance(after, Adu):
            requests = _frames(one.raw, Direction.REQUEST)
            if requests and _answers(requests[-1], after.raw):
                return at - 1
        if direction is Direction.REQUEST and isinstance(one, Adu) and isinstance(after, Skipped):
            responses = _frames(after.raw, Direction.RESPONSE)
            if responses and _answers(one.raw, responses[0]):
                return at - 1
    return None


def _frames(raw: bytes, direction: Direction) -> list[bytes]:
    """Return the frames of a direction that `raw` consists of; empty if it has other bytes, too."""
    frames = []
    while raw:
        size = frame_size(raw, direction)
        if not size or size > len(raw) or crc(raw[:size]) != 0:
            return []
        frames.append(raw[:size])
        raw = raw[size:]
    return frames


def _answers(request: bytes, response: bytes) -> bool:
    """True if a frame has the unit of a request and the form of its response."""
    expected = ExpectedResponse.of(request[1:-2])
    return expected is not None and request[0] == response[0] and expected.fits(response[1:-2])
