"""Cuts what one tap hears on a two-wire RTU line into frames."""

# Three questions, from the cheapest to the dearest. Most bytes of a working line are decided by the
# first, so that the search runs only where there is something to search.
#
# 1. Is the frame at the front beyond doubt, or surely a mere beginning (front.py)?
# 2. At a silence of t3.5, what do the bytes held mean (tiling.py)? All is given out but a frame
#    that has only begun: an adapter may have torn it. That is held for HOLD_NS behind its last byte
#    at most, and what stands before it, if only its end would make that certain, for MAX_TEARS
#    silences.
# 3. Without a silence, the same when the window is full. All but its last 256 bytes is given out.
#
# Times: a byte's time is when its last bit arrived. The bytes of one read get their times back from
# the last one by the character time. What comes out depends on these times only, not on how the
# bytes were cut into reads. A clock that was set back ends what was held.
#
# Holds less than WINDOW bytes.

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind
from mbtool.framing.rtu_lengths import MIN_FRAME, why_skipped
from mbtool.modbus.adu import MAX_RTU_ADU, Adu, Checksum, DirectionBy, Skipped, Transport, Verdict
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import ROLES, SURE, BusModel, Classification
from mbtool.serial_line.candidates import LONG_SKIP, NOISE, ByteWindow
from mbtool.serial_line.fast_path import FastPath
from mbtool.serial_line.line_statistics import STEADY, LearnedCost, LineStatistics
from mbtool.serial_line.paths import Segment, SegmentKind
from mbtool.serial_line.search import PathSearch

if TYPE_CHECKING:
    from mbtool.core import SerialFormat

WINDOW = 512
HOLD_NS = 300_000_000
"""A little more than the longest latency timer of an FTDI adapter, 255 ms."""
MAX_TEARS = 16
"""Silences in what is held, after which it is decided: a frame in 32-byte pieces has 8."""

_RARELY = 2**-0.8
"""Where no more of the frames are glued, the silences between them tell who speaks."""


class RtuSplitter:
    """Timed bytes of a line in, `Adu` and `Skipped` out, in order."""

    def __init__(
        self,
        line: SerialFormat,
        turns: BusModel | None = None,
        *,
        timed: bool = True,
        speaker: Direction | None = None,
    ) -> None:
        """`timed` is False where the bytes' times are made up: a file of bytes alone.

        `speaker` is who sends all that is heard: one wire of two, or a tap that hears one side.
        """
        self._character_ns = line.character_ns
        self._t1_5_ns = line.t1_5_ns
        self._t3_5_ns = line.t3_5_ns
        self._silent_ns = line.character_ns + line.t3_5_ns
        """From the end of a byte to the end of one behind a silence."""
        self._timed = timed
        self._speaker = speaker
        self._roles = ROLES if speaker is None else (speaker,)
        self._turns = turns or BusModel(timed=timed)
        self._front = FastPath(self._turns, speaker, WINDOW)
        self._habits = LineStatistics(
            skip=LearnedCost(costs.SKIP, costs.SKIP_LIMITS),
            noise=LearnedCost(costs.NOISE, costs.NOISE_LIMITS, slowest=STEADY),
            glue=LearnedCost(costs.GLUED if timed else 0.0, costs.GLUED_LIMITS),
            tear=LearnedCost(costs.TORN, costs.TORN_LIMITS),
            flip=LearnedCost(costs.FLIPPED, costs.FLIPPED_LIMITS),
        )
        self._data = b""
        self._times: list[int] = []
        self._decided = 0
        """How many of the bytes held were already decided to be the beginning of a frame."""
        self._tears = 0
        """The silences since something was last given out."""
        self._torn_at: list[int] = []
        """Where in what is held they stand."""
        self._was_noise = False
        """Whether the bytes skipped last were all such as a line makes that turns around."""
        self._given: tuple[int, Verdict] | None = None
        """When the last byte given out arrived, and what that makes of a frame close behind it."""

    @property
    def is_idle(self) -> bool:
        """Whether no byte waits to be decided."""
        return not self._data

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the bytes of one read; `ts_ns` is the time of the last one."""
        events: list[Adu | Skipped] = []
        size, step_ns, times = len(data), self._character_ns, self._times
        if not size:
            return events
        first_ns = ts_ns - (size - 1) * step_ns
        # As with most bytes of most frames: nothing can be told yet.
        if (
            times
            and 0 <= first_ns - times[-1] < self._silent_ns
            and len(times) + size < self._front.awaited
        ):
            self._data += data
            times += (ts_ns,) if size == 1 else range(first_ns, ts_ns + 1, step_ns)
            return events
        if self._given is not None and ts_ns < self._given[0]:
            events += self._begin_anew()
        elif self._data:
            silence_ns = first_ns - step_ns - self._times[-1]
            if ts_ns < self._times[-1]:
                events += self._begin_anew()
            elif silence_ns >= self._t3_5_ns:
                self._hear_silence(events, silence_ns >= HOLD_NS)
                if self._data:
                    self._torn_at.append(len(self._data))
        while data:
            room = WINDOW - len(self._data)
            piece, data = data[:room], data[room:]
            self._data += piece
            after_ns = first_ns + len(piece) * step_ns
            self._times += range(first_ns, after_ns, step_ns)
            first_ns = after_ns
            if len(self._data) >= self._front.awaited:
                self._take_front(events)
            if len(self._data) == WINDOW:
                self._search(events, may_go_on=True, keep=MAX_RTU_ADU)
        return events

    def advance(self, now_ns: int) -> list[Adu | Skipped]:
        """Learn that the line was silent from the last byte until now."""
        events: list[Adu | Skipped] = []
        if not self._data:
            return events
        silence_ns = now_ns - self._times[-1]
        if silence_ns >= self._t3_5_ns:
            self._hear_silence(events, silence_ns >= HOLD_NS)
        return events

    def close(self) -> list[Adu | Skipped]:
        """The capture ends; what is held comes out."""
        events: list[Adu | Skipped] = []
        if self._data:
            self._hear_silence(events, is_long=True)
        return events

    def _begin_anew(self) -> list[Adu | Skipped]:
        """The clock was set back: what was held comes out, and no time before counts any more."""
        events = self.close()
        self._given = None
        self._front.begin(behind_noise=False)
        self._turns.begin_anew()
        return events

    def _hear_silence(self, events: list[Adu | Skipped], is_long: bool) -> None:
        """Decide what a silence ends; a long one ends what is held, too."""
        if len(self._data) > self._decided:
            self._tears += 1
            self._end_burst(events, may_go_on=True)
            if self._tears >= MAX_TEARS and self._data:
                told: list[Adu | Skipped] = []
                self._end_burst(told, may_go_on=True, is_pressing=True)
                if self._data and not any(isinstance(one, Adu) for one in told):
                    self._end_burst(told, may_go_on=False)
                events += told
        if is_long and self._data:
            self._end_burst(events, may_go_on=False)

    def _end_burst(
        self, events: list[Adu | Skipped], *, may_go_on: bool, is_pressing: bool = False
    ) -> None:
        self._take_front(events, True)
        is_to_wait = may_go_on and not is_pressing
        if self._data and not (is_to_wait and self._front.is_begun(self._data, self._torn_at)):
            self._search(events, may_go_on=may_go_on, is_pressing=is_pressing)
        self._decided = len(self._data)

    def _take_front(self, events: list[Adu | Skipped], burst_over: bool = False) -> None:
        """Give out the frames at the front that are beyond doubt."""
        while len(self._data) >= MIN_FRAME and (
            frame := self._front.frame(
                self._data,
                self._times[0] - self._character_ns,
                burst_over,
            )
        ):
            self._give(*frame, events)

    def _search(
        self,
        events: list[Adu | Skipped],
        *,
        may_go_on: bool,
        is_pressing: bool = False,
        keep: int = 0,
    ) -> None:
        """Explain all that is held, and give it out but for a frame that has only begun.

        `keep` is how many of the last bytes are not decided yet.
        """
        end = len(self._data)
        window = ByteWindow(
            self._data,
            self._times[:],
            self._character_ns,
            self._silences(keep),
            is_behind_noise=self._is_behind_noise,
            may_go_on=may_go_on,
            is_pressing=is_pressing,
        )
        pieces = PathSearch(window, self._turns, self._habits, self._roles).pieces()
        for piece in pieces:
            size, decided = piece.size, end - keep - piece.place
            if piece.kind is SegmentKind.SKIPPED:
                size = min(size, decided)
            if piece.kind is SegmentKind.OPEN or not 0 < size <= decided:
                break
            if piece.kind is SegmentKind.FRAME:
                self._give(size, self._judged(piece), events)
            else:
                start_ns, end_ns = self._times[0] - self._character_ns, self._times[size - 1]
                self._skip(size, events)
                if piece.kind is SegmentKind.DAMAGED or size >= LONG_SKIP:
                    self._hear_damage(piece, start_ns, end_ns)

    def _hear_damage(self, piece: Segment, start_ns: int, end_ns: int) -> None:
        """Note what damage tells of the line, and of whose turn it is."""
        self._habits.flip.learn(bool(piece.mended))
        if self._speaker is not None:
            return
        if piece.mended:
            self._turns.heard_damaged(piece.mended, piece.role, start_ns, end_ns)
        else:
            self._turns.heard_damage()

    def _silences(self, keep: int) -> list[bool]:
        """Whether a silence stands before each byte, and behind the last."""
        least_ns = self._silent_ns
        times = self._times
        given = self._given
        first = given is None or times[0] - given[0] >= least_ns
        between = [after - before >= least_ns for before, after in pairwise(times)]
        return [first, *between, not keep]

    def _judged(self, piece: Segment) -> Classification:
        """What a frame is that the search has found."""
        if self._speaker is not None:
            return Classification(self._speaker, DirectionBy.PORT, piece.confidence)
        unit, pdu = self._data[0], self._data[1 : piece.size - 2]
        start_ns = self._times[0] - self._character_ns
        alone = self._turns.judge(unit, pdu, start_ns, piece.roles)
        if alone.direction is piece.role:
            return Classification(piece.role, alone.by, piece.confidence)
        # What comes behind it decided otherwise.
        return Classification(piece.role, DirectionBy.IDLE, piece.confidence)

    def _give(self, size: int, judgement: Classification, events: list[Adu | Skipped]) -> None:
        raw = self._data[:size]
        times = self._times
        start_ns, end_ns = times[0] - self._character_ns, times[size - 1]
        before_ns = None if self._given is None else max(start_ns - self._given[0], 0)
        is_even = end_ns - start_ns == size * self._character_ns
        longest_ns = 0 if is_even else self._longest_ns(size)
        verdicts = self._verdicts(size, before_ns, longest_ns, judgement)
        unit, pdu = raw[0], raw[1:-2]
        self._learn(size, before_ns, longest_ns)
        if self._speaker is None:
            self._turns.hear(judgement, unit, pdu, start_ns, end_ns, longest_ns)
        self._drop(size, Verdict.GLUED)
        check = raw[-2] | raw[-1] << 8
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
                checksum=Checksum(check, check),
                silence_before_ns=before_ns if self._timed else None,
                longest_silence_ns=longest_ns if self._timed else None,
                verdicts=verdicts,
            )
        )

    def _longest_ns(self, size: int) -> int:
        """The longest silence inside the frame at the front."""
        times = self._times
        steps = map(int.__sub__, times[1:size], times[: size - 1])
        return max(max(steps) - self._character_ns, 0)

    def _learn(self, size: int, before_ns: int | None, longest_ns: int) -> None:
        """Note what the frame at the front tells of the line and its adapter."""
        was_skipped = self._is_behind_noise
        habits = self._habits
        habits.skip.learn(was_skipped)
        habits.noise.learn(was_skipped and self._was_noise)
        if self._timed:
            if before_ns is not None and not was_skipped:
                habits.glue.learn(before_ns < self._t3_5_ns)
                self._turns.trusts_silences = habits.glue.often <= _RARELY
            habits.tear.learn(longest_ns >= self._t3_5_ns)

    def _verdicts(
        self, size: int, before_ns: int | None, longest_ns: int, judgement: Classification
    ) -> tuple[Verdict, ...]:
        """What is to be noticed about the frame at the front."""
        verdicts = []
        if self._timed:
            if self._given is not None and before_ns is not None and before_ns < self._t3_5_ns:
                verdicts.append(self._given[1])
            if size < len(self._times) and not self._is_silent(size):
                verdicts.append(Verdict.GLUED)
            if longest_ns >= self._t3_5_ns:
                verdicts.append(Verdict.SPLIT)
            elif longest_ns > self._t1_5_ns:
                verdicts.append(Verdict.T1_5_BROKEN)
        elif self._is_behind_noise:
            verdicts.append(Verdict.NOISE_BEFORE)
        if judgement.confidence < SURE:
            verdicts.append(Verdict.AMBIGUOUS)
        return tuple(dict.fromkeys(verdicts)) if verdicts else ()

    def _skip(self, size: int, events: list[Adu | Skipped]) -> None:
        """Give out bytes as skipped: a frame with a wrong CRC whole, other bytes by bursts."""
        while size:
            cut = size
            kind, reason, check = why_skipped(self._data[:size], self._roles)
            if kind is not EventKind.BAD_CHECK:
                cut = next((each for each in range(1, size) if self._is_silent(each)), size)
                kind, reason, check = why_skipped(self._data[:cut], self._roles)
            raw, first_ns = self._data[:cut], self._times[0]
            goes_on = self._is_behind_noise
            self._was_noise = NOISE.issuperset(raw) and (self._was_noise or not goes_on)
            self._drop(cut, Verdict.NOISE_BEFORE)
            events.append(Skipped(first_ns, kind, reason, raw, check))
            size -= cut

    @property
    def _is_behind_noise(self) -> bool:
        return self._given is not None and self._given[1] is Verdict.NOISE_BEFORE

    def _is_silent(self, index: int) -> bool:
        """Whether a silence of t3.5 stands before the byte at an index."""
        step_ns = self._times[index] - self._times[index - 1]
        return step_ns - self._character_ns >= self._t3_5_ns

    def _drop(self, size: int, leaves: Verdict) -> None:
        """Remove the first bytes, which were given out."""
        self._given = self._times[size - 1], leaves
        self._data = self._data[size:]
        del self._times[:size]
        if self._decided:
            self._decided = max(self._decided - size, 0)
        self._front.begin(behind_noise=leaves is Verdict.NOISE_BEFORE)
        self._tears = 0
        if self._torn_at:
            self._torn_at = [place - size for place in self._torn_at if place > size]
