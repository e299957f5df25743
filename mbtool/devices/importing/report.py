"""Collects the messages of an import for the user: guesses, and rows that cannot be read."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

MAX_PROBLEMS = 100
"""At most so many problems get a line of their own. One more line names the rows of all others."""

_SHOWN = 40
"""A message about a problem shows at most so many characters of the cell."""


class ImportReport:
    """The remarks on one register list, and the problems of its rows, for the user."""

    def __init__(self) -> None:
        self._remarks: dict[str, list[int]] = {}
        self._problems: dict[str, set[int]] = {}
        self.bad_rows: set[int] = set()

    def tell(self, remark: str, row: int | None = None) -> None:
        """Add a remark on the row with the number `row`, or on the whole list if `row` is None.

        Equal remarks on several rows become one remark with the numbers of all these rows.
        """
        self._remarks.setdefault(remark, []).extend(() if row is None else (row,))

    def add_problem(self, row: int, heading: str | None, text: str, problem: str) -> None:
        """Add a problem with a row. The profile lacks this row.

        `problem` says what is wrong with the cell `text` in the column `heading`; `heading` is None
        if the problem concerns no single column.
        """
        self.bad_rows.add(row)
        shown = " ".join(text.split())
        shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
        where = f', column "{heading}"' if heading is not None else ""
        self._problems.setdefault(f"{where}: {shown!r} {problem}", set()).add(row)

    @property
    def remarks(self) -> list[str]:
        return [f"{_rows(rows)}: {one}" if rows else one for one, rows in self._remarks.items()]

    @property
    def problem_lines(self) -> list[str]:
        """Lines about the problems, in the order of the rows. The number of each row with a problem
        is in one of them.
        """
        known = sorted(self._problems.items(), key=lambda one: min(one[1]))
        lines = [f"{_rows(rows)}{problem}" for problem, rows in known[:MAX_PROBLEMS]]
        others = set[int]().union(*(rows for _, rows in known[MAX_PROBLEMS:]))
        return [*lines, f"{_rows(others)}: other problems like these"] if others else lines


def _rows(numbers: Iterable[int]) -> str:
    """Write the numbers of rows: `row 2`, or `rows 2, 5-8`."""
    runs: list[list[int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    parts = [str(first) if first == last else f"{first}-{last}" for first, last in runs]
    return f"row{'s' if parts != [str(runs[0][0])] else ''} {', '.join(parts)}"
