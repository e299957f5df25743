"""Cuts what one tap hears on a two-wire RTU line into frames."""

# Three steps decide the bytes, from the cheapest to the most expensive. The first decides most
# bytes of a working line, so the search runs only where something is unclear.
#
# 1. The fast path (fast_path.py) tells whether the next frame is certain, or certainly incomplete.
# 2. At a silence of t3.5, the search (search.py) explains the buffered bytes. All are returned
#    except an incomplete frame, which an adapter may have split. It stays buffered until HOLD_NS
#    after its last byte, or HOLD_DUE_NS if it is the frame that is due. The bytes before the
#    incomplete frame stay too if only its end can make their meaning certain, but for at most
#    MAX_SILENCES silences.
# 3. Without a silence, the search runs when the buffer (the window) is full. All but its last 256
#    bytes are returned. Frames in the last 256 bytes are returned if every explanation of the
#    window contains them.
#
# A search stops at a frame behind which only one explanation is left, if the function of the next
# frame tells its size, and the fast path goes on there. So its work grows with the number of
# unclear places, not with the number of bytes.
#
# The time of a byte is the end of its last bit. The bytes of one read get their times from the time
# of the last one, a character time apart. The output depends on these times only, not on how the
# bytes were divided into reads. When the clock was set back, all buffered bytes are returned; a
# step back of at most MAX_BACK_NS is a wrong time of a read.
#
# Memory: less than WINDOW bytes.

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from msgspec.structs import replace

from mbtool.core import Direction, EventKind, SerialFormat
from mbtool.core.limits import MAX_BACK_NS
from mbtool.framing.rtu_lengths import (
    MAX_SUMMED,
    MIN_FRAME,
    doubled_size,
    frame_size,
    has_frame,
    is_frame_between,
    why_skipped,
)
from mbtool.modbus.adu import (
    MAX_RTU_ADU,
    Adu,
    Checksum,
    DirectionBy,
    Skipped,
    Transport,
    Verdict,
    crc,
)
from mbtool.modbus.functions import ECHOING, NEVER_ECHOED, WRITE_SEVERAL
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import (
    CERTAIN_BY,
    ROLES,
    SURE,
    UNSURE,
    BusModel,
    Classification,
    roles_of,
)
from mbtool.serial_line.bus_state import NO_RIVAL_CONFIDENCE
from mbtool.serial_line.candidates import LONG_SKIP, NOISE, ByteWindow
from mbtool.serial_line.fast_path import FastPath
from mbtool.serial_line.frame_copies import FrameCopies
from mbtool.serial_line.line_statistics import (
    MAX_GLUED,
    BurstStatistics,
    LatencyStatistics,
    LineStatistics,
)
from mbtool.serial_line.paths import Segment, SegmentKind
from mbtool.serial_line.response_timeout import last_silence, longest_silence_ns
from mbtool.serial_line.search import PathSearch

WINDOW = MAX_SUMMED
"""The number of bytes at which the search decides without a silence: two frames of full size."""
HOLD_NS = 1_000_000_000
"""An incomplete frame waits this long, in ns, for more bytes. FTDI adapters wait at most 255 ms,
and radio modems pause up to 0.5 s within a frame."""
HOLD_DUE_NS = 30_000_000_000
"""The beginning of the frame that is due, with its unit and function, waits this long (ns) for its
rest. Between two reads of 8 KB, a program can leave a frame torn for as long, and meanwhile nothing
else is heard."""
MAX_SILENCES = 16
"""After this many silences of t3.5, the search must decide what the buffered bytes are, even if
they may end with an incomplete frame. A frame of 256 bytes that comes in pieces of 32 bytes has 8
silences."""

USUAL_ECHO = 6
"""The number of bytes of a request with 0FH or 10H that its response repeats: unit, function,
address and quantity."""

LONG_DOUBT = 48
"""Searches become narrow once this many more frames were in doubt than not: on a line this unclear,
more explanations of the bytes cost time and decide little."""

LONG_NOISE = 2 * WINDOW
"""After this many bytes without a frame, the search runs only if the buffer has a frame with a
correct CRC: a damaged frame found among as much noise would probably be noise, too."""


class _BehindNoise(NamedTuple):
    """A certain frame behind bytes that belong to no frame."""

    skipped: int
    """The number of bytes that were skipped."""
    frame: tuple[int, Classification]


_COPIED_RETRY = Classification(Direction.REQUEST, DirectionBy.TIMING, 1.0)


class RtuSplitter:
    """Takes timed bytes of a line; returns `Adu` (frames) and `Skipped`, in order."""

    def __init__(
        self,
        line: SerialFormat,
        bus_model: BusModel | None = None,
        *,
        timed: bool = True,
        speaker: Direction | None = None,
    ) -> None:
        """`timed` is False if the bytes have no known times, as in a raw file.

        `speaker` is the direction of all frames if only one direction is heard; else None.
        """
        self._character_ns = line.character_ns
        self._t1_5_ns = line.t1_5_ns
        self._t3_5_ns = line.t3_5_ns
        self._silent_ns = line.character_ns + line.t3_5_ns
        """The time, in ns, from the end of a byte to the end of the next one if a silence of t3.5
        lies between them."""
        self._timed = timed
        self._speaker = speaker
        self._roles = ROLES if speaker is None else (speaker,)
        self._model = bus_model or BusModel(timed=timed)
        self._model.history.least_silence_ns = 2 * line.t3_5_ns
        self._fast_path = FastPath(self._model, speaker, WINDOW)
        self._behind_noise = FastPath(self._model, speaker, WINDOW)
        self._statistics = LineStatistics(timed=timed)
        self._bursts = BurstStatistics()
        self._copies = FrameCopies()
        self.has_disorder = False
        """True once the time of a read was a little earlier than that of the read before."""
        self._data = b""
        self._times: list[int] = []
        self._decided_size = 0
        """The number of buffered bytes that the last search took for an incomplete frame."""
        self._silence_count = 0
        """The number of silences of t3.5 since bytes were last returned."""
        self._silences_at: list[int] = []
        """The offsets of the buffered bytes that have a silence of t3.5 before them."""
        self._doubtful = 0
        """One more for each frame in doubt, one less for each other frame."""
        self._is_lost = False
        """True if a narrow search was in doubt about a frame and none certain by its form followed:
        then all frames are in doubt, as only one bus state is kept."""
        self._noise_size = 0
        """The number of bytes returned since the last frame; they belong to no frame."""
        self._was_noise = False
        """True if the last skipped bytes were all noise, as heard when the bus changes
        direction."""
        self._follows_silence = True
        """True if a silence of t3.5 precedes the frame returned last."""
        self._last_end: tuple[int, Verdict] | None = None
        """The end (ns) of the last returned byte, and the verdict on a frame right behind it; or
        None."""

    @property
    def is_idle(self) -> bool:
        """True if no byte is buffered."""
        return not self._data

    def feed(self, data: bytes, ts_ns: int) -> list[Adu | Skipped]:
        """Take the bytes of one read; return the frames and skipped bytes that they complete.

        `ts_ns` is the end of the last byte, in ns.
        """
        events: list[Adu | Skipped] = []
        size, step_ns, times = len(data), self._character_ns, self._times
        if not size:
            return events
        first_ns = ts_ns - (size - 1) * step_ns
        # Test the usual case first, because the test is quick: more bytes of an incomplete frame.
        if (
            times
            and 0 <= first_ns - times[-1] < self._silent_ns
            and len(times) + size < self._fast_path.needed
        ):
            self._data += data
            times += (ts_ns,) if size == 1 else range(first_ns, ts_ns + 1, step_ns)
            return events
        last_ns = times[-1] if times else self._last_end and self._last_end[0]
        if last_ns is not None and ts_ns < last_ns:
            if last_ns <= ts_ns + MAX_BACK_NS:
                self.has_disorder = True
                first_ns = last_ns + step_ns
            else:
                events += self._restart()
        if times:
            silence_ns = first_ns - step_ns - times[-1]
            if silence_ns >= self._t3_5_ns:
                self._hear_silence(events, silence_ns)
                self._silences_at.append(len(self._data))
        while data:
            room = WINDOW - len(self._data)
            part, data = data[:room], data[room:]
            self._data += part
            after_ns = first_ns + len(part) * step_ns
            self._times += range(first_ns, after_ns, step_ns)
            first_ns = after_ns
            if len(self._data) >= self._fast_path.needed:
                self._emit_certain_frames(events)
            if len(self._data) == WINDOW:
                self._search(events, may_continue=True, keep=MAX_RTU_ADU)
                self._emit_certain_frames(events)
        return events

    def advance(self, now_ns: int) -> list[Adu | Skipped]:
        """Note that the line was silent from the last byte until `now_ns`.

        Returns the frames and skipped bytes that this silence ends.
        """
        events: list[Adu | Skipped] = []
        if self._data and (silence_ns := now_ns - self._times[-1]) >= self._t3_5_ns:
            self._hear_silence(events, silence_ns)
        return events

    def close(self) -> list[Adu | Skipped]:
        """End the capture: return all buffered bytes, as frames and skipped bytes."""
        events: list[Adu | Skipped] = []
        if self._data:
            self._hear_silence(events, HOLD_DUE_NS)
        return events

    def _restart(self) -> list[Adu | Skipped]:
        """Return the buffered bytes; forget times and bus state, as the clock was set back."""
        events = self.close()
        self._last_end = None
        self._fast_path.restart(0, behind_noise=False)
        self._model.reset_state()
        return events

    def _hear_silence(self, events: list[Adu | Skipped], silence_ns: int) -> None:
        """Decide what the buffered bytes are; an incomplete frame waits if the silence is short."""
        may_hold = self._last_end is None and silence_ns < HOLD_NS
        if may_hold and self._model.holds_first_frame and self._is_first_alone():
            return
        if len(self._data) > self._decided_size:
            self._silence_count += 1
            self._end_burst(events, may_continue=True)
            if self._silence_count >= MAX_SILENCES and self._data:
                told: list[Adu | Skipped] = []
                self._end_burst(told, may_continue=True, must_decide=True)
                if self._data and not any(isinstance(one, Adu) for one in told):
                    self._end_burst(told, may_continue=False)
                events += told
        is_long = silence_ns >= HOLD_NS and self._data
        if is_long and (silence_ns >= HOLD_DUE_NS or not self._begins_due_frame()):
            self._end_burst(events, may_continue=False)

    def _is_first_alone(self) -> bool:
        """True if the buffered bytes are the first frame of the capture, and its form allows both
        directions.
        """
        data = self._data
        if self._last_end is not None or self._speaker is not None or len(data) < MIN_FRAME:
            return False
        return data[0] > 0 and crc(data) == 0 and len(roles_of(data[1:-2])) > 1

    def _begins_due_frame(self) -> bool:
        """True if the buffered bytes are certainly the beginning of the frame that is due."""
        has_function = len(self._data) > 1
        return has_function and self._fast_path.is_incomplete(self._data, self._silences_at)

    def _end_burst(
        self, events: list[Adu | Skipped], *, may_continue: bool, must_decide: bool = False
    ) -> None:
        self._emit_certain_frames(events, True)
        is_to_wait = may_continue and not must_decide
        while self._data and not (
            is_to_wait
            and (
                self._copies.awaits(self._data)
                or self._fast_path.is_incomplete(self._data, self._silences_at)
                or self._is_due_behind_noise()
            )
        ):
            if not self._search(events, may_continue=may_continue, must_decide=must_decide):
                break
            self._emit_certain_frames(events, True)
        self._decided_size = len(self._data)

    def _emit_certain_frames(self, events: list[Adu | Skipped], burst_over: bool = False) -> None:
        """Append frames while the fast path is certain; `burst_over`: a silence follows `_data`."""
        copies = self._copies
        while len(self._data) >= MIN_FRAME:
            last = copies.last
            if last and self._data.startswith(last) and self._take_copy(events):
                continue
            last = copies.last_response
            if last and self._data.startswith(last) and self._take_repeated(events):
                continue
            if copies.repeats and (size := doubled_size(self._data, self._roles)):
                self._emit_frame(size, self._classified_alone(size), events)
                continue
            copied = copies.copied
            if copied and self._may_be_copied(len(copied)):
                have = copies.copied_size(self._data)
                if have >= 2 * len(copied):  # Only requests are copied, so it is a retry.
                    self._emit_frame(len(copied), _COPIED_RETRY, events)
                    continue
                if have == len(self._data) and not burst_over:
                    return
            start_ns = self._times[0] - self._character_ns
            frame = self._fast_path.frame(self._data, start_ns, burst_over)
            if frame is None:
                behind = self._frame_behind_noise(burst_over)
                if behind is None:
                    return
                self._emit_skipped(behind.skipped, events)
                frame = behind.frame
            self._emit_frame(*frame, events)
            if self._doubtful:
                self._doubtful -= 1

    def _frame_behind_noise(self, burst_over: bool) -> _BehindNoise | None:
        """Find a certain frame that follows the last one closely, with stray bytes between the two.

        The stray bytes are fewer than LONG_SKIP, and this line has such bytes often.
        """
        data, times = self._data, self._times
        for size in self._often_skipped(len(data) - MIN_FRAME):
            if not self._is_no_frame(data[size - 1 :]):
                return None
            start_ns = times[size] - self._character_ns
            self._behind_noise.restart(0, behind_noise=True)
            frame = self._behind_noise.frame(data[size:], start_ns, burst_over)
            if frame is not None:
                return _BehindNoise(size, frame)
        return None

    def _is_due_behind_noise(self) -> bool:
        """True if the buffered bytes are stray ones and certainly the beginning of the frame that
        is due, on a line that has such bytes often.
        """
        for size in self._often_skipped(len(self._data) - 1):
            self._behind_noise.restart(0, behind_noise=True)
            if self._behind_noise.is_incomplete(self._data[size:], ()):
                return True
        return False

    def _often_skipped(self, end: int) -> Iterator[int]:
        """Give the numbers below `end` of bytes at the front that may be stray ones between two
        frames, as this line has often.
        """
        noise, skip = self._statistics.noise, self._statistics.skip
        if noise.frequency < costs.OFTEN_SKIPPED and skip.frequency < costs.OFTEN_SKIPPED:
            return
        if self._is_behind_noise or self._last_end is None or len(self._model.states) > 1:
            return
        for size in range(1, min(LONG_SKIP, end)):
            learned = noise if NOISE.issuperset(self._data[:size]) else skip
            if learned.frequency < costs.OFTEN_SKIPPED:
                return
            yield size

    def _is_no_frame(self, data: bytes) -> bool:
        """True if no frame that this line could expect begins with the bytes."""
        pending = self._model.state.pending
        if data[0] in self._model.history.units or (pending and pending.unit == data[0]):
            return False
        sizes = [frame_size(data, role) for role in self._roles]
        return not any(
            size is None or size > len(data) or (size and crc(data[:size]) == 0) for size in sizes
        )

    def _may_be_copied(self, size: int) -> bool:
        """True if a silence of t3.5 precedes the next `size` bytes and none follows them so far."""
        last = self._last_end
        if last is None or self._times[0] - last[0] < self._silent_ns:
            return False
        is_copy = len(self._data) <= size or not self._is_silent(size)
        return is_copy and self._model.history.trusts_silences

    def _take_copy(self, events: list[Adu | Skipped]) -> bool:
        """Skip the next bytes if they are an adapter's copy of the last request; True if so."""
        last = self._copies.last
        if not last or self._last_end is None or not self._data.startswith(last):
            return False
        size, first_ns = len(last), self._times[0]
        # An adapter that merges a request with its retry also merges it with the frame before. So
        # if a silence precedes the request, these bytes are no retry but a copy.
        is_heard = self._model.history.trusts_silences and self._follows_silence
        is_glued = is_heard and first_ns - self._last_end[0] < self._silent_ns
        # If no silence follows these bytes, they may begin a longer frame.
        is_glued &= len(self._data) == size or self._is_silent(size)
        is_exact = first_ns - self._last_end[0] > self._character_ns
        if not self._copies.takes_copy(glued=is_glued, exact=is_exact):
            return False
        self._remove(size, Verdict.GLUED)
        events.append(Skipped(first_ns, EventKind.ECHO, self._copies.said(), last))
        return True

    def _take_repeated(self, events: list[Adu | Skipped]) -> bool:
        """Skip the next bytes if they are a repeater's copy of the last response; True if so."""
        copy, first_ns = self._copies.last_response, self._times[0] if self._times else 0
        if not self._copies.takes_repeated(self._data):
            return False
        self._remove(len(copy), Verdict.GLUED)
        events.append(Skipped(first_ns, EventKind.REPEATED, self._copies.said_of_response(), copy))
        return True

    def _search(
        self,
        events: list[Adu | Skipped],
        *,
        may_continue: bool,
        must_decide: bool = False,
        keep: int = 0,
    ) -> bool:
        """Explain the buffered bytes by a search; append all but an incomplete frame to `events`.

        The last `keep` bytes stay undecided, except those beyond doubt. The other arguments are
        explained in ByteWindow.
        Returns True if the search stopped where the first bytes were beyond doubt, so that the
        bytes behind them have to be decided next.
        """
        data, cuts, end = self._data, self._silences_at, len(self._data)
        is_long_noise = self._noise_size >= LONG_NOISE
        if is_long_noise and not (has_frame(data, self._roles) or is_frame_between(data, cuts)):
            if keep or must_decide or not may_continue:
                self._emit_skipped(end - keep, events)
            return False
        last = self._last_end
        silences = [False] * (end + 1)
        silences[0] = last is None or self._times[0] - last[0] >= self._silent_ns
        for cut in cuts:
            silences[cut] = True
        silences[end] = not keep
        window = ByteWindow(
            data,
            self._times[:],
            self._character_ns,
            silences,
            is_behind_noise=self._is_behind_noise,
            may_continue=may_continue,
            must_decide=must_decide,
        )
        is_narrow = self._doubtful > LONG_DOUBT
        search = PathSearch(window, self._model, self._statistics, self._roles, is_narrow=is_narrow)
        segments = search.segments()
        decided = max(end - keep, search.settled_size)
        history = self._model.history
        hears_only_slaves = history.hears_only_slaves
        for segment in segments:
            if history.hears_only_slaves is not hears_only_slaves:
                # An earlier segment changed this; the search ran with the old value, so that its
                # later segments may be wrong.
                return True
            size, decidable = segment.size, decided - segment.offset
            if segment.kind is SegmentKind.SKIPPED:
                size = min(size, decidable)
            if segment.kind is SegmentKind.INCOMPLETE or not 0 < size <= decidable:
                return False
            if segment.kind is SegmentKind.FRAME:
                classified = self._classification_of(segment)
                is_clear = classified.confidence >= NO_RIVAL_CONFIDENCE
                doubtful = self._doubtful - 1 if is_clear else self._doubtful + 1
                self._doubtful = min(max(doubtful, 0), 2 * LONG_DOUBT)
                if is_narrow:
                    self._is_lost |= not is_clear
                    classified = replace(classified, is_final=True)
                self._emit_frame(size, classified, events)
                if self._take_copy(events) or self._take_repeated(events):
                    # The search took the copy for a frame, so its later segments are wrong.
                    return True
            else:
                start_ns, end_ns = self._times[0] - self._character_ns, self._times[size - 1]
                self._emit_skipped(size, events)
                if size >= LONG_SKIP:
                    self._hear_damage(segment, start_ns, end_ns)
        return True

    def _hear_damage(self, segment: Segment, start_ns: int, end_ns: int) -> None:
        """Learn from skipped or damaged bytes, and compute the possible bus states after them."""
        self._statistics.one_bit.learn(bool(segment.repaired))
        if self._speaker is not None:
            return
        if segment.repaired:
            self._model.hear_damaged_frame(segment.repaired, segment.role, start_ns, end_ns)
        else:
            self._model.hear_damage()

    def _classification_of(self, segment: Segment) -> Classification:
        """Return the direction of a frame that the search has found, and what decided it."""
        if self._speaker is not None:
            return Classification(self._speaker, DirectionBy.PORT, segment.confidence)
        alone = self._classified_alone(segment.size, segment.roles)
        # If the frame alone seems to have the other direction, the bytes behind it decided.
        by = alone.by if alone.direction is segment.role else DirectionBy.IDLE
        return Classification(segment.role, by, segment.confidence)

    def _classified_alone(self, size: int, roles: tuple[Direction, ...] = ()) -> Classification:
        """Return the direction of the next `size` bytes, whatever frames follow them."""
        unit, pdu, start_ns = self._data[0], self._data[1 : size - 2], self._times[0]
        return self._model.classify(unit, pdu, start_ns - self._character_ns, roles)

    def _emit_frame(
        self, size: int, classification: Classification, events: list[Adu | Skipped]
    ) -> None:
        """Append the frame of the first `size` bytes to `events`, remove it, and learn from it."""
        raw, times = self._data[:size], self._times
        self._noise_size = 0
        start_ns, end_ns = times[0] - self._character_ns, times[size - 1]
        before_ns = None if self._last_end is None else max(start_ns - self._last_end[0], 0)
        is_even = end_ns - start_ns == size * self._character_ns
        longest_ns = 0 if is_even else longest_silence_ns(times, size, self._character_ns)
        unit, pdu, confidence = raw[0], raw[1:-2], classification.confidence
        if self._is_lost and classification.by in CERTAIN_BY:
            self._is_lost = False
        if self._is_lost or (self._last_end is None and self._is_first_alone()):
            confidence = min(confidence, UNSURE)
        if pdu[0] in ECHOING and self._speaker is None:
            model = self._model
            if model.history.may_hear_only_slaves or model.may_be_retry(unit, pdu, start_ns):
                confidence = min(confidence, UNSURE)
            if model.may_be_reversed(start_ns):  # Nothing is learned from such a frame.
                confidence = min(confidence, UNSURE)
                classification = replace(classification, confidence=confidence, is_final=True)
            if model.may_be_slow(unit, pdu, start_ns):
                confidence = min(confidence, UNSURE)
                classification = replace(classification, confidence=confidence)
            waited_ns = before_ns or 0
            if (
                self._copies.copied
                and not model.history.shows_master_wait(waited_ns)
                and self._copies.may_copy_retry(raw, self._data[size:])
            ):
                confidence = min(confidence, UNSURE)
        if (
            pdu[0] in WRITE_SEVERAL
            and self._speaker is None
            and classification.direction is Direction.REQUEST
            and self._model.may_be_whole_echo(unit, pdu, start_ns)
            and not self._data.startswith(raw[:USUAL_ECHO], size)
        ):
            confidence = min(confidence, UNSURE)
        if self._copies.copies and self._copies.may_copy(raw, self._data[size:]):
            confidence = min(confidence, UNSURE)
        verdicts = self._verdicts(size, before_ns, longest_ns, confidence)
        self._learn(size, before_ns, longest_ns)
        self._follows_silence = before_ns is None or before_ns >= self._t3_5_ns
        if self._speaker is None:
            self._model.hear(classification, unit, pdu, start_ns, end_ns, longest_ns)
            if classification.direction is Direction.REQUEST:
                is_certain = classification.by is DirectionBy.FORM or pdu[0] in NEVER_ECHOED
                copies = self._copies
                is_soon = copies.last == raw and self._is_soon(before_ns)
                copies.hear_request(raw, is_certain=is_certain, is_soon=is_soon)
            else:
                # If only slaves are heard, equal responses are not a repeater's copies.
                is_only = self._model.history.hears_only_slaves
                is_certain = pdu[0] not in ECHOING and not is_only
                self._copies.hear_response(raw, is_certain=is_certain)
        self._remove(size, Verdict.GLUED)
        check = raw[-2] | raw[-1] << 8
        events.append(
            Adu(
                start_ns=start_ns,
                end_ns=end_ns,
                transport=Transport.RTU,
                direction=classification.direction,
                direction_by=classification.by,
                confidence=confidence,
                unit=unit,
                pdu=pdu,
                raw=raw,
                checksum=Checksum(check, check),
                silence_before_ns=before_ns if self._timed else None,
                longest_silence_ns=longest_ns if self._timed else None,
                verdicts=verdicts,
            )
        )

    def _is_soon(self, before_ns: int | None) -> bool:
        """True if a frame comes sooner (ns) after the one before than any master repeats it."""
        is_heard = self._model.history.trusts_silences and before_ns is not None
        return is_heard and 0 < (before_ns or 0) < LatencyStatistics.MIN_RETRY_NS

    def _learn(self, size: int, before_ns: int | None, longest_ns: int) -> None:
        """Learn from the silences (ns) before and in the next frame, and from noise before it."""
        last, statistics = self._last_end, self._statistics
        was_skipped = last is not None and last[1] is Verdict.NOISE_BEFORE
        if was_skipped or not (statistics.skip.is_at_rest and statistics.noise.is_at_rest):
            statistics.skip.learn(was_skipped)
            statistics.noise.learn(was_skipped and self._was_noise)
        if self._timed:
            is_split = longest_ns >= self._t3_5_ns
            if before_ns is not None and not was_skipped:
                is_glued, glue = before_ns < self._t3_5_ns, statistics.glue
                if is_split or not is_glued:
                    self._model.history.hears_silences = True
                if is_glued or not glue.is_at_rest:
                    glue.learn(is_glued)
                bursts = self._bursts
                if before_ns == 0 or bursts.has_merged:
                    cut = last_silence(self._times, size, self._silent_ns) if is_split else size
                    bursts.hear_frame(before_ns, size, cut, is_glued=is_glued)
                    self._model.history.merges_briefly = bursts.merges_briefly
                    self._model.history.may_merge_long = not bursts.merges_briefly
                is_trusted = glue.frequency <= MAX_GLUED and not bursts.may_merge_retry
                self._model.history.trusts_silences = is_trusted
            if is_split or not statistics.split.is_at_rest:
                statistics.split.learn(is_split)

    def _verdicts(
        self, size: int, before_ns: int | None, longest_ns: int, confidence: float
    ) -> tuple[Verdict, ...]:
        """Return the verdicts on the next frame, from the silences (ns) before and inside it."""
        verdicts, times, last = [], self._times, self._last_end
        if self._timed:
            if last is not None and before_ns is not None and before_ns < self._t3_5_ns:
                verdicts.append(last[1])
            if size < len(times) and times[size] - times[size - 1] < self._silent_ns:
                verdicts.append(Verdict.GLUED)
            if longest_ns >= self._t3_5_ns:
                verdicts.append(Verdict.SPLIT)
            elif longest_ns > self._t1_5_ns:
                verdicts.append(Verdict.T1_5_BROKEN)
        elif last is not None and last[1] is Verdict.NOISE_BEFORE:
            verdicts.append(Verdict.NOISE_BEFORE)
        if confidence < SURE:
            verdicts.append(Verdict.AMBIGUOUS)
        return tuple(dict.fromkeys(verdicts)) if verdicts else ()

    def _emit_skipped(self, size: int, events: list[Adu | Skipped]) -> None:
        """Skip the first `size` bytes; append an event for a bad CRC's frame, or for each burst."""
        self._noise_size += size
        while size:
            cut = size
            kind, reason, check = why_skipped(self._data[:size], self._roles)
            if kind is not EventKind.BAD_CHECK:
                cut = next((each for each in range(1, size) if self._is_silent(each)), size)
                kind, reason, check = why_skipped(self._data[:cut], self._roles)
            raw, first_ns = self._data[:cut], self._times[0]
            is_first = not self._is_behind_noise
            self._was_noise = NOISE.issuperset(raw) and (self._was_noise or is_first)
            self._remove(cut, Verdict.NOISE_BEFORE)
            events.append(Skipped(first_ns, kind, reason, raw, check))
            size -= cut

    @property
    def _is_behind_noise(self) -> bool:
        return self._last_end is not None and self._last_end[1] is Verdict.NOISE_BEFORE

    def _is_silent(self, offset: int) -> bool:
        """True if a silence of t3.5 precedes the byte at an offset."""
        return self._times[offset] - self._times[offset - 1] >= self._silent_ns

    def _remove(self, size: int, leaves: Verdict) -> None:
        """Remove the first `size` bytes; a frame directly behind them gets the verdict `leaves`."""
        self._last_end = self._times[size - 1], leaves
        self._data = self._data[size:]
        del self._times[:size]
        if self._decided_size:
            self._decided_size = max(self._decided_size - size, 0)
        self._fast_path.restart(size, behind_noise=leaves is Verdict.NOISE_BEFORE)
        self._silence_count = 0
        if self._silences_at:
            self._silences_at = [offset - size for offset in self._silences_at if offset > size]
