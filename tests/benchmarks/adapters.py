"""What happens to a line's bytes on their way: damage on the wire, then an adapter's delivery."""

# Damage comes first and is the same for every adapter. A frame is damaged where a bit of it changed
# or a byte of it is missing; stray bytes beside a frame do not damage it.
#
# An adapter delivers reads, each with the time at which it was made: the time a program can know.

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from random import Random
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.benchmarks.bus_traffic import Traffic

Read = tuple[bytes, int]
"""The bytes of one read and the time of the last of them."""

BIT_ERRORS = 1e-4
"""Per bit."""
LOST_BYTES = 1e-3
STRAY_GAPS = 0.05
"""The share of the silences with stray bytes in them, 1 to 3."""
STRAY_BYTES = (0x00, 0xF8, 0xFE, 0xFF)
"""What a line without bias and a driver that switches look like to a UART."""

POLL_NS = 1_000_000
FTDI_TIMER_NS = 16_000_000
FTDI_BYTES = 62
"""A 64-byte packet less two bytes of status."""
BURST_FLUSH_NS = 255_000_000
"""The longest that an FTDI latency timer can be set to."""
FILE_READ = 4096
STEPS_BACK = 0.05
"""The share of the reads with a wrong time."""


class Damage(StrEnum):
    """What harms the bytes on the wire."""

    NONE = "none"
    BIT_ERRORS = "bit errors"
    STRAY = "stray bytes"
    LOST = "lost bytes"
    CUT = "cut start"


class Column(StrEnum):
    """How an adapter delivers bytes."""

    BYTES = "byte by byte"
    POLLED = "1 ms"
    FTDI = "FTDI 16 ms"
    BURST_32 = "bursts of 32"
    BURST_62 = "bursts of 62"
    NO_TIMES = "no times"


@dataclass(slots=True)
class Wire:
    """The bytes as they were on the wire where the tap is, with the truth about them."""

    line: SerialFormat
    data: bytearray = field(default_factory=bytearray)
    times: list[int] = field(default_factory=list)
    intact: dict[int, int] = field(default_factory=dict)
    """Where each undamaged frame begins, and its place in the list of frames."""
    mended: list[int] = field(default_factory=list)
    """After each damage, the first transaction that it does not touch."""


def damaged(traffic: Traffic, damage: Damage, random: Random) -> Wire:
    """Put the traffic on a wire."""
    wire = Wire(traffic.line)
    cut_frame, cut_at = -1, 0
    if damage is Damage.CUT:
        cut_frame = random.randrange(min(12, len(traffic.frames)))
        cut_at = random.randrange(1, len(traffic.frames[cut_frame].raw))
    before_ns = traffic.frames[0].start_ns - 10 * traffic.line.t3_5_ns
    for number, frame in enumerate(traffic.frames):
        end = frame.offset + len(frame.raw)
        times = traffic.times[frame.offset : end]
        if number < cut_frame:
            continue
        if damage is Damage.STRAY and random.random() < STRAY_GAPS:
            _stray(wire, before_ns, frame.start_ns, random)
            wire.mended.append(frame.transaction)
        raw, kept = _sent(frame.raw, times, damage, random)
        if number == cut_frame:
            raw, kept = raw[cut_at:], kept[cut_at:]
        if raw == frame.raw:
            wire.intact[len(wire.data)] = number
        else:
            wire.mended.append(frame.transaction + 1)
        wire.data += raw
        wire.times += kept
        before_ns = frame.end_ns
    return wire


def _sent(raw: bytes, times: list[int], damage: Damage, random: Random) -> tuple[bytes, list[int]]:
    match damage:
        case Damage.BIT_ERRORS:
            flips = [sum(1 << bit for bit in range(8) if random.random() < BIT_ERRORS) for _ in raw]
            return bytes(byte ^ flip for byte, flip in zip(raw, flips, strict=True)), times
        case Damage.LOST:
            kept = [at for at in range(len(raw)) if random.random() >= LOST_BYTES]
            return bytes(raw[at] for at in kept), [times[at] for at in kept]
        case _:
            return raw, times


def _stray(wire: Wire, before_ns: int, after_ns: int, random: Random) -> None:
    """Put stray bytes into a silence: behind the last frame, before the next, or anywhere."""
    character_ns = wire.line.character_ns
    room = (after_ns - before_ns) // character_ns
    size = min(random.randint(1, 3), room)
    spare_ns = after_ns - before_ns - size * character_ns
    at_ns = before_ns + random.choice((0, spare_ns, random.randint(0, spare_ns)))
    for _ in range(size):
        at_ns += character_ns
        wire.data.append(random.choice(STRAY_BYTES))
        wire.times.append(at_ns)


def delivered(wire: Wire, column: Column) -> list[Read]:
    """The reads that a program makes."""
    data, times = bytes(wire.data), wire.times
    match column:
        case Column.BYTES:
            return [(data[at : at + 1], times[at]) for at in range(len(data))]
        case Column.POLLED:
            return list(by_timer(data, times, POLL_NS, len(data)))
        case Column.FTDI:
            return list(by_timer(data, times, FTDI_TIMER_NS, FTDI_BYTES))
        case Column.BURST_32:
            return list(by_count(data, times, 32))
        case Column.BURST_62:
            return list(by_count(data, times, 62))
        case Column.NO_TIMES:
            return list(untimed(data, times[0] if times else 0, wire.line))


def by_timer(data: bytes, times: list[int], period_ns: int, most: int) -> Iterator[Read]:
    """A timer that runs from one delivery to the next; a full buffer does not wait for it."""
    if not data:
        return
    begin, tick_ns = 0, times[0] + period_ns // 3
    for at, time_ns in enumerate(times):
        if time_ns > tick_ns:
            if at > begin:
                yield data[begin:at], tick_ns
                begin = at
            tick_ns += -(-(time_ns - tick_ns) // period_ns) * period_ns
        if at + 1 - begin == most:
            yield data[begin : at + 1], time_ns
            begin, tick_ns = at + 1, time_ns + period_ns
    if begin < len(data):
        yield data[begin:], tick_ns


def by_count(
    data: bytes, times: list[int], size: int, flush_ns: int | None = BURST_FLUSH_NS
) -> Iterator[Read]:
    """So many bytes at once, whatever silences are between them; less only after a long wait.

    Without `flush_ns` that wait has no end.
    """
    begin = 0
    for at, time_ns in enumerate(times):
        if flush_ns is not None and at > begin and time_ns > times[begin] + flush_ns:
            yield data[begin:at], times[begin] + flush_ns
            begin = at
        if at + 1 - begin == size:
            yield data[begin : at + 1], time_ns
            begin = at + 1
    if begin < len(data):
        yield data[begin:], times[-1] if flush_ns is None else times[begin] + flush_ns


def with_steps_back(data: bytes, times: list[int]) -> Iterator[Read]:
    """Each byte alone; STEPS_BACK of them have a time 1 to 3 ms too early."""
    random = Random(len(data))
    for at, time_ns in enumerate(times):
        early_ns = random.randint(1_000_000, 3_000_000) if random.random() < STEPS_BACK else 0
        yield data[at : at + 1], time_ns - early_ns


def untimed(data: bytes, start_ns: int, line: SerialFormat) -> Iterator[Read]:
    """As from a file of bytes: one after the other, a character time each."""
    for begin in range(0, len(data), FILE_READ):
        piece = data[begin : begin + FILE_READ]
        yield piece, start_ns + (begin + len(piece)) * line.character_ns
