"""Cuts what one tap hears on a two-wire RTU line into frames."""

# The bytes between two silences of t3.5 are a burst. In a clean capture a burst is a frame; where
# an adapter glued frames or tore one, structure helps: from each place the lengths that its
# function has as a request and as a response are tried, the likelier role first, and the CRC
# decides. A CRC alone never does, since every valid frame that ends in 00 is also valid one byte
# shorter; a length that leaves nothing of the burst is preferred, then one whose PDU has the form
# of its function. A frame of a function that no table knows is found where a whole burst has a
# correct CRC; torn or glued it is not. A burst that ends in the beginning of a frame waits for the
# next one for HOLD_NS at most.
#
# Times: a byte's time is when its last bit arrived. The bytes of one read get their times back from
# the last one by the character time. What comes out depends on these times only, not on how the
# bytes were cut into reads. A clock that was set back ends what was held.
#
# Holds less than WINDOW bytes. When a window is full without a silence, all but its last 256 bytes
# are decided.

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind
from mbtool.modbus.adu import MAX_RTU_ADU, Adu, Checksum, Skipped, Transport, Verdict
from mbtool.modbus.framing import crc
from mbtool.modbus.pdu import parse_pdu
from mbtool.modbus.rtu_structure import MIN_FRAME, frame_size, why_skipped
from mbtool.modbus.turns import Turns

if TYPE_CHECKING:
    from mbtool.core import SerialFormat

WINDOW = 1024
HOLD_NS = 40_000_000
"""Twice and a half what an FTDI adapter's 16 ms latency timer puts into the middle of a frame."""

_ROLES = (Direction.REQUEST, Direction.RESPONSE)


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
        self._given: tuple[int, Verdict] | None = None
        """When the last byte given out arrived, and what that makes of a frame close behind it."""

    @property
    def is_idle(self) -> bool:
        """Whether no byte waits to be decided."""
        return not self._data

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the bytes of one read; `ts_ns` is the time of the last one."""
        events: list[Adu | Skipped] = []
        if not data:
            return events
        first_ns = ts_ns - (len(data) - 1) * self._character_ns
        if self._data:
            set_back = ts_ns < self._times[-1]
            events += self.close() if set_back else self.advance(first_ns - self._character_ns)
        self._burst_over = False
        while data:
            room = WINDOW - len(self._data)
            piece, data = data[:room], data[room:]
            self._data += piece
            for _ in piece:
                self._times.append(first_ns)
                first_ns += self._character_ns
            if len(self._data) == WINDOW:
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
        place = 0
        while place < (len(self._data) if burst_over else len(self._data) - MAX_RTU_ADU):
            size = self._frame_at(place, burst_over=burst_over)
            if size:
                self._skip(place, events)
                self._give(size, events)
                place = 0
            else:
                place += 1
        self._burst_over = burst_over
        if not burst_over or not self._is_beginning():
            self._skip(place, events)

    def _frame_at(self, place: int, *, burst_over: bool) -> int:
        """The size of the frame that begins at a place, or 0."""
        rest = len(self._data) - place
        if rest < MIN_FRAME:
            return 0
        head = bytes(self._data[place : place + MAX_RTU_ADU])
        sizes = []
        for role in self._turns.order(head[0], head[1], self._times[place]):
            size = frame_size(head, role)
            if size and size <= len(head) and crc(head[:size]) == 0:
                if size == rest and burst_over:
                    return size
                sizes.append((parse_pdu(head[1 : size - 2], role).problem is not None, size))
        if sizes:
            return min(sizes, key=lambda malformed_and_size: malformed_and_size[0])[1]
        whole = burst_over and rest <= MAX_RTU_ADU and self._begins_burst(place)
        return rest if whole and crc(head) == 0 else 0

    def _begins_burst(self, place: int) -> bool:
        return place == 0 or self._silence(place) >= self._t3_5_ns

    def _is_beginning(self) -> bool:
        """Whether the buffer can be the beginning of a frame whose end is still to come."""
        head = bytes(self._data)
        if not 1 <= len(head) < MAX_RTU_ADU:
            return False
        sizes = [frame_size(head, role) for role in _ROLES]
        return len(head) < MIN_FRAME or any(
            size is None or len(head) < size <= MAX_RTU_ADU for size in sizes
        )

    def _silence(self, index: int) -> int:
        """How long the line was silent before the byte at an index."""
        return self._times[index] - self._times[index - 1] - self._character_ns

    def _give(self, size: int, events: list[Adu | Skipped]) -> None:
        verdicts = self._verdicts(size)
        raw, times = self._take(size, Verdict.GLUED)
        unit, pdu, received = raw[0], raw[1:-2], int.from_bytes(raw[-2:], "little")
        start_ns, end_ns = times[0] - self._character_ns, times[-1]
        judgement = self._turns.judge(unit, pdu, start_ns)
        self._turns.spoke(judgement, unit, pdu, end_ns)
        events.append(
            Adu(
                start_ns=start_ns,
                end_ns=end_ns,
                transport=Transport.RTU,
                direction=judgement.direction,
                direction_by=judgement.by,
                confidence=judgement.confidence,
                unit=unit,
                pdu=pdu,
                raw=raw,
                checksum=Checksum(received, crc(raw[:-2])),
                verdicts=verdicts,
            )
        )

    def _verdicts(self, size: int) -> tuple[Verdict, ...]:
        """What is to be noticed about the frame at the front."""
        verdicts = []
        if self._given is not None:
            given_ns, verdict = self._given
            if self._times[0] - given_ns - self._character_ns < self._t3_5_ns:
                verdicts.append(verdict)
        if size < len(self._data) and not self._begins_burst(size):
            verdicts.append(Verdict.GLUED)
        steps = (after - before for before, after in pairwise(self._times[:size]))
        longest_ns = max(steps) - self._character_ns
        if longest_ns >= self._t3_5_ns:
            verdicts.append(Verdict.SPLIT)
        elif longest_ns > self._t1_5_ns:
            verdicts.append(Verdict.T1_5_BROKEN)
        return tuple(dict.fromkeys(verdicts))

    def _skip(self, size: int, events: list[Adu | Skipped]) -> None:
        """Give out bytes as skipped: a frame with a wrong CRC whole, other bytes by bursts."""
        while size:
            kind, reason = why_skipped(bytes(self._data[:size]), _ROLES)
            cut = size
            if kind is not EventKind.BAD_CHECK:
                cut = next((each for each in range(1, size) if self._begins_burst(each)), size)
                kind, reason = why_skipped(bytes(self._data[:cut]), _ROLES)
            raw, times = self._take(cut, Verdict.NOISE_BEFORE)
            events.append(Skipped(times[0], kind, reason, raw))
            size -= cut

    def _take(self, size: int, leaves: Verdict) -> tuple[bytes, list[int]]:
        """Remove and return the first bytes and their times."""
        raw, times = bytes(self._data[:size]), self._times[:size]
        del self._data[:size]
        del self._times[:size]
        self._given = times[-1], leaves
        return raw, times
