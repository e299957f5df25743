"""What a listener hears of a line: one wire only, not all bytes, or another baud rate."""

# The truth stays that of what was sent. A frame that lacks bytes is damaged: its bytes are noise.
# The noise still says which request it answers. So a decoder may tell it as a damaged response, and
# may not give the request another one.

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from tests.benchmarks.plants.recording import Role

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from mbtool.core import SerialFormat
    from tests.benchmarks.plants.recording import Recording, Sent


def only(recording: Recording, role: Role) -> Recording:
    """The recording of a listener that is connected to one wire of a four-wire line."""
    answered = {one.answers for one in recording.sent if one.role is Role.RESPONSE}

    def heard(at: int, one: Sent) -> tuple[Sent, list[int]] | None:
        if one.role is not role:
            return None
        changed = replace(one, answers=None, lacks_response=at in answered)
        return changed, list(range(len(one.raw)))

    return _heard(recording, heard)


def with_lost_bytes(recording: Recording, random: Random, share: float, most: int) -> Recording:
    """The recording of an adapter that loses 1 to `most` bytes of a share of the frames."""
    lost_of: dict[int, range] = {}
    for at, one in enumerate(recording.sent):
        if random.random() < share:
            begin = random.randrange(len(one.raw))
            lost_of[at] = range(begin, begin + random.randint(1, most))
    damaged_answers = {recording.sent[at].answers for at in lost_of}

    def heard(at: int, one: Sent) -> tuple[Sent, list[int]] | None:
        lost = lost_of.get(at, range(0))
        kept = [place for place in range(len(one.raw)) if place not in lost]
        if not kept:
            return None
        if not lost:
            return replace(one, lacks_response=at in damaged_answers), kept
        raw = bytes(one.raw[place] for place in kept)
        return replace(one, role=Role.NOISE, raw=raw, is_damaged=True), kept

    return _heard(recording, heard)


def _heard(
    recording: Recording, heard: Callable[[int, Sent], tuple[Sent, list[int]] | None]
) -> Recording:
    """The recording with the frames that are heard, each with the bytes of it that are."""
    part = replace(recording, sent=[], data=bytearray(), times=[])
    places: dict[int | None, int] = {}
    for at, one in enumerate(recording.sent):
        result = heard(at, one)
        if result is None:
            continue
        changed, kept = result
        places[at] = len(part.sent)
        times = [recording.times[one.offset + place] for place in kept]
        part.sent.append(
            replace(
                changed,
                offset=len(part.data),
                end_ns=times[-1],
                answers=places.get(changed.answers),
                copies=places.get(changed.copies),
            )
        )
        part.data += changed.raw
        part.times += times
    return part


def at_another_rate(data: bytes, sent: SerialFormat, heard: SerialFormat) -> bytes:
    """The bytes that a receiver makes of bytes without pauses that were sent at another baud rate.

    The receiver waits for a falling edge, and looks at the level in the middle of each of its own
    bits. It gives the byte, also if parity or stop bit are wrong, and waits for the next edge after
    the middle of the stop bit.
    """
    levels = [level for byte in data for level in _levels(byte, sent)]
    per_bit = heard.baud / sent.baud
    total = len(levels) * per_bit
    bits = round(heard.character_ns * heard.baud / 1e9)
    found = bytearray()
    now = 0.0
    while True:
        edge = _next_fall(levels, now / per_bit)
        if edge is None:
            return bytes(found)
        begin = edge * per_bit
        byte = 0
        for bit in range(8):
            middle = (begin + 1.5 + bit) / per_bit
            byte |= (levels[int(middle)] if int(middle) < len(levels) else 1) << bit
        found.append(byte)
        now = begin + bits - 0.5
        if now >= total:
            return bytes(found)


def _levels(byte: int, line: SerialFormat) -> list[int]:
    """The start bit, the data from the lowest bit on, the parity and the stop bits."""
    data = [byte >> bit & 1 for bit in range(8)]
    parity = {"N": [], "E": [sum(data) % 2], "O": [1 - sum(data) % 2]}[str(line.parity)]
    return [0, *data, *parity, *[1] * int(line.stop_bits)]


def _next_fall(levels: list[int], after: float) -> int | None:
    """The first bit of level 0 behind one of level 1 that begins at `after` or later."""
    for at in range(max(0, -int(-after // 1)), len(levels)):
        if levels[at] == 0 and (at == 0 or levels[at - 1] == 1):
            return at
    return None
