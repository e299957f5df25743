"""Explains the bytes heard on an RTU line as a whole: frames, damage, noise, and what is open."""

# A CRC alone finds no frames: every valid frame that ends in 00 is valid one byte shorter, and any
# valid frame before a 00 is valid one byte longer. So each place of a window is asked what may
# begin there: frames of the length that their function has as a request or a response and whose CRC
# is right; frames of no known form that the CRC and the silences bound; damaged frames; a frame
# whose end is still to come; a byte that belongs to none. The cheapest row of such pieces from the
# first byte to the last is taken, where a piece costs what speaks against it (weights.py) under the
# turn that the pieces before it lead to (turns.py).
#
# At each place the BEAM cheapest rows are kept, and none that is weights.MARGIN bits above one that
# has come further; so the search goes from frame to frame where all is well, and looks at every
# byte only where it is not. Its work is bounded by the window: at most BEAM rows a place, a dozen
# pieces for each, and 256 bytes to look through for each piece. The worst found, random bytes with
# a silence after each, is 17,000 bytes/s on a slow core; a line at 115200 baud brings 11,520.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.modbus import weights
from mbtool.modbus.adu import MAX_RTU_ADU
from mbtool.modbus.framing import RTU_EXTRA_BYTES, crc
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.modbus.oddities import is_counted
from mbtool.modbus.pdu import parse_pdu
from mbtool.modbus.rows import Kind, Piece, Row, agreed_on, merged, with_doubts
from mbtool.modbus.rtu_structure import MIN_FRAME, crc_ends, frame_size
from mbtool.modbus.turn import DOUBT, Turn
from mbtool.modbus.turns import ROLES, Turns

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.modbus.habits import Habits


BEAM = 4
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
class Window:
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

    def start_ns(self, place: int) -> int:
        return self.times[place] - self.character_ns


class _Frame(msgspec.Struct, gc=False):
    size: int
    role: Direction
    roles: tuple[Direction, ...]
    cost: float
    is_unbound: bool = False
    """Whether its CRC alone tells where it ends."""


class Tiling:
    """The search over one window."""

    def __init__(
        self, window: Window, turns: Turns, habits: Habits, roles: tuple[Direction, ...] = ROLES
    ) -> None:
        self._window = window
        self._data = window.data
        self._end = len(window.data)
        self._turns = turns
        self._habits = habits
        self._roles = roles
        self._is_known = len(roles) == 1
        """Whether it is known who speaks, so that no turn matters."""
        self._rows: list[list[Row]] = [[] for _ in range(self._end + 1)]
        self._lowest = [float("inf")] * (self._end + 1)
        self._open_row: Row | None = None
        """The cheapest that ends in a frame which is still to be completed."""
        self._open_limit = float("inf")
        """What such a row has to be cheaper than."""
        self._reach = float("inf")
        """What a row may cost at most beside one that has come further."""
        self._found: dict[int, list[_Frame]] = {}
        self._torn = [0] * (self._end + 2)
        for place in range(1, self._end + 1):
            self._torn[place + 1] = self._torn[place] + window.silences[place]

    def pieces(self) -> list[Piece]:
        """The cheapest explanation, in order, without a hole."""
        skipped = int(self._window.is_behind_noise)
        first = Row(0.0, self._turns.turn, None, None, skipped, is_anchored=not skipped)
        self._rows[0] = [first]
        for bits, turn in self._turns.likely[1:]:
            self._rows[0].append(Row(bits, turn, first, None, skipped, is_anchored=not skipped))
        for place in range(self._end):
            rows = self._rows[place]
            if rows:
                ahead = min(self._lowest[place + 1 : place + MAX_RTU_ADU + 1])
                self._reach = ahead + weights.MARGIN
                self._reach = min(self._reach, self._open_limit + weights.OPEN_MARGIN)
                rows = [row for row in rows if row.cost <= self._reach]
                if rows:
                    self._go_on(place, rows)
                self._rows[place] = []
        ends = self._rows[self._end]
        for row in ends:
            row.cost += self._turns.pause_cost(row.turn, is_last=True)
        ends.sort(key=lambda row: row.cost)
        opened = self._open_row
        if opened is not None and (not ends or opened.cost <= ends[0].cost):
            return list(merged(agreed_on(ends, opened, self._end)))
        return list(merged(with_doubts(ends)))

    def _add(self, place: int, row: Row) -> None:
        """Keep a row, if none that leads to the same turn is cheaper."""
        if row.cost > self._reach:
            return
        rows = self._rows[place]
        for index, other in enumerate(rows):
            if bool(other.skipped) == bool(row.skipped) and other.turn == row.turn:
                better, worse = (row, other) if row.cost < other.cost else (other, row)
                if worse.cost - better.cost < DOUBT:
                    better.rivals = (*better.rivals, worse)
                rows[index] = better
                break
        else:
            rows.append(row)
            if len(rows) > BEAM:
                rows.remove(max(rows, key=lambda one: one.cost))
        if row.cost < self._lowest[place]:
            self._lowest[place] = row.cost
            self._reach = min(self._reach, row.cost + weights.MARGIN)

    def _go_on(self, place: int, rows: list[Row]) -> None:
        """Lay every piece that may begin at a place."""
        frames = self._frames(place)
        silent = self._window.silences[place]
        anchored = [row for row in rows if silent or self._is_anchored(row, place)]
        unknown = list(self._unknown(place)) if anchored and not frames else []
        starts = 0.0 if silent else self._habits.glue.bits
        for row in rows:
            turn = row.turn
            if row.skipped >= LONG_SKIP and not turn.lost and not self._is_known:
                turn = turn.behind_damage()
            for frame in frames:
                self._lay_frame(place, row, turn, frame, starts)
            if row in anchored:
                for frame in unknown:
                    self._lay_frame(place, row, turn, frame, starts)
            if silent or not row.skipped:
                self._lay_damaged(place, row, turn, starts, is_frame=bool(frames))
            self._lay_open(place, row, turn, starts, is_unknown=bool(unknown))
            self._lay_skip(place, row, bool(frames), bool(unknown))

    def _is_anchored(self, row: Row, place: int) -> bool:
        """Whether a frame is likely to begin at a place: behind another, or as it is due."""
        if row.is_anchored or (row.is_noise and row.skipped < LONG_SKIP):
            return True
        return self._is_due(row, place)

    def _is_due(self, row: Row, place: int) -> bool:
        """Whether a row leads to a request whose response may begin at a place."""
        waiting = row.turn.waiting
        return (
            waiting is not None
            and place + MIN_FRAME <= self._end
            and waiting.is_named_by(self._data[place], self._data[place + 1])
        )

    def _lay_frame(self, place: int, row: Row, turn: Turn, frame: _Frame, starts: float) -> None:
        raw = self._data[place : place + frame.size]
        unit, pdu = raw[0], raw[1:-2]
        start_ns = self._window.start_ns(place)
        cost = frame.cost + starts + self._tears(place, frame.size)
        if frame.is_unbound and (self._is_due(row, place) or turn.is_of_turn(unit, pdu[0])):
            cost += weights.UNKNOWN_DUE - weights.UNKNOWN
        follows = turn
        if not self._is_known:
            end_ns = self._window.times[place + frame.size - 1]
            cost += self._turns.weigh(turn, unit, pdu, frame.role, start_ns)
            inside_ns = self._longest_ns(place, frame.size)
            if self._turns.ends_pause(turn, frame.role, start_ns, inside_ns):
                cost += self._turns.pause_cost(turn)
            follows = self._turns.follow(turn, unit, pdu, frame.role, start_ns, end_ns, inside_ns)
        piece = Piece(Kind.FRAME, place, frame.size, frame.role, frame.roles)
        total = row.cost + cost
        self._add(
            place + frame.size, Row(total, follows, row, piece, runs=row.runs, is_anchored=True)
        )

    def _lay_open(
        self, place: int, row: Row, turn: Turn, starts: float, *, is_unknown: bool
    ) -> None:
        least = row.cost + starts + weights.OPEN + weights.FORESEEN + weights.WAIT
        if least >= self._open_limit:
            return
        expected, cost = self._open(place, turn)
        if cost is None:
            return
        size = self._end - place
        is_foreseen = cost < 0.0
        cost += row.cost + starts
        if self._frames(place) or is_unknown:
            cost += weights.OPEN_OVER_FRAME_DUE if expected else weights.OPEN_OVER_FRAME
        is_zero = size == 1 and self._data[place] == 0  # Noise, or the end of what was laid before.
        is_likely = row.is_anchored or self._window.silences[place] or is_foreseen
        if is_likely and not is_zero:
            cost += weights.WAIT
            if cost >= self._open_limit:
                return
            cost += self._inside(place, size, known=expected)
        else:
            cost += self._tears(place, size) + size * weights.SKIP_MORE
        opened = Row(cost, turn, row, Piece(Kind.OPEN, place, size))
        if not self._window.silences[self._end]:  # A full window is decided but for its end.
            self._add(self._end, opened)
        elif cost < self._open_limit:
            self._keep_open(opened)

    def _keep_open(self, row: Row) -> None:
        """Keep the cheapest open row; another from its place that is nearly as cheap is a rival."""
        best = self._open_row
        if best is not None and best.piece == row.piece:
            best, row = (row, best) if row.cost < best.cost else (best, row)
            best.rivals = (*best.rivals, row)
        elif best is None or row.cost < best.cost:
            best = row
        self._open_row, self._open_limit = best, best.cost + weights.OPEN_DOUBT

    def _lay_damaged(
        self, place: int, row: Row, turn: Turn, starts: float, *, is_frame: bool
    ) -> None:
        for size, cost in self._usual(place) if is_frame else self._damaged(place, turn):
            piece = Piece(Kind.DAMAGED, place, size)
            lost = turn if self._is_known else turn.behind_damage()
            total = row.cost + starts + cost
            self._add(place + size, Row(total, lost, row, piece, runs=row.runs))

    def _lay_skip(self, place: int, row: Row, is_frame: bool, is_unknown: bool) -> None:
        is_noise = self._data[place] in NOISE and (row.is_anchored or row.is_noise)
        goes_on = row.skipped and is_noise is row.is_noise
        if goes_on:
            cost = weights.SKIP_MORE
        elif is_noise:
            often = self._habits.noise.bits
            cost = min(often, max(often - row.runs, weights.NOISE_AT_ONCE))
        else:  # Noise, and what is no noise behind it, are two troubles.
            cost = max(self._habits.skip.bits - row.runs, weights.SKIP_LIMITS[0])
        if is_frame:
            cost += weights.COINCIDENCE
        elif is_unknown:
            cost += weights.UNKNOWN_COINCIDENCE
        piece = Piece(Kind.SKIPPED, place, 1)
        runs = row.runs + (not goes_on)
        skipped = row.skipped + 1
        self._add(place + 1, Row(row.cost + cost, row.turn, row, piece, skipped, is_noise, runs))

    def _tears(self, place: int, size: int) -> float:
        torn = self._torn[place + size] - self._torn[place + 1]
        return self._habits.tear.bits + (torn - 1) * weights.TORN_MORE if torn else 0.0

    def _longest_ns(self, place: int, size: int) -> int:
        """The longest silence inside a piece, if there is one of t3.5."""
        if self._torn[place + size] == self._torn[place + 1]:
            return 0
        times = self._window.times[place : place + size]
        return max(map(int.__sub__, times[1:], times)) - self._window.character_ns

    def _inside(self, place: int, size: int, *, known: bool) -> float:
        """What it costs that silences stand inside a piece, and that frames begin there."""
        return self._tears(place, size) + self._swallowed(place, size, known=known)

    def _swallowed(self, place: int, size: int, *, known: bool) -> float:
        """What it costs that frames begin inside a piece.

        Registers may hold what looks like a frame, but not behind a silence, and hardly twice
        where the piece is not `known` by more than its length.
        """
        silences = self._window.silences
        inner = range(place + 1, place + size - MIN_FRAME + 1)
        begins = sum(silences[at] and bool(self._frames(at)) for at in inner)
        if not known:
            begins = max(begins, sum(bool(self._frames(at)) for at in inner) - 1)
        return weights.COINCIDENCE * begins

    def _frames(self, place: int) -> list[_Frame]:
        """Frames of known form with a correct CRC."""
        frames = self._found.get(place)
        if frames is None:
            frames = self._found[place] = self._find_frames(place)
        return frames

    def _find_frames(self, place: int) -> list[_Frame]:
        frames: list[_Frame] = []
        head = self._data[place : place + MAX_RTU_ADU]
        have = len(head)
        if have < MIN_FRAME:
            return frames
        sizes = [(role, frame_size(head, role)) for role in self._roles]
        for role, size in sizes:
            if size and size <= have and crc(head[:size]) == 0:
                malformed = parse_pdu(head[1 : size - 2], role).problem is not None
                roles = tuple(other for other, same in sizes if same == size)
                frames.append(_Frame(size, role, roles, weights.MALFORMED if malformed else 0.0))
        return frames

    def _unknown(self, place: int) -> Iterator[_Frame]:
        """Frames that no known form bounds, but the silences or the CRC."""
        head = self._data[place : place + MAX_RTU_ADU]
        if len(head) < MIN_FRAME:
            return
        burst = self._burst(place) if self._window.silences[place] else 0
        if burst >= MIN_FRAME and crc(head[:burst]) == 0:
            for role in self._roles:
                usual = frame_size(head, role)
                is_longer = head[1:4] == _QUERY_DATA and burst > (usual or burst)
                odd = weights.MALFORMED if usual and not is_longer else 0.0
                cost = weights.UNKNOWN_BETWEEN_SILENCES + odd
                if head[burst - 1] == 0:
                    cost += self._ends_in_zero(place, burst)
                yield _Frame(burst, role, self._roles, cost)
        unsized = [role for role in self._roles if head[1] and frame_size(head, role) == 0]
        if head[1:4] == _QUERY_DATA:
            unsized = list(self._roles)
        if not unsized:
            return
        for size in crc_ends(head, MOST_UNKNOWN_ENDS):
            if size == burst:
                continue
            cost = self._swallowed(place, size, known=False)
            if not cost and any(map(self._frames, range(place + 1, place + size - MIN_FRAME + 1))):
                cost = weights.UNKNOWN_COINCIDENCE
            is_burst = size < burst and not any(head[size:burst])  # But for the 00 behind it.
            cost += weights.UNKNOWN_BETWEEN_SILENCES if is_burst else weights.UNKNOWN
            is_unbound = not is_burst
            if head[size - 1] == 0:
                cost += self._ends_in_zero(place, size)
            for role in unsized:
                yield _Frame(size, role, self._roles, cost, is_unbound)

    def _ends_in_zero(self, place: int, size: int) -> float:
        """What it costs that a frame which no known form bounds ends in 00."""
        raw = self._data[place : place + size]
        zeros = size - max(len(raw.rstrip(b"\x00")), MIN_FRAME)
        if not zeros:
            return 0.0
        more = (zeros - 1) * weights.ENDS_IN_ZERO_MORE
        is_last = self._window.silences[place + size]
        return weights.ENDS_IN_ZERO + more - (weights.ADHERES if is_last else 0.0)

    def _burst(self, place: int) -> int:
        """How many bytes there are up to the next silence; 0 where none stands near."""
        for size in range(1, min(MAX_RTU_ADU, self._end - place) + 1):
            if self._window.silences[place + size]:
                return size
        return 0

    def _damaged(self, place: int, turn: Turn) -> Iterator[tuple[int, float]]:
        """Sizes of frames that may have been damaged, with what that costs."""
        head = self._data[place : place + MAX_RTU_ADU]
        if len(head) < MIN_FRAME:
            return
        for role in self._roles:
            size = frame_size(head, role)
            if not size or size > MAX_RTU_ADU:
                continue
            expected, cost = self._expected(head, size, role, turn)
            if not expected:
                cost += weights.UNEXPECTED
            cost += size * weights.SKIP_MORE
            if size <= len(head) and crc(head[:size]) != 0:
                yield size, weights.DAMAGED + cost + self._inside(place, size, known=expected)
            if expected:
                for lost in LOST_BYTES:
                    if MIN_FRAME <= size - lost <= len(head):
                        more = weights.DAMAGED_SIZE + self._inside(place, size - lost, known=True)
                        yield size - lost, weights.DAMAGED + cost + more
        burst = self._burst(place) if self._window.silences[place] else 0
        if (
            burst > 2 * MIN_FRAME
            and self._habits.glue.bits > weights.NEVER
            and not self._is_frame_in_noise(place, burst)
        ):
            # Damaged where it begins. What it holds is no frame either, as none is glued here.
            cost = self._habits.skip.bits + weights.DAMAGED_SIZE + weights.UNEXPECTED
            yield burst, cost + min(burst * weights.SKIP_MORE, weights.MOST_FOR_LENGTH)

    def _usual(self, place: int) -> Iterator[tuple[int, float]]:
        """The size of a request heard before that was damaged in what a shorter frame has not.

        One whose CRC ends in 00 may be a whole response without it.
        """
        head = self._data[place : place + MAX_RTU_ADU]
        size = frame_size(head, Direction.REQUEST) if Direction.REQUEST in self._roles else 0
        if not size or not self._turns.was_asked(head[0], head[1 : size - 2]):
            return
        cost = weights.DAMAGED + weights.FORESEEN + size * weights.SKIP_MORE
        if size <= len(head) and crc(head[:size]) != 0:
            yield size, cost + self._tears(place, size)
        elif crc(head[: size - 1]) == 0:
            yield size - 1, cost + weights.DAMAGED_SIZE + self._tears(place, size - 1)

    def _is_frame_in_noise(self, place: int, size: int) -> bool:
        """Whether a burst is a frame with stray bytes at its ends, a few of them."""
        burst = self._data[place : place + size]
        befores = [at for at in range(LONG_SKIP) if NOISE.issuperset(burst[:at])]
        behinds = [at for at in range(LONG_SKIP) if NOISE.issuperset(burst[size - at :])]
        return any(
            crc(burst[before : size - behind]) == 0 for before in befores for behind in behinds
        )

    def _expected(self, head: bytes, size: int, role: Direction, turn: Turn) -> tuple[bool, float]:
        """Whether a frame that begins so is due, and what speaks for it beside that."""
        pdu_size = size - RTU_EXTRA_BYTES if size else 0
        unit, pdu = head[0], head[1 : 1 + pdu_size]
        if role is Direction.REQUEST:
            if pdu and len(pdu) == pdu_size and self._turns.was_asked(unit, pdu):
                return True, weights.FORESEEN
            if is_counted(head[1:]):
                return True, 0.0
        elif self._turns.foresees(turn, unit, head[1], pdu_size):
            return True, weights.FORESEEN
        return self._turns.expects(turn, unit, head[1], pdu_size, role), 0.0

    def _open(self, place: int, turn: Turn) -> tuple[bool, float | None]:
        """Whether the rest can be a frame that is due and has only begun, and what that costs."""
        rest = self._end - place
        if not self._window.may_go_on or rest >= MAX_RTU_ADU:
            return False, None
        head = self._data[place:]
        if rest < 2:
            return False, weights.OPEN
        least: tuple[bool, float | None] = False, None
        for role in self._roles:
            size = frame_size(head, role)
            if size is None or rest < size <= MAX_RTU_ADU:
                expected, cost = self._expected(head, size or 0, role, turn)
                if role is Direction.REQUEST and is_counted(head[1:]):
                    cost = weights.FORESEEN
            elif size == 0 or head[1:4] == _QUERY_DATA[: rest - 1]:
                expected = self._turns.expects(turn, head[0], head[1], 0, role)
                cost = weights.UNKNOWN_BETWEEN_SILENCES
                if role is Direction.REQUEST and head[1] & EXCEPTION_BIT:
                    cost += weights.ODD_REQUEST
            else:
                continue
            if expected:
                cost += weights.OPEN + rest * weights.OPEN_MORE_DUE
            else:
                cost += weights.OPEN + weights.OPEN_UNEXPECTED + rest * weights.OPEN_MORE
            if least[1] is None or cost < least[1]:
                least = expected, cost
        return least
