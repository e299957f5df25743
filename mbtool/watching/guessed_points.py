"""Finds the registers of a live view that are surely one number, and reads that number."""

# The rows of values of a poll are kept until JUDGED_AT of them differ. Then their types are judged,
# at most twice, and the rows are dropped. Only polls of registers that no profile names are given
# to this module.
#
# Memory: the last rows of the MAX_POLLS polls that came first, up to the second judgement.

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

from mbtool.devices.point_types import PointType
from mbtool.values.guessed_series import is_shown
from mbtool.values.judging import Judged, WordHistory, judge
from mbtool.values.word_readings import numbers_in

if TYPE_CHECKING:
    from mbtool.modbus import Table

JUDGED_AT = (24, 64)
MAX_POLLS = 128

_Place = tuple[str, int, "Table", int]


class GuessedPoints:
    """The numbers of several registers that are known so far."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, int, Table, int, int], tuple[list[int], list[tuple[int, ...]]]]
        self._rows = {}
        self._judged: dict[tuple[str, int, Table, int, int], int] = {}
        self._guesses: dict[_Place, Judged] = {}
        """By link, unit, table and address of each register of a number: the number."""

    def learn(
        self, link: str, unit: int, table: Table, first: int, values: Sequence[int], at_ns: int
    ) -> list[Judged]:
        """Take a row that a poll has read; return the numbers that are known only now."""
        key = link, unit, table, first, len(values)
        done = self._judged.get(key, 0)
        if done == len(JUDGED_AT) or (key not in self._judged and len(self._judged) >= MAX_POLLS):
            return []
        self._judged.setdefault(key, 0)
        times, rows = self._rows.setdefault(key, ([], []))
        times.append(at_ns)
        rows.append(tuple(values))
        if len(rows) < JUDGED_AT[done]:
            return []
        self._judged[key] = done + 1
        new = []
        for one in judge([WordHistory(table, first, times, rows)]):
            places = [(link, unit, table, one.address + word) for word in range(one.words)]
            if is_shown(one) and not any(place in self._guesses for place in places):
                self._guesses.update(dict.fromkeys(places, one))
                new.append(one)
        if done + 1 == len(JUDGED_AT):
            del self._rows[key]
        return new

    def at(self, link: str, unit: int, table: Table, address: int) -> Judged | None:
        """The number that a register belongs to; None if nothing shows that it belongs to one."""
        return self._guesses.get((link, unit, table, address))


def number_of(one: Judged, words: Sequence[int]) -> float | None:
    """The number in the registers of a guess; None if they hold none."""
    numbers = numbers_in([[word] for word in words], one.reading)
    if numbers is None or not isfinite(numbers[0]):
        return None
    is_short = one.reading.type is PointType.FLOAT32
    return float(f"{numbers[0]:.7g}") if is_short else numbers[0]
