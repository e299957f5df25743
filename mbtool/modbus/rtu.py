"""Cuts what one tap hears on a two-wire RTU line into frames."""

# The bytes between two silences of t3.5 are a burst. In a clean capture a burst is a frame; where
# an adapter glued frames or tore one, structure helps: from each place the lengths that its
# function has as a request and as a response are tried, the likelier role first, and the CRC
# decides. A CRC alone never does, since every valid frame that ends in 00 is also valid one byte
# shorter. A frame of a function that no table knows is found where a whole burst has a correct
# CRC. A burst that ends in the beginning of a frame waits for the next one for HOLD_NS at most.
#
# Times: a byte's time is when its last bit arrived. The bytes of one read get their times back from
# the last one by the character time. What comes out depends on these times only, not on how the
# bytes were cut into reads.
#
# Holds at most WINDOW bytes. When a window is full without a silence, all but its last 256 bytes
# are decided.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind
from mbtool.modbus.adu import MAX_RTU_ADU, Adu, Checksum, Skipped, Transport, Verdict
from mbtool.modbus.framing import RTU_EXTRA_BYTES, crc
from mbtool.modbus.pdu import pdu_length
from mbtool.modbus.turns import Turns

if TYPE_CHECKING:
    from mbtool.core import SerialFormat

WINDOW = 1024
MIN_FRAME = 4
HOLD_NS = 40_000_000
"""Twice and a half what an FTDI adapter's 16 ms latency timer puts into the middle of a frame."""


class RtuSplitter:
    """Timed bytes of a line in, `Adu` and `Skipped` out, in order."""

    def __init__(self, line: SerialFormat, turns: Turns | None = None) -> None:
        self._character_ns = line.character_ns
        self._t1_5_ns = line.t1_5_ns
        self._t3_5_ns = line.t3_5_ns
        self._turns = turns or Turns()
        self._data = bytearray()
        self._times: list[int] = []
        self._burst_over = False
        """What the buffer holds is the beginning of a frame that waits for the next burst."""

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the bytes of one read; `ts_ns` is the time of the last one."""
        events: list[Adu | Skipped] = []
        first_ns = ts_ns - (len(data) - 1) * self._character_ns
        if self._data and data:
            events += self.advance(max(first_ns, self._times[-1]) - self._character_ns)
        last_ns = self._times[-1] if self._times else first_ns
        self._burst_over = False
        for index, byte in enumerate(data):
            last_ns = max(last_ns, first_ns + index * self._character_ns)
            self._data.append(byte)
            self._times.append(last_ns)
            if len(self._data) >= WINDOW:
                self._explain(events, burst_over=False)
        return events

    def advance(self, now_ns: int) -> list[Adu | Skipped]:
        """Learn that the line was silent from the last byte until now."""
        events: list[Adu | Skipped] = []
        if not self._data:
            return events
        silence_ns = now_ns - self._times[-1]
        if silence_ns >= self._t3_5_ns and not self._burst_over:
            self._explain(events, burst_over=True)
        if self._data and silence_ns >= max(HOLD_NS, self._t3_5_ns):
            self._skip(len(self._data), events)
        return events

    def close(self) -> list[Adu | Skipped]:
        """The capture ends; what is held comes out."""
        events: list[Adu | Skipped] = []
        self._explain(events, burst_over=True)
        self._skip(len(self._data), events)
        return events

    def _explain(self, events: list[Adu | Skipped], *, burst_over: bool) -> None:
        """Give out the frames of the buffer and the bytes between them."""
        place = begin = 0
        while place < (len(self._data) if burst_over else len(self._data) - MAX_RTU_ADU):
            size = self._frame_at(place, begin, burst_over=burst_over)
            if not size:
                place += 1
                continue
            skipped = place - begin
            self._skip(skipped, events)
            self._give(size, events, after_noise=skipped > 0, glued=self._is_glued(size))
            place = begin = 0
        if not burst_over:
            self._skip(place, events)
            return
        self._burst_over = True
        if not self._is_beginning():
            self._skip(len(self._data), events)

    def _frame_at(self, place: int, begin: int, *, burst_over: bool) -> int:
        """The size of the frame that begins at a place, or 0."""
        head = bytes(self._data[place : place + MAX_RTU_ADU])
        if len(head) < MIN_FRAME:
            return 0
        rest = len(self._data) - place
        sizes = []
        for role in self._turns.order(head[0], head[1], self._times[place]):
            size = _size(head, role)
            if MIN_FRAME <= size <= len(head) and crc(head[:size]) == 0:
                sizes.append(size)
        if burst_over and rest in sizes:
            return rest
        if sizes:
            return sizes[0]
        whole = burst_over and place == begin and rest <= MAX_RTU_ADU
        return rest if whole and crc(head) == 0 else 0

    def _is_beginning(self) -> bool:
        """Whether the buffer can be the beginning of a frame whose end is still to come."""
        head = bytes(self._data)
        if not 1 <= len(head) < MAX_RTU_ADU:
            return False
        if len(head) < MIN_FRAME:
            return True
        for role in (Direction.REQUEST, Direction.RESPONSE):
            length = pdu_length(head[1:], role)
            if length is None or len(head) < length + RTU_EXTRA_BYTES <= MAX_RTU_ADU:
                return True
        return False

    def _is_glued(self, size: int) -> bool:
        """Whether the byte behind the frame follows it without a silence."""
        if size >= len(self._data):
            return False
        return self._silence(size) < self._t3_5_ns

    def _silence(self, index: int) -> int:
        """How long the line was silent before the byte at an index."""
        return self._times[index] - self._times[index - 1] - self._character_ns

    def _give(
        self, size: int, events: list[Adu | Skipped], *, after_noise: bool, glued: bool
    ) -> None:
        raw = bytes(self._data[:size])
        start_ns = self._times[0] - self._character_ns
        end_ns = self._times[size - 1]
        longest = max((self._silence(index) for index in range(1, size)), default=0)
        verdicts = []
        if after_noise:
            verdicts.append(Verdict.NOISE_BEFORE)
        if glued:
            verdicts.append(Verdict.GLUED)
        if longest >= self._t3_5_ns:
            verdicts.append(Verdict.SPLIT)
        elif longest > self._t1_5_ns:
            verdicts.append(Verdict.T1_5_BROKEN)
        judgement = self._turns.judge(raw[0], raw[1:-2], start_ns)
        self._turns.spoke(judgement, raw[0], raw[1:-2], end_ns)
        self._drop(size)
        events.append(
            Adu(
                start_ns=start_ns,
                end_ns=end_ns,
                transport=Transport.RTU,
                direction=judgement.direction,
                direction_by=judgement.by,
                confidence=judgement.confidence,
                unit=raw[0],
                pdu=raw[1:-2],
                raw=raw,
                checksum=Checksum(int.from_bytes(raw[-2:], "little"), crc(raw[:-2])),
                verdicts=tuple(verdicts),
            )
        )

    def _skip(self, size: int, events: list[Adu | Skipped]) -> None:
        if not size:
            return
        raw = bytes(self._data[:size])
        kind, reason = _why_skipped(raw)
        events.append(Skipped(self._times[0], kind, reason, raw))
        self._drop(size)

    def _drop(self, size: int) -> None:
        del self._data[:size]
        del self._times[:size]


def _size(head: bytes, role: Direction) -> int:
    """A frame's size by its structure in a role, or 0 where it is not known."""
    length = pdu_length(head[1:], role)
    return length + RTU_EXTRA_BYTES if length else 0


def _why_skipped(raw: bytes) -> tuple[EventKind, str]:
    if len(raw) >= MIN_FRAME and len(raw) in (_size(raw, role) for role in Direction):
        received, computed = int.from_bytes(raw[-2:], "little"), crc(raw[:-2])
        reason = f"a frame with CRC {received:04X}H, where {computed:04X}H would be right"
        return EventKind.BAD_CHECK, reason
    return EventKind.SKIPPED, "no frame with a correct CRC begins here"
