"""Finds the whole, damaged and incomplete RTU frames that may begin at each undecided byte."""

# A window is the bytes that one search explains: each byte is part of a frame, or is skipped. Each
# candidate (a frame that the bytes at one offset may be) has a cost in bits (costs.py): the less
# probable it is, the higher. There are four kinds:
#
#     frames of a known form     The function tells the length, and the CRC is correct.
#     frames of unknown form     Only a correct CRC or a silence tells where the frame ends.
#     damaged frames
#     an incomplete frame        It ends with the window.
#
# If the cost of a candidate does not depend on the bus state, it is computed once for each offset.
# The work for one offset is bounded by the 256 bytes that a frame can have.

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.framing.rtu_lengths import MIN_FRAME, CrcSums, frame_size
from mbtool.modbus.adu import CRC_BYTES, MAX_RTU_ADU, RTU_EXTRA_BYTES, crc, crc_on
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.modbus.pdu import parse_pdu
from mbtool.serial_line import costs
from mbtool.serial_line.costs import is_counted
from mbtool.serial_line.paths import Segment, SegmentKind

if TYPE_CHECKING:
    from mbtool.serial_line.bus_model import BusModel
    from mbtool.serial_line.bus_state import BusState
    from mbtool.serial_line.line_statistics import LineStatistics

# Bit repair: finds the one wrong bit of a damaged RTU frame, so that the frame can be read.
#
# A CRC is linear: after one wrong bit, the remainder depends only on the position of that bit in
# the frame. A frame of 20 bytes has 160 bit positions, and there are 65,536 remainders. So of 400
# frames with other damage, one looks by chance as if it had a single wrong bit.


def repaired(frame: bytes) -> bytes | None:
    """Return the frame with one bit changed so that its CRC is correct; None if no bit does that.

    `frame` has at most 256 bytes, and its CRC is wrong.
    """
    place = _wrong_bits().get(crc(frame))
    if place is None or place // 8 >= len(frame):
        return None
    at, bit = len(frame) - 1 - place // 8, place % 8
    return frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]


@cache
def _wrong_bits() -> dict[int, int]:
    """Map the CRC of a whole frame with one wrong bit (0 if all bits are right) to the bit's place.

    The place is 8 times the number of bytes behind the wrong byte, plus the bit's number (0 to 7).
    """
    places = {}
    for behind in range(MAX_RTU_ADU):
        for bit in range(8):
            places[crc_on(0, bytes([1 << bit]) + bytes(behind))] = 8 * behind + bit
    return places


MAX_UNKNOWN_ENDS = 3
"""A frame of an unknown function may end wherever its CRC is correct. At most this many ends are
tried."""
LOST_BYTES = (1, 2)
"""A damaged frame is also tried as a frame of which 1 or 2 bytes were lost."""
LONG_SKIP = 4
"""This many skipped bytes in a row, or more, may contain a damaged request or response."""

NOISE = frozenset(b"\x00\xf8\xfc\xfe\xff")
"""The bytes that receivers hear when the bus changes direction: one low period, read as a byte."""
COUNTED = frozenset(b"\x0f\x10\x17")
"""The functions whose requests carry a quantity and a byte count."""
_BITS = tuple(1 << bit for bit in range(8))
_QUERY_DATA = b"\x08\x00\x00"
"""Function 08, sub-function 0 may carry any amount of data, and no byte tells how much
(V1.1b3, 6.8.1)."""


@dataclass(frozen=True, slots=True)
class ByteWindow:
    """The bytes of a line that one search explains, with their times."""

    data: bytes
    times: list[int]
    """For each byte, the time at which it ended, in ns."""
    character_ns: int
    silences: list[bool]
    """For each byte, True if a silence of t3.5 precedes it. One more value at the end is True if a
    silence follows the last byte."""
    is_behind_noise: bool
    """True if the bytes directly before the window belong to no frame."""
    may_continue: bool
    """True if later bytes may still complete an incomplete frame at the end of the window."""
    must_decide: bool = False
    """True if the bytes before an incomplete frame must be decided before its end has come."""

    def start_ns(self, offset: int) -> int:
        """The time at which the byte at an offset of the window began, in ns."""
        return self.times[offset] - self.character_ns


class FrameCandidate(msgspec.Struct, gc=False):
    """A candidate: bytes of the window that are a frame with a correct CRC."""

    segment: Segment
    pdu: bytes
    cost: float
    """In bits; with the cost of the silences inside the frame."""
    start_ns: int
    end_ns: int
    inside_ns: int
    """The longest silence inside the frame, in ns; 0 if none is as long as t3.5."""
    is_unbound: bool = False
    """True if only the frame's CRC tells where the frame ends."""


class DamagedCandidate(msgspec.Struct, gc=False):
    """A candidate: bytes of the window that are possibly a damaged frame."""

    size: int
    cost: float
    role: Direction = Direction.UNKNOWN
    repaired: bytes = b""
    """The frame as it was sent, if one wrong bit explains the damage; empty otherwise."""


AHEAD = 12
"""The frames at this many offsets are looked for in one call, as most offsets are asked about one
after the other."""


class _RangeCount:
    """Counts the offsets in a range that have a property; looks at each once.

    `having` takes two offsets; it tells for each offset from the first up to the second if it has.
    All offsets are below `limit`.
    """

    __slots__ = ("_before", "_having", "_limit")

    def __init__(self, having: Callable[[int, int], Iterable[bool]], limit: int) -> None:
        self._having = having
        self._limit = limit
        self._before = [0]
        """For each offset, the number of smaller offsets that have the property."""

    def has(self, offset: int) -> bool:
        before = self._before
        if len(before) <= offset + 1:
            return self.count(offset, offset + 1) > 0
        return before[offset] != before[offset + 1]

    def count(self, first: int, end: int) -> int:
        if end <= first:
            return 0
        before = self._before
        if len(before) <= end:
            begin = len(before) - 1
            ahead = min(max(end, begin + AHEAD), self._limit)
            before += accumulate(self._having(begin, ahead), initial=before.pop())
        return before[end] - before[first]


class Candidates:
    """The whole, damaged and incomplete frames that may begin at each byte of a window."""

    def __init__(
        self,
        window: ByteWindow,
        bus_model: BusModel,
        statistics: LineStatistics,
        roles: tuple[Direction, ...],
    ) -> None:
        self._window = window
        self._data = window.data
        self._end = len(window.data)
        self._model = bus_model
        self._statistics = statistics
        self._roles = roles
        self._crcs = crcs = CrcSums(window.data)
        self._sized: dict[int, tuple[bytes, list[tuple[Direction, int | None]]]] = {}
        """By offset examined so far, the bytes there, as many as a frame can have, and the size
        that they tell for each direction."""
        self._frames: dict[int, list[FrameCandidate]] = {}
        """By offset examined so far, the frames with a correct CRC that begin there."""
        self._ends: dict[int, list[int]] = {}
        """By offset examined so far, the first sizes up to which the bytes have a correct CRC."""
        self._places: list[int] = []
        """The offsets searched so far at which a frame may begin behind bytes that belong to none,
        in order."""
        self._searched_to = 0
        """All offsets below this one were searched for places, except those never asked for."""
        self._stateless: dict[int, list[DamagedCandidate]] = {}
        """By offset examined so far, the damaged frames that begin there and cost the same in every
        bus state."""
        self._all_frames = _RangeCount(
            lambda first, end: crcs.frame_starts(first, end, roles), self._end
        )
        self._frames_after_silence = _RangeCount(
            lambda first, end: [
                window.silences[at] and self._begins_after_silence(at) for at in range(first, end)
            ],
            self._end,
        )
        self._silences = [0, 0, *accumulate(window.silences[1:])]
        """For each offset, the number of bytes before it that directly follow a silence of t3.5."""

    def next_place(self, offset: int) -> int:
        """Return the first offset, from `offset` on, at which a frame may begin behind bytes that
        belong to no frame; the window's end if there is none.

        A frame of known form with a correct CRC begins there, or a silence, or the unit and
        function of an earlier request, or a write whose byte count agrees with its quantity.
        """
        places = self._places
        if not places or places[-1] < offset:
            self._find_place(max(self._searched_to, offset))
        found = bisect_left(places, offset)
        return places[found] if found < len(places) else self._end

    def _find_place(self, first: int) -> None:
        """Add the first place from an offset on to the known ones."""
        data, history, silences = self._data, self._model.history, self._window.silences
        units, functions, end = history.units, history.functions, self._end
        starts = self._all_frames
        for at in range(first, end):
            unit, code = data[at], data[at + 1] if at + 1 < end else None
            if (
                silences[at]
                or (unit in units and (code is None or (unit, code & ~EXCEPTION_BIT) in functions))
                or (code in COUNTED and is_counted(data[at + 1 : at + MAX_RTU_ADU]))
                or starts.has(at)
            ):
                self._places.append(at)
                self._searched_to = at + 1
                return
        self._searched_to = end

    def split_cost(self, offset: int, size: int) -> float:
        """Return the cost, in bits, of the silences of t3.5 inside the `size` bytes of a frame."""
        silences = self._silences[offset + size] - self._silences[offset + 1]
        if not silences:
            return 0.0
        return self._statistics.split.bits + (silences - 1) * costs.SPLIT_MORE

    def inside_cost(self, offset: int, size: int, *, known: bool = True) -> float:
        """Return the cost, in bits, of silences and other frames inside the bytes of a frame."""
        return self.split_cost(offset, size) + self._enclosed_cost(offset, size, known=known)

    def _enclosed_cost(self, offset: int, size: int, *, known: bool) -> float:
        """Return the cost, in bits, of frames that begin inside bytes taken for one longer frame.

        An inner frame without a silence before it costs nothing: registers may look like a frame by
        chance. An inner frame after a silence costs CRC_COINCIDENCE. If `known` is False, the bus
        state does not expect the longer frame; then all inner frames but one cost that much, with
        or without a silence.
        """
        first, last = offset + 1, offset + size - MIN_FRAME + 1
        enclosed = self._frames_after_silence.count(first, last)
        if not known:
            enclosed = max(enclosed, self._all_frames.count(first, last) - 1)
        return costs.CRC_COINCIDENCE * enclosed

    def _begins_after_silence(self, offset: int) -> bool:
        """True if a frame begins at `offset`, before which a silence is.

        The frame has a correct CRC, and ends where its function tells or at the next silence.
        """
        if self.frames(offset):
            return True
        burst = self._burst_size(offset)
        return burst >= MIN_FRAME and self._crcs.is_correct(offset, offset + burst)

    def frames(self, offset: int) -> list[FrameCandidate]:
        """Return the frames at an offset with a correct CRC and the size their function tells."""
        frames = self._frames.get(offset)
        if frames is None:
            frames = self._frames[offset] = self._find_frames(offset)
        return frames

    def _find_frames(self, offset: int) -> list[FrameCandidate]:
        frames: list[FrameCandidate] = []
        if not self._all_frames.has(offset):
            return frames
        head, sizes = self._sizes(offset)
        for role, size in sizes:
            if size and size <= len(head) and self._crcs.is_correct(offset, offset + size):
                malformed = parse_pdu(head[1 : size - 2], role).problem is not None
                roles = tuple(other for other, same in sizes if same == size)
                cost = costs.MALFORMED if malformed else 0.0
                frames.append(self.frame(offset, size, role, roles, cost))
        return frames

    def frame(
        self,
        offset: int,
        size: int,
        role: Direction,
        roles: tuple[Direction, ...],
        cost: float,
        *,
        is_unbound: bool = False,
    ) -> FrameCandidate:
        """Return the candidate of `size` bytes, with the cost of the silences inside it."""
        end, inside_ns = offset + size, 0
        if self._silences[end] != self._silences[offset + 1]:
            cost += self.split_cost(offset, size)
            inside = self._window.times[offset:end]
            inside_ns = max(map(int.__sub__, inside[1:], inside)) - self._window.character_ns
        segment = Segment(SegmentKind.FRAME, offset, size, role, roles)
        pdu, times = self._data[offset + 1 : end - CRC_BYTES], self._window.times
        start_ns = times[offset] - self._window.character_ns
        return FrameCandidate(segment, pdu, cost, start_ns, times[end - 1], inside_ns, is_unbound)

    def _sizes(self, offset: int) -> tuple[bytes, list[tuple[Direction, int | None]]]:
        """Return the bytes at an offset, as many as a frame can have, and by direction the size of
        the frame that begins with them (`frame_size`).
        """
        sized = self._sized.get(offset)
        if sized is None:
            head = self._data[offset : offset + MAX_RTU_ADU]
            sized = head, [(role, frame_size(head, role)) for role in self._roles]
            self._sized[offset] = sized
        return sized

    def is_unknown(self, offset: int) -> bool:
        """True if no byte at an offset tells the size of a frame that begins there."""
        return all(size == 0 for _, size in self._sizes(offset)[1])

    def unknown_frames(self, offset: int) -> Iterator[FrameCandidate]:
        """Yield frames at an offset with a correct CRC whose function does not tell their size."""
        if offset + MIN_FRAME <= self._end:
            burst = self._burst_size(offset) if self._window.silences[offset] else 0
            yield from self._whole_burst(offset, burst)
            yield from self._ended_by_crc(offset, burst)

    def _whole_burst(self, offset: int, burst: int) -> Iterator[FrameCandidate]:
        """Yield the `burst` bytes at `offset`, if their CRC is correct, as a frame for each role.

        `burst` is the number of bytes from one silence to the next; 0 if no silence precedes them.
        """
        if burst < MIN_FRAME or not self._crcs.is_correct(offset, offset + burst):
            return
        head, sizes = self._sizes(offset)
        for role, known_size in sizes:
            is_longer = head[1:4] == _QUERY_DATA and burst > (known_size or burst)
            odd = costs.MALFORMED if known_size and not is_longer else 0.0
            cost = costs.UNKNOWN_FORM_BURST + odd + self._zero_end_cost(offset, burst)
            yield self.frame(offset, burst, role, self._roles, cost)

    def _ended_by_crc(self, offset: int, burst: int) -> Iterator[FrameCandidate]:
        """Yield frames of unknown size that end where the CRC is correct.

        The frame that fills the whole burst (`burst` bytes between two silences) is left out.
        """
        head, sizes = self._sizes(offset)
        is_query = head[1:4] == _QUERY_DATA
        roles = [role for role, size in sizes if is_query or (head[1] and size == 0)]
        ends = self._unknown_ends(offset) if roles else []
        for size in ends:
            if size == burst:
                continue
            cost = self._enclosed_cost(offset, size, known=False)
            cost += costs.CRC_COINCIDENCE * self._chained(offset + ends[0], offset + size)
            if not cost and self._all_frames.count(offset + 1, offset + size - MIN_FRAME + 1):
                cost = costs.UNKNOWN_CRC_COINCIDENCE
            is_burst = size < burst and not any(head[size:burst])  # Only 00 follows in the burst.
            cost += costs.UNKNOWN_FORM_BURST if is_burst else costs.UNKNOWN_FORM
            cost += self._zero_end_cost(offset, size)
            for role in roles:
                yield self.frame(offset, size, role, self._roles, cost, is_unbound=not is_burst)

    def _unknown_ends(self, offset: int) -> list[int]:
        """Return the sizes up to which the bytes at an offset have a correct CRC, the least first,
        at most MAX_UNKNOWN_ENDS.
        """
        ends = self._ends.get(offset)
        if ends is None:
            ends = self._ends[offset] = self._crcs.sizes(offset, MAX_UNKNOWN_ENDS)
        return ends

    def _chained(self, offset: int, end: int) -> int:
        """Return how many frames follow each other from an offset on, up to the offset `end`.

        Each ends where its CRC is first correct. A longer frame whose bytes they are has all these
        correct CRCs by chance.
        """
        count = 0
        while offset + MIN_FRAME <= end:
            ends = self._unknown_ends(offset)
            if not ends or offset + ends[0] > end:
                break
            count, offset = count + 1, offset + ends[0]
        return count

    def _zero_end_cost(self, offset: int, size: int) -> float:
        """Return the cost, in bits, of supposing that bytes 00 at a frame's end belong to it."""
        if self._data[offset + size - 1]:
            return 0.0
        raw = self._data[offset : offset + size]
        zeros = size - max(len(raw.rstrip(b"\x00")), MIN_FRAME)
        if not zeros:
            return 0.0
        more = (zeros - 1) * costs.ENDS_IN_ZERO_MORE
        is_last = self._window.silences[offset + size]
        return costs.ENDS_IN_ZERO + more - (costs.ZERO_BEFORE_SILENCE if is_last else 0.0)

    def _burst_size(self, offset: int) -> int:
        """Return the number of bytes up to the next silence; 0 if none is within 256 bytes."""
        for size in range(1, min(MAX_RTU_ADU, self._end - offset) + 1):
            if self._window.silences[offset + size]:
                return size
        return 0

    def damaged(self, offset: int, state: BusState) -> list[DamagedCandidate]:
        """Return damaged frames that may begin at an offset where no correct frame begins."""
        found: list[DamagedCandidate] = []
        if offset + MIN_FRAME > self._end:
            return found
        head, sizes = self._sizes(offset)
        for role, size in sizes:
            if size and size <= MAX_RTU_ADU:
                found += self._damaged_as(offset, head, size, role, state)
        stateless = self._stateless.get(offset)
        if stateless is None:
            stateless = self._stateless[offset] = [
                *self._repaired_frames(offset),
                *self._damaged_burst(offset),
            ]
        return found + stateless

    def _damaged_as(
        self, offset: int, head: bytes, size: int, role: Direction, state: BusState
    ) -> list[DamagedCandidate]:
        """Return the damaged frames of direction `role` that had `size` bytes when they were sent.

        Only a frame that the bus state expects is also tried with one or two lost bytes.
        """
        found = []
        expected, cost = self._expectation(head, size, role, state)
        if not expected:
            cost += costs.UNEXPECTED_DAMAGED
        cost += costs.DAMAGED + size * costs.SKIP_PER_BYTE
        if size <= len(head) and not self._crcs.is_correct(offset, offset + size):
            inside = self.inside_cost(offset, size, known=expected)
            found.append(DamagedCandidate(size, cost + inside))
        for lost in LOST_BYTES if expected else ():
            if MIN_FRAME <= size - lost <= len(head):
                more = costs.DAMAGED_OTHER_SIZE + self.inside_cost(offset, size - lost)
                found.append(DamagedCandidate(size - lost, cost + more))
        return found

    def _damaged_burst(self, offset: int) -> Iterator[DamagedCandidate]:
        """Yield all bytes up to the next silence as one frame, as if its function or byte count,
        which tell its size, were damaged. That is done only if silences separate all frames on this
        line: else the bytes may be several frames.
        """
        burst = self._burst_size(offset) if self._window.silences[offset] else 0
        if (
            burst > 2 * MIN_FRAME
            and self._statistics.glue.bits > costs.NEVER_GLUED
            and not self._is_frame_in_noise(offset, burst)
            and not self._ends_in_frame(offset, burst)
        ):
            cost = self._statistics.skip.bits + costs.DAMAGED_OTHER_SIZE + costs.UNEXPECTED_DAMAGED
            cost += min(burst * costs.SKIP_PER_BYTE, costs.MAX_DAMAGED_LENGTH)
            yield DamagedCandidate(burst, cost)

    def _repaired_frames(self, offset: int) -> list[DamagedCandidate]:
        """Return frames with one wrong bit.

        If the bit is in function or byte count, which falsifies the size, only functions that were
        requested of the frame's unit are tried: with all functions, such frames would be found
        everywhere.
        """
        found = []
        history = self._model.history
        head, sizes = self._sizes(offset)
        have = len(head)
        for role, size in sizes:
            if size and size <= have:
                whole = repaired(head[:size])
                if whole is not None and frame_size(whole, role) == size:
                    found.append(self._repaired(offset, whole, role))
        unit, code = head[0], head[1]
        if unit not in history.units:
            return found
        others = [
            head[:1] + bytes((code ^ bit,)) + head[2:]
            for bit in _BITS
            if (unit, (code ^ bit) & ~EXCEPTION_BIT) in history.functions
        ]
        if (unit, code & ~EXCEPTION_BIT) in history.functions:
            others += [head[:2] + bytes((head[2] ^ bit,)) + head[3:] for bit in _BITS]
        for whole in others:
            for role, size_now in sizes:
                size = frame_size(whole, role)
                if not size or size == size_now or not MIN_FRAME <= size <= have:
                    continue
                if crc(whole[:size]) == 0:
                    found.append(self._repaired(offset, whole[:size], role))
        return found

    def _repaired(self, offset: int, whole: bytes, role: Direction) -> DamagedCandidate:
        size = len(whole)
        cost = costs.ONE_WRONG_BIT + self._statistics.one_bit.bits
        cost += size * costs.ONE_WRONG_BIT_PER_BYTE
        return DamagedCandidate(size, cost + self.inside_cost(offset, size), role, whole)

    def damaged_request(self, offset: int) -> Iterator[DamagedCandidate]:
        """Yield a damaged request at an offset where a frame with a correct CRC seems to begin.

        Only a request that was heard before without damage is tried. A request whose CRC ends in 00
        has a correct CRC without that byte too. So if just that byte is lost, the rest may look
        like a whole response.
        """
        head, sizes = self._sizes(offset)
        size = dict(sizes).get(Direction.REQUEST)
        if not size or (head[0], head[1 : size - 2]) not in self._model.history.requests:
            return
        cost = costs.DAMAGED + costs.EXPECTED_CONTENT + size * costs.SKIP_PER_BYTE
        if size <= len(head) and not self._crcs.is_correct(offset, offset + size):
            yield DamagedCandidate(size, cost + self.split_cost(offset, size))
        if size - 1 <= len(head) and self._crcs.is_correct(offset, offset + size - 1):
            cost += costs.DAMAGED_OTHER_SIZE
            yield DamagedCandidate(size - 1, cost + self.split_cost(offset, size - 1))

    def _is_frame_in_noise(self, offset: int, size: int) -> bool:
        """True if the `size` bytes are a frame with at most three bytes of noise at each end."""
        burst = self._data[offset : offset + size]
        befores = [at for at in range(LONG_SKIP) if NOISE.issuperset(burst[:at])]
        behinds = [at for at in range(LONG_SKIP) if NOISE.issuperset(burst[size - at :])]
        return any(
            crc(burst[before : size - behind]) == 0 for before in befores for behind in behinds
        )

    def _ends_in_frame(self, offset: int, size: int) -> bool:
        """True if bytes between two silences end with a whole frame, but do not begin with it.

        That frame is not register contents of a longer frame, since the longer frame's CRC would
        follow the registers.
        """
        end = offset + size
        return any(
            at + frame.segment.size == end
            for at in range(offset + 1, end - MIN_FRAME + 1)
            for frame in self.frames(at)
        )

    def _expectation(
        self, head: bytes, size: int, role: Direction, state: BusState
    ) -> tuple[bool, float]:
        """Return if `state` expects the frame, and a cost in bits: negative for known contents."""
        pdu_size = size - RTU_EXTRA_BYTES if size else 0
        unit, pdu = head[0], head[1 : 1 + pdu_size]
        if role is Direction.REQUEST:
            if pdu and len(pdu) == pdu_size and (unit, pdu) in self._model.history.requests:
                return True, costs.EXPECTED_CONTENT
            if is_counted(head[1:]):
                return True, 0.0
        elif state.awaits_exactly(unit, head[1], pdu_size):
            return True, costs.EXPECTED_CONTENT
        return self._model.expects(state, unit, head[1], pdu_size, role), 0.0

    def incomplete(self, offset: int, state: BusState) -> tuple[bool, float] | None:
        """Take the bytes from an offset to the window's end for the beginning of a frame.

        Returns a bool, True if the bus state expects that frame, and the cost in bits of taking the
        bytes for it. Returns None if the bytes cannot be the beginning of a frame, or if no more
        bytes can follow.
        """
        rest = self._end - offset
        if not self._window.may_continue or rest >= MAX_RTU_ADU:
            return None
        if rest < 2:
            return False, costs.INCOMPLETE
        head, sizes = self._sizes(offset)
        best: tuple[bool, float] | None = None
        for role, size in sizes:
            one = self._incomplete_as(head, size, role, state)
            if one is not None and (best is None or one[1] < best[1]):
                best = one
        return best

    def _incomplete_as(
        self, head: bytes, size: int | None, role: Direction, state: BusState
    ) -> tuple[bool, float] | None:
        rest = len(head)
        if size is None or rest < size <= MAX_RTU_ADU:
            expected, cost = self._expectation(head, size or 0, role, state)
            if role is Direction.REQUEST:
                if is_counted(head[1:]):
                    cost = costs.EXPECTED_CONTENT
                elif self._model.history.begins_request(head):
                    expected, cost = True, costs.EXPECTED_CONTENT
        elif size == 0 or head[1:4] == _QUERY_DATA[: rest - 1]:
            expected = self._model.expects(state, head[0], head[1], 0, role)
            cost = costs.UNKNOWN_FORM_BURST
            if role is Direction.REQUEST and head[1] & EXCEPTION_BIT:
                cost += costs.IMPLAUSIBLE_REQUEST
        else:
            return None
        if expected:
            cost += costs.INCOMPLETE + rest * costs.INCOMPLETE_DUE_PER_BYTE
        else:
            unexpected = costs.INCOMPLETE + costs.INCOMPLETE_UNEXPECTED
            cost += unexpected + rest * costs.INCOMPLETE_PER_BYTE
        return expected, cost
