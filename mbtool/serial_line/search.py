"""Explains the bytes heard on an RTU line as a whole: frames, damage, noise, and what is open."""

# A CRC alone finds no frames: every valid frame that ends in 00 is valid one byte shorter, and any
# valid frame before a 00 is valid one byte longer. So each place of a window is asked what may
# begin there (candidates.py); a byte may also belong to no frame. The cheapest row of such pieces
# from the first byte to the last is taken, where a piece costs what speaks against it (costs.py)
# under the turn that the pieces before it lead to (turns.py).
#
# At each place the BEAM cheapest rows are kept, and none that is costs.MARGIN bits above one that
# has come further; so the search goes from frame to frame where all is well, and looks at every
# byte only where it is not. Its work is bounded by the window: at most BEAM rows a place, some
# twenty pieces for each, and 256 bytes to look through for each piece. The worst found, random
# bytes with a silence after each, is 5,500 bytes/s on a slow core; with 1.75 ms behind each a line
# brings 540 at most. In bursts of 32 it is 8,000, and a line at 115200 baud brings 6,700.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.framing.rtu_lengths import MIN_FRAME
from mbtool.modbus.adu import MAX_RTU_ADU
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import ROLES, BusModel
from mbtool.serial_line.bus_state import DOUBT, BusState
from mbtool.serial_line.candidates import LONG_SKIP, NOISE, ByteWindow, Candidates, Frame
from mbtool.serial_line.paths import (
    Path,
    Segment,
    SegmentKind,
    agreed_on,
    doubted,
    merged,
    with_doubts,
)

if TYPE_CHECKING:
    from mbtool.core import Direction
    from mbtool.serial_line.line_statistics import LineStatistics

BEAM = 4
LEAST_HEAD = 3
"""Bytes of a frame before its registers."""
MOST_HELD = 2
"""Frames that registers hold, one behind the other: a request and its response."""


class PathSearch:
    """The search over one window."""

    def __init__(
        self,
        window: ByteWindow,
        turns: BusModel,
        habits: LineStatistics,
        roles: tuple[Direction, ...] = ROLES,
    ) -> None:
        self._window = window
        self._data = window.data
        self._end = len(window.data)
        self._turns = turns
        self._habits = habits
        self._roles = roles
        self._is_known = len(roles) == 1
        """Whether it is known who speaks, so that no turn matters."""
        self._rows: list[list[Path]] = [[] for _ in range(self._end + 1)]
        self._lowest = [float("inf")] * (self._end + 1)
        self._open_row: Path | None = None
        """The cheapest that ends in a frame which is still to be completed."""
        self._open_limit = float("inf")
        """What such a row has to be cheaper than."""
        self._reach = float("inf")
        """What a row may cost at most beside one that has come further."""
        self._candidates = Candidates(window, turns, habits, roles)

    def pieces(self) -> list[Segment]:
        """The cheapest explanation, in order, without a hole."""
        skipped = int(self._window.is_behind_noise)
        first = Path(0.0, self._turns.turn, None, None, skipped, is_anchored=not skipped)
        self._rows[0] = [first]
        for bits, turn in self._turns.likely[1:]:
            self._rows[0].append(Path(bits, turn, first, None, skipped, is_anchored=not skipped))
        for place in range(self._end):
            rows = self._rows[place]
            if rows:
                ahead = min(self._lowest[place + 1 : place + MAX_RTU_ADU + 1])
                self._reach = ahead + costs.MARGIN
                self._reach = min(self._reach, self._open_limit + costs.OPEN_MARGIN)
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
            if self._window.is_pressing:
                pieces = list(with_doubts([opened, *ends]))
            else:
                pieces = agreed_on(ends, opened, self._end)
        else:
            pieces = list(with_doubts(ends))
        return self._with_enclosed(list(merged(pieces)))

    def _with_enclosed(self, pieces: list[Segment]) -> list[Segment]:
        """Frames right between bytes that belong to none may be registers of a damaged frame."""
        head, inner = -1, 0
        for index, piece in enumerate(pieces):
            if piece.kind is SegmentKind.FRAME:
                inner += 1
                continue
            is_short = piece.place + piece.size - pieces[head].place <= MAX_RTU_ADU
            if head >= 0 and 0 < inner <= MOST_HELD and is_short and self._may_hold(piece, 0):
                pieces[head + 1 : index] = map(doubted, pieces[head + 1 : index])
            head, inner = (index if self._may_hold(piece, piece.size) else -1), 0
        return pieces

    def _may_hold(self, piece: Segment, side: int) -> bool:
        """Whether skipped bytes may be of one frame with what stands at a side of them."""
        raw = self._data[piece.place : piece.place + piece.size]
        is_noise = len(raw) < LEAST_HEAD or NOISE.issuperset(raw)
        is_beside = not self._window.silences[piece.place + side]
        return piece.kind is SegmentKind.SKIPPED and not is_noise and is_beside

    def _add(self, place: int, row: Path) -> None:
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
            self._reach = min(self._reach, row.cost + costs.MARGIN)

    def _go_on(self, place: int, rows: list[Path]) -> None:
        """Lay every piece that may begin at a place."""
        frames = self._candidates.frames(place)
        silent = self._window.silences[place]
        anchored = [row for row in rows if silent or self._is_anchored(row, place)]
        unknown = list(self._candidates.unknown(place)) if anchored and not frames else []
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

    def _is_anchored(self, row: Path, place: int) -> bool:
        """Whether a frame is likely to begin at a place: behind another, or as it is due."""
        if row.is_anchored or (row.is_noise and row.skipped < LONG_SKIP):
            return True
        head = self._data[place : place + 2]
        return self._is_due(row, place) or self._turns.has_asked(head)

    def _is_due(self, row: Path, place: int) -> bool:
        """Whether a row leads to a request whose response may begin at a place."""
        waiting = row.turn.waiting
        return (
            waiting is not None
            and place + MIN_FRAME <= self._end
            and waiting.is_named_by(self._data[place], self._data[place + 1])
        )

    def _lay_frame(
        self, place: int, row: Path, turn: BusState, frame: Frame, starts: float
    ) -> None:
        raw = self._data[place : place + frame.size]
        unit, pdu = raw[0], raw[1:-2]
        start_ns, end_ns = self._bounds_ns(place, frame.size)
        cost = frame.cost + starts + self._candidates.tears(place, frame.size)
        if frame.is_unbound and (self._is_due(row, place) or turn.is_of_turn(unit, pdu[0])):
            cost += costs.UNKNOWN_DUE - costs.UNKNOWN
        follows = turn
        if not self._is_known:
            cost += self._turns.weigh(turn, unit, pdu, frame.role, start_ns)
            inside_ns = self._candidates.longest_ns(place, frame.size)
            if turn.ends_pause(frame.role, start_ns, inside_ns):
                cost += self._turns.pause_cost(turn)
            follows = self._turns.follow(turn, unit, pdu, frame.role, start_ns, end_ns, inside_ns)
        piece = Segment(SegmentKind.FRAME, place, frame.size, frame.role, frame.roles)
        total = row.cost + cost
        self._add(
            place + frame.size, Path(total, follows, row, piece, runs=row.runs, is_anchored=True)
        )

    def _bounds_ns(self, place: int, size: int) -> tuple[int, int]:
        """When a piece began and ended."""
        return self._window.start_ns(place), self._window.times[place + size - 1]

    def _lay_open(
        self, place: int, row: Path, turn: BusState, starts: float, *, is_unknown: bool
    ) -> None:
        least = row.cost + starts + costs.OPEN + costs.FORESEEN + costs.WAIT
        if least >= self._open_limit:
            return
        expected, cost = self._candidates.begun(place, turn)
        if cost is None:
            return
        size = self._end - place
        is_foreseen = cost < 0.0
        cost += row.cost + starts
        if self._candidates.frames(place) or is_unknown:
            cost += costs.OPEN_OVER_FRAME_DUE if expected else costs.OPEN_OVER_FRAME
        is_zero = size == 1 and self._data[place] == 0  # Noise, or the end of what was laid before.
        is_likely = row.is_anchored or self._window.silences[place] or is_foreseen
        if is_likely and not is_zero:
            cost += costs.WAIT
            if cost >= self._open_limit:
                return
            cost += self._candidates.inside(place, size, known=expected)
        else:
            cost += self._candidates.tears(place, size) + size * costs.SKIP_MORE
        opened = Path(cost, turn, row, Segment(SegmentKind.OPEN, place, size))
        if not self._window.silences[self._end]:  # A full window is decided but for its end.
            self._add(self._end, opened)
        elif cost < self._open_limit:
            self._keep_open(opened)

    def _keep_open(self, row: Path) -> None:
        """Keep the cheapest open row; another from its place that is nearly as cheap is a rival."""
        best = self._open_row
        if best is not None and best.piece == row.piece:
            best, row = (row, best) if row.cost < best.cost else (best, row)
            best.rivals = (*best.rivals, row)
        elif best is None or row.cost < best.cost:
            best = row
        self._open_row, self._open_limit = best, best.cost + costs.OPEN_DOUBT

    def _lay_damaged(
        self, place: int, row: Path, turn: BusState, starts: float, *, is_frame: bool
    ) -> None:
        candidates = self._candidates
        for one in candidates.usual(place) if is_frame else candidates.damaged(place, turn):
            size = one.size
            piece = Segment(SegmentKind.DAMAGED, place, size, one.role, mended=one.mended)
            cost = row.cost + starts + one.cost
            if self._is_known:
                self._add(place + size, Path(cost, turn, row, piece, runs=row.runs))
                continue
            if one.mended:
                unit, pdu = one.mended[0], one.mended[1:-2]
                start_ns, end_ns = self._bounds_ns(place, size)
                cost += self._turns.weigh(turn, unit, pdu, one.role, start_ns)
                follows = self._turns.follow(turn, unit, pdu, one.role, start_ns, end_ns)
                self._add(place + size, Path(cost, follows, row, piece, runs=row.runs))
                cost += costs.UNHEARD
            lost = turn.behind_damage()
            self._add(place + size, Path(cost, lost, row, piece, runs=row.runs))

    def _lay_skip(self, place: int, row: Path, is_frame: bool, is_unknown: bool) -> None:
        is_noise = self._data[place] in NOISE and (row.is_anchored or row.is_noise)
        goes_on = row.skipped and is_noise is row.is_noise
        if goes_on:
            cost = costs.SKIP_MORE
        elif is_noise:
            often = self._habits.noise.bits
            cost = min(often, max(often - row.runs, costs.NOISE_AT_ONCE))
        else:  # Noise, and what is no noise behind it, are two troubles.
            cost = max(self._habits.skip.bits - row.runs, costs.SKIP_LIMITS[0])
        if is_frame:
            cost += costs.COINCIDENCE
        elif is_unknown:
            cost += costs.UNKNOWN_COINCIDENCE
        piece = Segment(SegmentKind.SKIPPED, place, 1)
        runs = row.runs + (not goes_on)
        skipped = row.skipped + 1
        self._add(place + 1, Path(row.cost + cost, row.turn, row, piece, skipped, is_noise, runs))
