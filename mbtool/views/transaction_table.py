"""Shows transactions as a table that grows line by line, on a terminal or into a pipe."""

# Widths must be known before the first line is shown and a capture may be endless, so the columns
# take their widths from the first lines, at most SAMPLE of them, and keep them; what and result
# share what is left of the terminal. A cell that is too long is cut with an ellipsis on a terminal.
# In a pipe or a file nothing is cut, and a long cell moves the rest of its line to the right.
#
# Text that came off a wire is never read as markup, nor are control characters in it sent on.

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from mbtool.views.cells import HEADINGS, Row

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

SAMPLE = 100
_GAP = "  "
_LEFTOVER = (5, 6)
"""What and result: the columns that share what is left."""
_CAPS = (7, 12, 24, 4, 22, 60, 60, 9)
_MINIMA = (2, 12, 5, 4, 18, 12, 8, 8)


class TransactionTable:
    """Takes rows, prints lines. Call flush at the end, and before a pause."""

    def __init__(self, console: Console, *, sample: int = SAMPLE) -> None:
        self._console = console
        self._sample = sample
        self._waiting: list[tuple[str, Row]] = []
        self._widths: tuple[int, ...] | None = None
        self._day = ""

    def add(self, row: Row, day: str) -> None:
        """Show a row; a day that differs from the last one gets a line of its own."""
        if self._widths is not None:
            self._print(row, day)
            return
        self._waiting.append((day, row))
        if len(self._waiting) >= self._sample:
            self.flush()

    def flush(self) -> None:
        """Show what waits for the widths to be settled."""
        if self._widths is None and self._waiting:
            total = self._console.width if self._console.is_terminal else None
            self._widths = _widths([row for _, row in self._waiting], total)
            self._print_line(HEADINGS, "bold")
        waiting, self._waiting = self._waiting, []
        for day, row in waiting:
            self._print(row, day)

    def _print(self, row: Row, day: str) -> None:
        if day != self._day:
            self._day = day
            self._print_line(("", f"{day} UTC"), "dim")
        style = ("red" if row.number else "yellow") if row.trouble else ""
        self._print_line(row.cells(), style)

    def _print_line(self, cells: Sequence[str], style: str) -> None:
        widths = self._widths or ()
        whole = not self._console.is_terminal
        parts = [
            _fitted(cell, width, whole=whole, right=index == 0)
            for index, (cell, width) in enumerate(zip(cells, widths, strict=False))
        ]
        line = _GAP.join(parts).rstrip()
        self._console.print(Text(line, style=style), soft_wrap=True)


def _fitted(cell: str, width: int, *, whole: bool, right: bool) -> str:
    if not cell.isprintable():
        cell = "".join(char if char.isprintable() else "?" for char in cell)
    if len(cell) > width and not whole:
        cell = cell[: width - 1] + "\u2026"
    return cell.rjust(width) if right else cell.ljust(width)


def _widths(rows: Sequence[Row], total: int | None) -> tuple[int, ...]:
    """Each column's width; with a total, what and result fill it."""
    columns = zip(HEADINGS, *(row.cells() for row in rows), strict=True)
    widths = [
        max(min(max(map(len, column)), cap), minimum)
        for column, cap, minimum in zip(columns, _CAPS, _MINIMA, strict=True)
    ]
    if total is None:
        return tuple(widths)
    what, result = _LEFTOVER
    rest = sum(width for index, width in enumerate(widths) if index not in _LEFTOVER)
    left = max(total - len(_GAP) * (len(widths) - 1) - rest, _MINIMA[what] + _MINIMA[result])
    # What is addressed matters more than the end of a long list of values.
    if widths[what] + widths[result] > left:
        widths[what] = max(min(widths[what], left * 3 // 5), left - widths[result])
    else:
        widths[what] += (left - widths[what] - widths[result]) // 2
    widths[result] = left - widths[what]
    return tuple(widths)
