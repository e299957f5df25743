"""Beam search for the most likely explanation of a window of bytes from an RTU line."""

# The lattice: candidates.py tells which segments may begin at each byte of the window: a frame, a
# damaged frame, an incomplete frame, or a byte that belongs to none. A path is a chain of such
# segments from the first byte. Its cost is the sum of the costs of its segments (costs.py), each in
# the bus state (bus_state.py) that the segments before it lead to. The search returns the cheapest
# path to the end of the window. A CRC alone would not do: every valid frame that ends in 00 is also
# valid one byte shorter, and every valid frame before a 00 is also valid one byte longer.
#
# The beam: at each offset the BEAM_WIDTH cheapest paths are kept, and none that costs
# costs.BEAM_MARGIN bits more than a path of the same or a greater length. So on a good line the
# search goes from frame to frame, and looks at every byte only where something is wrong. Its work
# is bounded: at most BEAM_WIDTH paths at an offset, about 20 segments for each, and 256 bytes to
# read for each segment.
#
# Speed, measured on a slow core. The slowest input found is random bytes with a silence after each:
# the search decodes 5,500 bytes/s, and a line with 1.75 ms after each byte delivers at most
# 540 bytes/s. Of random bytes in bursts of 32 it decodes 8,000 bytes/s, and a line of 115200 baud
# delivers 6,700.

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Direction
from mbtool.framing.rtu_lengths import MIN_FRAME
from mbtool.modbus.adu import MAX_RTU_ADU
from mbtool.modbus.functions import EXCEPTION_BIT, WRITE_SEVERAL
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import ROLES, BusModel
from mbtool.serial_line.bus_state import DOUBT_BITS, BusState
from mbtool.serial_line.candidates import LONG_SKIP, NOISE, ByteWindow, Candidates, FrameCandidate
from mbtool.serial_line.paths import (
    Path,
    Segment,
    SegmentKind,
    as_doubtful,
    common_end,
    merge_skipped,
    settled_segments,
    with_confidence,
)

if TYPE_CHECKING:
    from mbtool.serial_line.line_statistics import LineStatistics

BEAM_WIDTH = 4
"""The most paths (explanations of the bytes so far) kept at an offset. They differ in their bus
state, or one ends with a skipped byte and another does not."""
NARROW_MARGIN = 8.0
"""A narrow search drops a path that costs this many bits more than the best one."""
MIN_HEAD = 3
"""The bytes of a response before its registers: unit, function and byte count. Fewer skipped bytes
cannot be the beginning of a damaged response."""
MAX_ENCLOSED = 2
"""The most frames in a row that the registers of another frame may contain: a request and its
response."""


class PathSearch:
    """The search for the most likely explanation of the bytes of one window."""

    def __init__(
        self,
        window: ByteWindow,
        bus_model: BusModel,
        statistics: LineStatistics,
        roles: tuple[Direction, ...] = ROLES,
        *,
        is_narrow: bool = False,
    ) -> None:
        """`roles` are the directions that frames can have.

        There is only one if the tap hears only the master or only the slaves. Then costs do not
        depend on the bus state. A narrow search begins with the most likely bus state, and keeps
        one path at each offset. What a dropped path contradicts is doubtful.
        """
        self._window = window
        self._data = window.data
        self._end = len(window.data)
        self._model = bus_model
        self._statistics = statistics
        self._is_speaker_known = len(roles) == 1
        self._paths: dict[int, list[Path]] = {}
        """By offset in the window, the paths (explanations of the bytes) kept that end there and
        were not extended yet."""
        self._lowest_costs = [float("inf")] * (self._end + 1)
        """For each offset in the window, the cost in bits of the cheapest path (explanation of the
        bytes) that ends there."""
        self._incomplete: Path | None = None
        """The cheapest path (explanation of the bytes) that ends in an incomplete frame at the end
        of the window."""
        self._incomplete_limit = float("inf")
        """A path (explanation of the bytes) that ends in an incomplete frame is dropped if it costs
        this many bits or more; infinite until such a path is found."""
        self._limit = float("inf")
        """Paths (explanations of the bytes so far) that cost more bits than this are dropped."""
        self._is_narrow = is_narrow
        self._margin = NARROW_MARGIN if is_narrow else costs.BEAM_MARGIN
        self._candidates = Candidates(window, bus_model, statistics, roles)
        self.settled_size = 0
        """The number of bytes, up to the end of a frame, that all paths explain in the same way.
        `segments` sets it."""

    def segments(self) -> list[Segment]:
        """Return the segments of the most likely path, in order.

        Together they cover the window, or its first bytes up to an offset at which only one path
        was left: what follows there does not change what comes before.
        """
        only = self._extend_all()
        if only is not None:
            self.settled_size = only.end
            return self._doubt_enclosed_frames(list(merge_skipped(with_confidence([only]))))
        ends, incomplete = self._paths.get(self._end, []), self._incomplete
        for path in ends:
            path.cost += self._model.silence_cost(path.state, is_last=True)
        ends.sort(key=_cost)
        self.settled_size = common_end(ends) if incomplete is None else 0
        if incomplete is None or (ends and ends[0].cost < incomplete.cost):
            segments = list(with_confidence(ends))
        elif self._window.must_decide:
            segments = list(with_confidence([incomplete, *ends]))
        else:
            segments = settled_segments(ends, incomplete, self._end)
        return self._doubt_enclosed_frames(list(merge_skipped(segments)))

    def _extend_all(self) -> Path | None:
        """Extend the paths at each offset by the frames and skipped bytes that may follow there.

        Stops and returns a path if it is the only one left and ends with enough whole frames,
        unless a frame of an unknown function may follow: the fast path could not go on there.
        """
        skipped = int(self._window.is_behind_noise)
        first = Path(0.0, self._model.state, None, None, skipped, ends_frame=not skipped)
        self._paths[0] = [first]
        self._lowest_costs[0] = 0.0
        for bits, state in () if self._is_narrow else self._model.states[1:]:
            self._paths[0].append(Path(bits, state, first, None, skipped, ends_frame=not skipped))
        lowest = self._lowest_costs
        while self._paths and (offset := min(self._paths)) < self._end:
            paths = self._paths.pop(offset)
            limit = self._incomplete_limit + costs.INCOMPLETE_MARGIN
            for end in self._paths:
                if end <= offset + MAX_RTU_ADU and lowest[end] + self._margin < limit:
                    limit = lowest[end] + self._margin
            self._limit = limit
            limit = min(limit, lowest[offset] + self._margin)
            paths = [path for path in paths if path.cost <= limit]
            is_only = len(paths) == 1 and not self._paths and self._is_settled(paths[0])
            if is_only and not self._candidates.is_unknown(offset):
                return paths[0]
            if paths:
                self._extend(offset, paths)
        return None

    def _is_settled(self, path: Path) -> bool:
        """True if the only path left ends with frames which no bytes behind them can make ambiguous
        (`_doubt_enclosed_frames`).
        """
        if self._incomplete is not None or path.segment is None or not path.ends_frame:
            return False
        before: Path | None = path
        for _ in range(MAX_ENCLOSED + 1):
            if before is None or before.segment is None or before.is_noise:
                return True
            if not before.ends_frame:
                return False
            before = before.previous
        return True

    def _doubt_enclosed_frames(self, segments: list[Segment]) -> list[Segment]:
        """Mark frames as ambiguous if they may be register contents of one large damaged frame.

        That is so for one or two frames if skipped bytes directly precede and follow them.
        """
        head, frames = -1, 0
        for index, segment in enumerate(segments):
            if segment.kind is SegmentKind.FRAME:
                frames += 1
                continue
            if head >= 0 and 0 < frames <= MAX_ENCLOSED:
                is_short = segment.offset + segment.size - segments[head].offset <= MAX_RTU_ADU
                if is_short and self._may_touch_frame(segment, 0):
                    segments[head + 1 : index] = map(as_doubtful, segments[head + 1 : index])
            head, frames = (index if self._may_touch_frame(segment, segment.size) else -1), 0
        return segments

    def _may_touch_frame(self, segment: Segment, side: int) -> bool:
        """True if a segment is skipped bytes other than noise, with no silence at one of its ends.

        `side` tells the end: 0 for the segment's beginning, the segment's size for its end. Without
        a silence there, the skipped bytes and a frame beside them may be one damaged frame.
        """
        raw = self._data[segment.offset : segment.offset + segment.size]
        is_noise = len(raw) < MIN_HEAD or NOISE.issuperset(raw)
        is_beside = not self._window.silences[segment.offset + side]
        return segment.kind is SegmentKind.SKIPPED and not is_noise and is_beside

    def _keep(self, offset: int, path: Path) -> None:
        """Keep a path (an explanation of the first bytes) unless a cheaper one is equivalent.

        Two paths are equivalent if they end at the same offset in the same bus state, and both or
        neither end with skipped bytes.
        """
        if path.cost > self._limit:
            return
        if path.cost < self._lowest_costs[offset]:
            self._lowest_costs[offset] = path.cost
            if path.cost + self._margin < self._limit:
                self._limit = path.cost + self._margin
        paths = self._paths.get(offset)
        if paths is None:
            self._paths[offset] = [path]
            return
        is_behind_skipped = path.skipped > 0
        for index, other in enumerate(paths):
            if (other.skipped > 0) is is_behind_skipped and other.state == path.state:
                better, worse = (path, other) if path.cost < other.cost else (other, path)
                if worse.cost - better.cost < DOUBT_BITS:
                    better.rivals = (*better.rivals, worse)
                paths[index] = better
                return
        paths.append(path)
        if self._is_narrow or len(paths) > BEAM_WIDTH:
            self._drop(paths)

    def _drop(self, paths: list[Path]) -> None:
        """Remove the path that costs most; in a narrow search, it stays a rival of the best one."""
        worst = max(paths, key=_cost)
        paths.remove(worst)
        if self._is_narrow:
            best = paths[0]
            if worst.cost - best.cost < DOUBT_BITS:
                best.rivals = (*best.rivals, worst)

    def _extend(self, offset: int, paths: list[Path]) -> None:
        """Extend paths that end at an offset by each segment that may begin there."""
        frames = self._candidates.frames(offset)
        silent = self._window.silences[offset]
        likely = [path for path in paths if silent or self._may_begin_frame(path, offset)]
        unknown = list(self._candidates.unknown_frames(offset)) if likely and not frames else []
        glued_cost = 0.0 if silent else self._statistics.glue.bits
        for path in paths:
            state = path.state
            start_cost = glued_cost
            if 0 < path.skipped < LONG_SKIP and self._is_silence_hidden(path, offset):
                start_cost = min(glued_cost, costs.GLUED)
            is_damage = path.skipped >= LONG_SKIP and not self._is_speaker_known
            if is_damage and not state.follows_damage:
                state = state.after_damage()
            for frame in self._with_echoes(offset, frames, state) if frames else ():
                is_behind = path.skipped and self._window.silences[offset + frame.segment.size]
                cost = min(start_cost, costs.BEHIND_NOISE) if is_behind else start_cost
                self._add_frame(path, state, frame, frame.cost + cost)
            if unknown and path in likely:
                is_due = self._is_response_due(path, offset) or state.has_recent_request(
                    self._data[offset], self._data[offset + 1]
                )
                due_cost = costs.UNKNOWN_FORM_DUE - costs.UNKNOWN_FORM if is_due else 0.0
                for frame in unknown:
                    cost = frame.cost + start_cost
                    self._add_frame(
                        path, state, frame, cost + due_cost if frame.is_unbound else cost
                    )
            if not unknown and (silent or not path.skipped):
                self._add_damaged(offset, path, state, start_cost, is_frame=bool(frames))
            self._add_incomplete(offset, path, state, start_cost, is_frame=bool(frames or unknown))
            self._add_skipped(offset, path, bool(frames), bool(unknown))

    def _with_echoes(
        self, offset: int, frames: list[FrameCandidate], state: BusState
    ) -> list[FrameCandidate]:
        """Return the frames, and each that repeats the whole pending request as a response, too."""
        pending = state.pending
        if self._is_speaker_known or pending is None or pending.pdu[0] not in WRITE_SEVERAL:
            return frames
        return frames + [
            replace(one, segment=replace(one.segment, role=Direction.RESPONSE, roles=ROLES))
            for one in frames
            if one.segment.role is Direction.REQUEST
            and pending.is_same(self._data[offset], one.pdu)
        ]

    def _is_silence_hidden(self, path: Path, offset: int) -> bool:
        """True if the few skipped bytes at the end of a path directly follow a silence.

        Then a frame behind these bytes, at `offset`, costs little for having no silence before it.
        """
        return path.skipped > offset or self._window.silences[offset - path.skipped]

    def _may_begin_frame(self, path: Path, offset: int) -> bool:
        """True if a frame probably begins at an offset, where `path` ends.

        That is so behind a frame, and if the bytes there are the unit and function of an earlier
        request or of the expected response.
        """
        if path.ends_frame or (path.is_noise and path.skipped < LONG_SKIP):
            return True
        head = self._data[offset : offset + 2]
        return self._is_response_due(path, offset) or self._model.history.has_function(head)

    def _is_response_due(self, path: Path, offset: int) -> bool:
        """True if the bytes at an offset begin like a response to the request that is pending on
        the path.
        """
        pending = path.state.pending
        return (
            pending is not None
            and offset + MIN_FRAME <= self._end
            and pending.is_named_by(self._data[offset], self._data[offset + 1])
        )

    def _add_frame(self, path: Path, state: BusState, frame: FrameCandidate, cost: float) -> None:
        """Extend a path by a frame. `cost` is the frame's, in bits; the bus state adds to it."""
        segment = frame.segment
        end = segment.offset + segment.size
        if not self._is_speaker_known:
            unit, role = self._data[segment.offset], segment.role
            start_ns = frame.start_ns
            cost += self._model.cost(state, unit, frame.pdu, role, start_ns)
            if path.cost + cost > self._limit:
                return
            inside_ns = frame.inside_ns
            if state.unexplained_silence_ns and state.settles_silence(role, start_ns, inside_ns):
                cost += self._model.silence_cost(state)
            state = self._model.next_state(
                state, unit, frame.pdu, role, start_ns, frame.end_ns, inside_ns
            )
        self._keep(
            end, Path(path.cost + cost, state, path, segment, runs=path.runs, ends_frame=True)
        )

    def _add_incomplete(
        self, offset: int, path: Path, state: BusState, start_cost: float, *, is_frame: bool
    ) -> None:
        """Extend a path by an incomplete frame, from an offset to the window's end.

        `state` is the bus state there, `start_cost` the cost in bits of a missing silence before
        the frame. `is_frame` is True if a complete frame begins at the offset too.
        """
        before = path.cost + start_cost
        least = before + costs.INCOMPLETE + costs.EXPECTED_CONTENT + costs.INCOMPLETE_IN_PLACE
        if least >= self._incomplete_limit:
            return
        if least >= self._lowest_costs[self._end] + costs.BEAM_MARGIN:
            return
        # Noise does not end the wait for a response, so the bus state before the noise counts here.
        found = self._candidates.incomplete(offset, path.state)
        if found is None:
            return
        expected, cost = found
        size = self._end - offset
        is_likely = path.ends_frame or self._window.silences[offset] or cost < 0.0
        if path.is_noise and path.skipped < LONG_SKIP:  # Receivers may hear noise after each frame.
            is_likely |= self._data[offset] in self._model.history.units
        cost += before
        if is_frame:
            cost += costs.INCOMPLETE_DUE_OVER_FRAME if expected else costs.INCOMPLETE_OVER_FRAME
        if path.skipped and not path.is_noise and not is_likely:
            return  # Skipping these bytes as well costs less.
        is_zero = size == 1 and self._data[offset] == 0  # Noise, or the end of the frame before.
        if is_likely and not is_zero:
            cost += costs.INCOMPLETE_IN_PLACE
            is_full = not self._window.silences[self._end]
            if cost > self._limit if is_full else cost >= self._incomplete_limit:
                return
            cost += self._candidates.inside_cost(offset, size, known=expected)
        else:
            cost += self._candidates.split_cost(offset, size) + size * costs.SKIP_PER_BYTE
        incomplete = Path(cost, state, path, Segment(SegmentKind.INCOMPLETE, offset, size))
        if not self._window.silences[self._end]:  # A full window: its last bytes stay undecided.
            self._keep(self._end, incomplete)
        elif cost < self._incomplete_limit:
            self._keep_incomplete(incomplete)

    def _keep_incomplete(self, path: Path) -> None:
        """Keep a path that ends in an incomplete frame if it is the cheapest such path so far.

        Of two paths to the same incomplete frame, the one that costs more becomes a rival of the
        other: it may lower the confidence of the other's segments.
        """
        best = self._incomplete
        if best is not None and best.segment == path.segment:
            best, path = (path, best) if path.cost < best.cost else (best, path)
            best.rivals = (*best.rivals, path)
        elif best is None or path.cost < best.cost:
            best = path
        self._incomplete, self._incomplete_limit = best, best.cost + costs.INCOMPLETE_DOUBT

    def _add_damaged(
        self, offset: int, path: Path, state: BusState, start_cost: float, *, is_frame: bool
    ) -> None:
        """Extend a path by each damaged frame that may begin at an offset.

        `state` is the bus state there, `start_cost` the cost in bits of a missing silence before
        the frame. `is_frame` is True if a frame with a correct CRC begins there too.
        """
        found = self._candidates
        for one in found.damaged_request(offset) if is_frame else found.damaged(offset, state):
            end = offset + one.size
            segment = Segment(
                SegmentKind.DAMAGED, offset, one.size, one.role, repaired=one.repaired
            )
            cost = path.cost + start_cost + one.cost
            if one.repaired and not self._is_speaker_known:
                unit, pdu = one.repaired[0], one.repaired[1:-2]
                start_ns, end_ns = self._window.start_ns(offset), self._window.times[end - 1]
                cost += self._model.cost(state, unit, pdu, one.role, start_ns)
                follows = self._model.next_state(state, unit, pdu, one.role, start_ns, end_ns)
                self._keep(end, Path(cost, follows, path, segment, runs=path.runs))
                cost += costs.NOT_UNDERSTOOD
            ignored = state if self._is_speaker_known else state.after_damage()
            self._keep(end, Path(cost, ignored, path, segment, runs=path.runs))

    def _add_skipped(self, offset: int, path: Path, is_frame: bool, is_unknown: bool) -> None:
        """Extend a path by a byte that belongs to no frame, and by those behind it that can begin
        no frame either, unless the byte is noise.

        `is_frame` is True if a frame with a correct CRC whose function tells its size also begins
        with this byte, `is_unknown` if one whose function does not tell its size does.
        """
        is_noise = self._data[offset] in NOISE and (path.ends_frame or path.is_noise)
        continues = path.skipped and is_noise is path.is_noise
        if continues:
            cost = costs.SKIP_PER_BYTE
        elif is_noise:
            learned = self._statistics.noise.bits
            cost = min(learned, max(learned - path.runs, costs.MIN_NOISE_IN_WINDOW))
        else:  # Noise and the bytes after it are two faults.
            cost = self._statistics.skip.bits - path.runs
            if cost < costs.SKIP_LIMITS[0]:
                cost = costs.SKIP_LIMITS[0]
        if is_frame:
            cost += costs.CRC_COINCIDENCE
        elif is_unknown:
            cost += costs.UNKNOWN_CRC_COINCIDENCE
        total = path.cost + cost
        if total > self._limit:
            return
        end = offset + 1
        if not is_noise:
            end = self._next_place(end, path.state)
            total += (end - offset - 1) * costs.SKIP_PER_BYTE
        segment = Segment(SegmentKind.SKIPPED, offset, end - offset)
        runs = path.runs + (not continues)
        skipped = path.skipped + end - offset
        self._keep(end, Path(total, path.state, path, segment, skipped, is_noise, runs))

    def _next_place(self, offset: int, state: BusState) -> int:
        """Return the first offset, from `offset` on, at which a path that skips bytes other than
        noise can go on in another way, or meets another path.
        """
        place = self._candidates.next_place(offset)
        for end in self._paths:
            if offset <= end < place:
                place = end
        pending = state.pending
        if pending is not None:
            for code in (pending.pdu[0], pending.pdu[0] | EXCEPTION_BIT):
                named = self._data.find(bytes((pending.unit, code)), offset, place + 1)
                place = named if named >= 0 else place
        return place


_cost = attrgetter("cost")
