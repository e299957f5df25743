"""What may begin at each place of a window of bytes from an RTU line, and what that costs."""

# Frames of the length that their function has as a request or a response and whose CRC is right;
# frames of no known form that the CRC and the silences bound; damaged frames; a frame whose end is
# still to come. What does not depend on the turn is found once for each place. The work for a place
# is bounded by the 256 bytes that a frame may have.

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.framing.rtu_lengths import MIN_FRAME, crc_ends, frame_size
from mbtool.modbus.adu import MAX_RTU_ADU
from mbtool.modbus.adu_bytes import RTU_EXTRA_BYTES, crc
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.modbus.pdu import parse_pdu
from mbtool.serial_line import costs
from mbtool.serial_line.bit_repair import mended
from mbtool.serial_line.plausibility import is_counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.serial_line.bus_model import BusModel
    from mbtool.serial_line.bus_state import BusState
    from mbtool.serial_line.line_statistics import LineStatistics

MOST_UNKNOWN_ENDS = 3
"""Ends that are tried of a frame whose function no table knows."""
LOST_BYTES = (1, 2)
"""How many bytes a damaged frame is supposed to have lost."""
LONG_SKIP = 4
"""Skipped bytes after which the turn is in doubt: a damaged frame may be among them."""

NOISE = frozenset(b"\x00\xf8\xfc\xfe\xff")
_QUERY_DATA = b"\x08\x00\x00"
"""Sub-function 0 of 08 may be longer than usual, and nothing tells how long (V1.1b3, 6.8.1)."""


@dataclass(frozen=True, slots=True)
class ByteWindow:
    """Bytes of a line, with when each arrived."""

    data: bytes
    times: list[int]
    character_ns: int
    silences: list[bool]
    """Whether a silence of t3.5 stands before each byte; of the first, and behind the last."""
    is_behind_noise: bool
    """Whether what was given out last belongs to no frame."""
    may_go_on: bool
    """Whether a frame whose end is not here may still be completed."""
    is_pressing: bool = False
    """Whether what stands before such a frame is to be told, though its end might tell better."""

    def start_ns(self, place: int) -> int:
        return self.times[place] - self.character_ns


class Frame(msgspec.Struct, gc=False):
    """One with a correct CRC."""

    size: int
    role: Direction
    roles: tuple[Direction, ...]
    cost: float
    is_unbound: bool = False
    """Whether its CRC alone tells where it ends."""


class Damaged(msgspec.Struct, gc=False):
    """A frame that may have been damaged."""

    size: int
    cost: float
    role: Direction = Direction.UNKNOWN
    mended: bytes = b""
    """The frame as it was sent, if one wrong bit explains it."""


class _RangeCount:
    """At how many places of a range something is so; each place is asked once."""

    __slots__ = ("_before", "_is_so")

    def __init__(self, is_so: Callable[[int], bool]) -> None:
        self._is_so = is_so
        self._before = [0]

    def count(self, first: int, end: int) -> int:
        if end <= first:
            return 0
        before = self._before
        while len(before) <= end:
            before.append(before[-1] + self._is_so(len(before) - 1))
        return before[end] - before[first]


class Candidates:
    """The pieces that may be laid in one window."""

    def __init__(
        self,
        window: ByteWindow,
        turns: BusModel,
        habits: LineStatistics,
        roles: tuple[Direction, ...],
    ) -> None:
        self._window = window
        self._data = window.data
        self._end = len(window.data)
        self._turns = turns
        self._habits = habits
        self._roles = roles
        self._found: dict[int, list[Frame]] = {}
        self._damaged: dict[int, list[Damaged]] = {}
        self._anywhere = _RangeCount(lambda place: bool(self.frames(place)))
        self._behind_silences = _RangeCount(self._begins)
        self._torn = [0] * (self._end + 2)
        for place in range(1, self._end + 1):
            self._torn[place + 1] = self._torn[place] + window.silences[place]

    def tears(self, place: int, size: int) -> float:
        torn = self._torn[place + size] - self._torn[place + 1]
        return self._habits.tear.bits + (torn - 1) * costs.TORN_MORE if torn else 0.0

    def longest_ns(self, place: int, size: int) -> int:
        """The longest silence inside a piece, if there is one of t3.5."""
        if self._torn[place + size] == self._torn[place + 1]:
            return 0
        times = self._window.times[place : place + size]
        return max(map(int.__sub__, times[1:], times)) - self._window.character_ns

    def inside(self, place: int, size: int, *, known: bool = True) -> float:
        """What it costs that silences stand inside a piece, and that frames begin there."""
        return self.tears(place, size) + self._swallowed(place, size, known=known)

    def _swallowed(self, place: int, size: int, *, known: bool) -> float:
        """What it costs that frames begin inside a piece.

        Registers may hold what looks like a frame, but not behind a silence, and hardly twice
        where the piece is not `known` by more than its length.
        """
        first, last = place + 1, place + size - MIN_FRAME + 1
        begins = self._behind_silences.count(first, last)
        if not known:
            begins = max(begins, self._anywhere.count(first, last) - 1)
        return costs.COINCIDENCE * begins

    def _begins(self, place: int) -> bool:
        """Whether a frame begins behind a silence: of known form, or up to the next silence."""
        if not self._window.silences[place]:
            return False
        if self.frames(place):
            return True
        burst = self._burst(place)
        return burst >= MIN_FRAME and crc(self._data[place : place + burst]) == 0

    def frames(self, place: int) -> list[Frame]:
        """Frames of known form with a correct CRC."""
        frames = self._found.get(place)
        if frames is None:
            frames = self._found[place] = self._find_frames(place)
        return frames

    def _find_frames(self, place: int) -> list[Frame]:
        frames: list[Frame] = []
        head = self._data[place : place + MAX_RTU_ADU]
        have = len(head)
        if have < MIN_FRAME:
            return frames
        sizes = [(role, frame_size(head, role)) for role in self._roles]
        for role, size in sizes:
            if size and size <= have and crc(head[:size]) == 0:
                malformed = parse_pdu(head[1 : size - 2], role).problem is not None
                roles = tuple(other for other, same in sizes if same == size)
                frames.append(Frame(size, role, roles, costs.MALFORMED if malformed else 0.0))
        return frames

    def unknown(self, place: int) -> Iterator[Frame]:
        """Frames that no known form bounds, but the silences or the CRC."""
        head = self._data[place : place + MAX_RTU_ADU]
        if len(head) < MIN_FRAME:
            return
        burst = self._burst(place) if self._window.silences[place] else 0
        if burst >= MIN_FRAME and crc(head[:burst]) == 0:
            for role in self._roles:
                usual = frame_size(head, role)
                is_longer = head[1:4] == _QUERY_DATA and burst > (usual or burst)
                odd = costs.MALFORMED if usual and not is_longer else 0.0
                cost = costs.UNKNOWN_BETWEEN_SILENCES + odd
                if head[burst - 1] == 0:
                    cost += self._ends_in_zero(place, burst)
                yield Frame(burst, role, self._roles, cost)
        unsized = [role for role in self._roles if head[1] and frame_size(head, role) == 0]
        if head[1:4] == _QUERY_DATA:
            unsized = list(self._roles)
        if not unsized:
            return
        for size in crc_ends(head, MOST_UNKNOWN_ENDS):
            if size == burst:
                continue
            cost = self._swallowed(place, size, known=False)
            if not cost and self._anywhere.count(place + 1, place + size - MIN_FRAME + 1):
                cost = costs.UNKNOWN_COINCIDENCE
            is_burst = size < burst and not any(head[size:burst])  # But for the 00 behind it.
            cost += costs.UNKNOWN_BETWEEN_SILENCES if is_burst else costs.UNKNOWN
            is_unbound = not is_burst
            if head[size - 1] == 0:
                cost += self._ends_in_zero(place, size)
            for role in unsized:
                yield Frame(size, role, self._roles, cost, is_unbound)

    def _ends_in_zero(self, place: int, size: int) -> float:
        """What it costs that a frame which no known form bounds ends in 00."""
        raw = self._data[place : place + size]
        zeros = size - max(len(raw.rstrip(b"\x00")), MIN_FRAME)
        if not zeros:
            return 0.0
        more = (zeros - 1) * costs.ENDS_IN_ZERO_MORE
        is_last = self._window.silences[place + size]
        return costs.ENDS_IN_ZERO + more - (costs.ADHERES if is_last else 0.0)

    def _burst(self, place: int) -> int:
        """How many bytes there are up to the next silence; 0 where none stands near."""
        for size in range(1, min(MAX_RTU_ADU, self._end - place) + 1):
            if self._window.silences[place + size]:
                return size
        return 0

    def damaged(self, place: int, turn: BusState) -> Iterator[Damaged]:
        """Frames that may have been damaged, where none with a correct CRC begins."""
        head = self._data[place : place + MAX_RTU_ADU]
        if len(head) < MIN_FRAME:
            return
        for role in self._roles:
            size = frame_size(head, role)
            if not size or size > MAX_RTU_ADU:
                continue
            expected, cost = self._expected(head, size, role, turn)
            if not expected:
                cost += costs.UNEXPECTED
            cost += costs.DAMAGED + size * costs.SKIP_MORE
            if size <= len(head) and crc(head[:size]) != 0:
                yield Damaged(size, cost + self.inside(place, size, known=expected))
            if expected:
                for lost in LOST_BYTES:
                    if MIN_FRAME <= size - lost <= len(head):
                        more = costs.DAMAGED_SIZE + self.inside(place, size - lost, known=True)
                        yield Damaged(size - lost, cost + more)
        yield from self._hurt(place)

    def _hurt(self, place: int) -> list[Damaged]:
        """Those of the damaged frames that no turn makes likelier."""
        found = self._damaged.get(place)
        if found is None:
            head = self._data[place : place + MAX_RTU_ADU]
            found = [*self._mended_tails(place, head), *self._mended_heads(place, head)]
            burst = self._burst(place) if self._window.silences[place] else 0
            if (
                burst > 2 * MIN_FRAME
                and self._habits.glue.bits > costs.NEVER
                and not self._is_frame_in_noise(place, burst)
            ):
                # Damaged where it begins. What it holds is no frame, as none is glued here.
                cost = self._habits.skip.bits + costs.DAMAGED_SIZE + costs.UNEXPECTED
                cost += min(burst * costs.SKIP_MORE, costs.MOST_FOR_LENGTH)
                found.append(Damaged(burst, cost))
            self._damaged[place] = found
        return found

    def _mended_tails(self, place: int, head: bytes) -> Iterator[Damaged]:
        """Frames whose size is what it seems, and in which one bit is wrong."""
        for role in self._roles:
            size = frame_size(head, role)
            if size and size <= len(head):
                whole = mended(head[:size])
                if whole is not None and frame_size(whole, role) == size:
                    yield self._mended(place, whole, role)

    def _mended_heads(self, place: int, head: bytes) -> Iterator[Damaged]:
        """Frames whose size is not what it seems, since the wrong bit is in what says it.

        Of functions that their unit was asked for: any other would be looked for everywhere.
        """
        if not self._turns.has_asked(head[:1]):
            return
        for at, bit in product((1, 2), range(8)):
            start = head[:at] + bytes([head[at] ^ 1 << bit])
            if not self._turns.has_asked(start[:2]):
                continue
            whole = start + head[at + 1 :]
            for role in self._roles:
                size = frame_size(whole, role)
                if not size or not MIN_FRAME <= size <= len(head):
                    continue
                if size != frame_size(head, role) and crc(whole[:size]) == 0:
                    yield self._mended(place, whole[:size], role)

    def _mended(self, place: int, whole: bytes, role: Direction) -> Damaged:
        size = len(whole)
        cost = costs.ONE_BIT + self._habits.flip.bits + size * costs.ONE_BIT_MORE
        return Damaged(size, cost + self.inside(place, size), role, whole)

    def usual(self, place: int) -> Iterator[Damaged]:
        """A request heard before that was damaged in what a shorter frame has not.

        One whose CRC ends in 00 may be a whole response without it.
        """
        head = self._data[place : place + MAX_RTU_ADU]
        size = frame_size(head, Direction.REQUEST) if Direction.REQUEST in self._roles else 0
        if not size or not self._turns.was_asked(head[0], head[1 : size - 2]):
            return
        cost = costs.DAMAGED + costs.FORESEEN + size * costs.SKIP_MORE
        if size <= len(head) and crc(head[:size]) != 0:
            yield Damaged(size, cost + self.tears(place, size))
        if size - 1 <= len(head) and crc(head[: size - 1]) == 0:
            cost += costs.DAMAGED_SIZE
            yield Damaged(size - 1, cost + self.tears(place, size - 1))

    def _is_frame_in_noise(self, place: int, size: int) -> bool:
        """Whether a burst is a frame with stray bytes at its ends, a few of them."""
        burst = self._data[place : place + size]
        befores = [at for at in range(LONG_SKIP) if NOISE.issuperset(burst[:at])]
        behinds = [at for at in range(LONG_SKIP) if NOISE.issuperset(burst[size - at :])]
        return any(
            crc(burst[before : size - behind]) == 0 for before in befores for behind in behinds
        )

    def _expected(
        self, head: bytes, size: int, role: Direction, turn: BusState
    ) -> tuple[bool, float]:
        """Whether a frame that begins so is due, and what speaks for it beside that."""
        pdu_size = size - RTU_EXTRA_BYTES if size else 0
        unit, pdu = head[0], head[1 : 1 + pdu_size]
        if role is Direction.REQUEST:
            if pdu and len(pdu) == pdu_size and self._turns.was_asked(unit, pdu):
                return True, costs.FORESEEN
            if is_counted(head[1:]):
                return True, 0.0
        elif turn.foresees(unit, head[1], pdu_size):
            return True, costs.FORESEEN
        return self._turns.expects(turn, unit, head[1], pdu_size, role), 0.0

    def begun(self, place: int, turn: BusState) -> tuple[bool, float | None]:
        """Whether the rest can be a frame that is due and has only begun, and what that costs."""
        rest = self._end - place
        if not self._window.may_go_on or rest >= MAX_RTU_ADU:
            return False, None
        head = self._data[place:]
        if rest < 2:
            return False, costs.OPEN
        least: tuple[bool, float | None] = False, None
        for role in self._roles:
            size = frame_size(head, role)
            if size is None or rest < size <= MAX_RTU_ADU:
                expected, cost = self._expected(head, size or 0, role, turn)
                if role is Direction.REQUEST and is_counted(head[1:]):
                    cost = costs.FORESEEN
            elif size == 0 or head[1:4] == _QUERY_DATA[: rest - 1]:
                expected = self._turns.expects(turn, head[0], head[1], 0, role)
                cost = costs.UNKNOWN_BETWEEN_SILENCES
                if role is Direction.REQUEST and head[1] & EXCEPTION_BIT:
                    cost += costs.ODD_REQUEST
            else:
                continue
            if expected:
                cost += costs.OPEN + rest * costs.OPEN_MORE_DUE
            else:
                cost += costs.OPEN + costs.OPEN_UNEXPECTED + rest * costs.OPEN_MORE
            if least[1] is None or cost < least[1]:
                least = expected, cost
        return least
