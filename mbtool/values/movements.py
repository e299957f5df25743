"""Follows how all values in the answers to one poll change over time."""

# `Movements` takes the answers in any portions, with the same result: it keeps sums, extremes and
# some largest figures. A number that stands for "no value" is counted, and replaced by the number
# before it. The first step after a pause of the polling is not counted.
#
# Memory: about 60 numbers for each value.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from mbtool.devices.point_types import PointType

if TYPE_CHECKING:
    from mbtool.values.followed_values import FollowedValue
    from mbtool.values.word_readings import WordReading

Floats = npt.NDArray[np.float64]
Int64s = npt.NDArray[np.int64]
K = TypeVar("K", int, tuple[int, str])

STEPS = 8
"""The number of largest steps that are kept of each value."""
FALLS = 3
"""The number of first falls that are kept of each value."""
PAUSE_TIMES = 10
"""The polling paused if the time since the answer before is more than this many times the usual
one; a change across a pause is no step."""
_ROUNDING = 1e-6
"""A value is outside of the range in its profile only if it exceeds a limit by more than this share
(0 to 1) of the limit."""
_NO_VALUES = {
    PointType.UINT16: (0xFFFF, 0x8000, 0x7FFF),
    PointType.HEX16: (0xFFFF, 0x8000, 0x7FFF),
    PointType.INT16: (-1, -0x8000, 0x7FFF),
    PointType.UINT32: (0xFFFFFFFF, 0x80000000, 0x7FFFFFFF),
    PointType.INT32: (-1, -0x80000000, 0x7FFFFFFF),
}
"""Numbers that devices often give where they have no value, by type; NaN is one of a float."""


class Move(NamedTuple):
    """A change from one answer to the next."""

    size: float
    row: int
    at_ns: int
    before: float
    after: float


class Rest(NamedTuple):
    """The longest time for which a value did not change."""

    rows: int
    begin_ns: int
    end_ns: int | None
    """The time at which the value changed again; None if it has not changed until now."""
    others: int
    """The number of changes of other values during this rest."""
    value: float


class Occurrence(NamedTuple):
    """The number of answers with a certain number, the time of the first one (UTC ns), and the
    number in it.
    """

    answers: int
    at_ns: int
    number: float


@dataclass(slots=True)
class _Falls:
    steps: list[Move] = field(default_factory=list)
    rises: list[int] = field(default_factory=list)
    """How often the value had risen before each of them."""


class Movements:
    """Figures about how each of some values moves."""

    def __init__(self, values: Sequence[FollowedValue], usual_ns: float, rested: int = 0) -> None:
        """`usual_ns` is the usual time from one answer to the next; `rested` the number of answers
        before the first one that is added, in which no value changed.
        """
        self.values = values
        size = len(values)
        self.rows = 0
        self.moves = 0
        """The number of changes of all values."""
        self.changes = np.zeros(size, np.int64)
        self.rises = np.zeros(size, np.int64)
        self.risen = np.zeros(size)
        """The sum of all rises."""
        self.low, self.high = np.full(size, np.inf), np.full(size, -np.inf)
        self.least_step = np.full(size, np.inf)
        self.last_fall = np.full(size, -1, np.int64)
        """The row of the last fall."""
        self._largest = np.zeros((4, STEPS, size))
        """Size, number before, number after and row of the largest steps."""
        self._largest_ns = np.zeros((STEPS, size), np.int64)
        self._falls: dict[int, _Falls] = {}
        self._last = np.full(size, np.nan)
        self.first_ns = 0
        """The time of the first answer."""
        self._last_ns: int | None = None
        self._usual_ns = usual_ns
        self._run_row = np.full(size, -rested, np.int64)
        self._run_ns = np.zeros(size, np.int64)
        self._run_moves = np.zeros(size, np.int64)
        self._rest = np.zeros((5, size), np.int64)
        """Rows, begin, end, changes of other values, and second most rows of the longest rest."""
        self._rest_value = np.zeros(size)
        self._unset: dict[int, Occurrence] = {}
        self._outside: dict[int, Occurrence] = {}
        self._not_valid: dict[tuple[int, str], Occurrence] = {}
        self._no_values = np.array(
            [
                [
                    np.nan if one.is_state or number == one.no_value else number
                    for number in _NO_VALUES.get(one.reading.type, (np.nan,) * 3)
                ]
                for one in values
            ]
        ).reshape(size, 3)
        self._known_no_values = np.array(
            [np.nan if one.no_value is None else one.no_value for one in values], np.float64
        )
        self._is_judged_by_itself = np.array(
            [
                one.minimum is not None or one.maximum is not None or bool(one.not_valid)
                for one in values
            ],
            np.bool_,
        )
        """True for values that are judged in each answer, also if they stay as they were."""
        self._is_float = np.array([one.reading.type.is_float for one in values], np.bool_)

    @np.errstate(all="ignore")  # A device may send any number, so sums may overflow.
    def add(self, times_ns: Sequence[int], words: bytes) -> None:
        """Take answers: their times, and their registers one after the other (native order)."""
        times = np.array(times_ns, np.int64)
        rows = np.frombuffer(words, np.uint16).reshape(len(times), -1)
        numbers, moves = self._numbers(rows)
        self.first_ns = self.first_ns or int(times[0])
        before = times[0] if self._last_ns is None else self._last_ns
        gaps = np.diff(times, prepend=before)
        self._last_ns = int(times[-1])
        cuts = np.flatnonzero((gaps > PAUSE_TIMES * self._usual_ns) | (gaps < 0))
        begin = 0
        for cut in [*cuts.tolist(), len(times)]:
            if cut > begin:
                is_moving = moves | self._is_judged_by_itself | (numbers[begin] != self._last)
                places = np.flatnonzero(is_moving)
                self._take(times[begin:cut], numbers[begin:cut, places], places)
            if cut < len(times):
                self._pause(int(times[cut]))
            begin = cut

    def _numbers(self, rows: npt.NDArray[np.uint16]) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Return the numbers of each row, and which of the values are not the same in all rows."""
        found = np.empty((len(rows), len(self.values)))
        word_moves = (rows != rows[0]).any(axis=0)
        moves = np.zeros(len(self.values), np.bool_)
        for place, one in enumerate(self.values):
            moves[place] = word_moves[one.at : one.at + one.reading.words].any()
            some = rows if moves[place] else rows[:1]
            columns = some[:, one.at : one.at + one.reading.words]
            found[:, place] = _numbers_of(columns, one.reading)
        return found, moves

    def _take(self, times: Int64s, numbers: Floats, places: Int64s) -> None:
        """Take answers; `numbers` has those at `places` only, as the others stayed as they were."""
        numbers = self._without_no_values(times, numbers, places)
        self._note_limits(times, numbers, places)
        before = np.vstack([self._last[places], numbers[:-1]])
        with np.errstate(invalid="ignore", over="ignore"):
            steps = numbers - before
            sizes = np.nan_to_num(np.abs(steps), nan=0.0, posinf=0.0)
        changed = sizes > 0
        rises = (steps > 0) & changed
        self.low[places] = np.fmin(self.low[places], np.fmin.reduce(numbers))
        self.high[places] = np.fmax(self.high[places], np.fmax.reduce(numbers))
        least = np.where(changed, sizes, np.inf).min(axis=0)
        self.least_step[places] = np.minimum(self.least_step[places], least)
        falls = changed & ~rises
        if falls.any():
            self._note_falls(times, before, numbers, falls, rises, places)
        self.changes[places] += changed.sum(axis=0)
        self.rises[places] += rises.sum(axis=0)
        self.risen[places] += np.where(rises, sizes, 0.0).sum(axis=0)
        self._note_steps(times, before, numbers, sizes, places)
        self._note_rests(times, before, changed, places)
        self.rows += len(times)
        self._last[places] = numbers[-1]

    def _without_no_values(self, times: Int64s, numbers: Floats, places: Int64s) -> Floats:
        is_unset = (numbers[:, :, None] == self._no_values[places]).any(axis=2)
        is_lacking = ~np.isfinite(numbers)
        is_unset |= is_lacking & self._is_float[places]
        is_lacking |= is_unset | (numbers == self._known_no_values[places])
        if not is_lacking.any():
            return numbers
        for at in np.flatnonzero(is_unset.any(axis=0)).tolist():
            _note_occurrences(self._unset, int(places[at]), times, numbers[:, at], is_unset[:, at])
        rows = np.where(is_lacking, -1, np.arange(len(times))[:, None])
        rows = np.maximum.accumulate(rows)
        filled: Floats = np.take_along_axis(numbers, np.maximum(rows, 0), axis=0)
        return np.where(rows < 0, self._last[places], filled)

    def _note_limits(self, times: Int64s, numbers: Floats, places: Int64s) -> None:
        for at, place in enumerate(places.tolist()):
            one, own = self.values[place], numbers[:, at]
            if one.minimum is not None or one.maximum is not None:
                scaled = own * one.scale + one.offset
                is_outside = np.zeros(len(times), np.bool_)
                if one.minimum is not None:
                    is_outside |= scaled < one.minimum - _ROUNDING * abs(one.minimum)
                if one.maximum is not None:
                    is_outside |= scaled > one.maximum + _ROUNDING * abs(one.maximum)
                _note_occurrences(self._outside, place, times, own, is_outside)
            for mask, bits, text in one.not_valid:
                has = (np.nan_to_num(own).astype(np.int64) & mask) == bits
                _note_occurrences(self._not_valid, (place, text), times, own, has)

    def _note_falls(
        self,
        times: Int64s,
        before: Floats,
        after: Floats,
        falls: npt.NDArray[np.bool_],
        rises: npt.NDArray[np.bool_],
        places: Int64s,
    ) -> None:
        for at in np.flatnonzero(falls.any(axis=0)).tolist():
            place = int(places[at])
            rows = np.flatnonzero(falls[:, at])
            self.last_fall[place] = self.rows + int(rows[-1])
            own = self._falls.setdefault(place, _Falls())
            for row in rows[: FALLS - len(own.steps)].tolist():
                old, new = float(before[row, at]), float(after[row, at])
                own.steps.append(Move(old - new, self.rows + row, int(times[row]), old, new))
                own.rises.append(int(self.rises[place] + rises[:row, at].sum()))

    def _note_steps(
        self, times: Int64s, before: Floats, after: Floats, sizes: Floats, places: Int64s
    ) -> None:
        some = np.flatnonzero(sizes.max(axis=0) > self._largest[0, -1, places])
        if not len(some):
            return
        places = places[some]
        sizes = sizes[:, some]
        most = min(STEPS, len(sizes))
        top = np.argpartition(-sizes, most - 1, axis=0)[:most]
        rows = np.broadcast_to(self.rows + np.arange(len(sizes))[:, None], sizes.shape)
        own = [
            np.take_along_axis(one, top, axis=0)
            for one in (sizes, before[:, some], after[:, some], rows)
        ]
        both = np.concatenate([self._largest[:, :, places], np.array(own)], axis=1)
        times_ns = np.concatenate([self._largest_ns[:, places], times[top]])
        order = np.argsort(-both[0], axis=0, kind="stable")[:STEPS]
        self._largest[:, :, places] = np.take_along_axis(both, order[None], axis=1)
        self._largest_ns[:, places] = np.take_along_axis(times_ns, order, axis=0)

    def _note_rests(
        self, times: Int64s, before: Floats, changed: npt.NDArray[np.bool_], places: Int64s
    ) -> None:
        moves = self.moves + np.concatenate([[0], np.cumsum(changed.sum(axis=1))])
        """The number of changes before each row, and at the end."""
        self.moves = int(moves[-1])
        if not self.rows:
            self._run_ns[:] = times[0]
        for column in np.flatnonzero(changed.any(axis=0)).tolist():
            place = int(places[column])
            rows = np.flatnonzero(changed[:, column])
            begins = np.concatenate([[self._run_row[place]], self.rows + rows[:-1]])
            lengths = self.rows + rows - begins
            at = int(np.argmax(lengths))
            others = lengths.copy()
            others[at] = 0
            begin_ns = int(times[rows[at - 1]]) if at else int(self._run_ns[place])
            begun = int(moves[rows[at - 1] + 1]) if at else int(self._run_moves[place])
            self._note_rest(
                place,
                (int(lengths[at]), begin_ns, int(times[rows[at]]), int(moves[rows[at]]) - begun),
                float(before[rows[at], column]),
                int(others.max()),
            )
            self._run_row[place] = self.rows + int(rows[-1])
            self._run_ns[place] = times[rows[-1]]
            self._run_moves[place] = moves[rows[-1] + 1]

    def _note_rest(
        self, place: int, rest: tuple[int, int, int, int], value: float, other: int
    ) -> None:
        own = self._rest[:, place]
        if rest[0] > own[0]:
            own[4] = max(own[0], other)
            own[:4] = rest
            self._rest_value[place] = value
        else:
            own[4] = max(own[4], rest[0])

    def _pause(self, until_ns: int) -> None:
        """End all rests, and forget the last values, because the polling paused."""
        for place in range(len(self.values)):
            length = self.rows - int(self._run_row[place])
            others = self.moves - int(self._run_moves[place])
            rest = (length, int(self._run_ns[place]), until_ns, others)
            self._note_rest(place, rest, float(self._last[place]), 0)
        self._run_row[:], self._run_ns[:], self._run_moves[:] = self.rows, until_ns, self.moves
        self._last = np.full(len(self.values), np.nan)

    def forget_profile_faults(self) -> None:
        """Forget the values that were outside of the profile's range, or not valid by it."""
        self._outside.clear()
        self._not_valid.clear()

    def steps(self, place: int) -> list[Move]:
        """Return the largest steps of a value, the largest first."""
        size, before, after, row = self._largest[:, :, place]
        times = self._largest_ns[:, place]
        return [
            Move(float(size[at]), int(row[at]), int(times[at]), float(before[at]), float(after[at]))
            for at in range(STEPS)
            if size[at] > 0
        ]

    def falls(self, place: int) -> list[tuple[Move, int]]:
        """Return the first falls of a value, each with how often it had risen before."""
        own = self._falls.get(place)
        return [] if own is None else list(zip(own.steps, own.rises, strict=True))

    def rests(self, place: int) -> tuple[Rest, int]:
        """Return the longest rest of a value, and how many answers the second longest one took."""
        rows, begin_ns, end_ns, others, second = self._rest[:, place].tolist()
        now = self.rows - int(self._run_row[place])
        if now > rows:
            moved = self.moves - int(self._run_moves[place])
            begun_ns = int(self._run_ns[place])
            return Rest(now, begun_ns, None, moved, float(self._last[place])), rows
        rest = Rest(rows, begin_ns, end_ns, others, float(self._rest_value[place]))
        return rest, max(second, now)

    @property
    def last_ns(self) -> int:
        """The time of the last answer."""
        return self._last_ns or 0

    def unset(self, place: int) -> Occurrence | None:
        """Return how often a value was a number that may stand for "no value"; None if never."""
        return self._unset.get(place)

    def outside(self, place: int) -> Occurrence | None:
        """Return how often a value was outside the profile's range; None if never."""
        return self._outside.get(place)

    def not_valid(self) -> list[tuple[FollowedValue, str, Occurrence]]:
        """Return the texts that said that a value is not valid, each with where it was seen."""
        return [(self.values[place], text, seen) for (place, text), seen in self._not_valid.items()]


def _note_occurrences(
    seen: dict[K, Occurrence], key: K, times: Int64s, numbers: Floats, has: npt.NDArray[np.bool_]
) -> None:
    number = int(has.sum())
    old = seen.get(key)
    if old is not None:
        seen[key] = old._replace(answers=old.answers + number)
    elif number:
        first = int(np.argmax(has))
        seen[key] = Occurrence(number, int(times[first]), float(numbers[first]))


def _numbers_of(columns: npt.NDArray[np.uint16], reading: WordReading) -> Floats:
    """Return the numbers in some registers, one for each row; NaN for digits that are not BCD."""
    if reading.order.is_low_first:
        columns = columns[:, ::-1]
    raw = np.ascontiguousarray(columns.astype("<u2" if reading.order.is_swapped else ">u2"))
    code = reading.type.struct_code
    if code is not None:
        with np.errstate(invalid="ignore"):
            return raw.view(f">{code}")[:, 0].astype(np.float64)
    numbers = [reading.type.number(row.tobytes()) for row in raw]
    return np.array([np.nan if one is None else one for one in numbers], np.float64)
