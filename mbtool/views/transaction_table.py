"""Shows transactions as a table that grows line by line, on a terminal or into a pipe."""

# Widths must be known before the first line is shown and a capture may be endless, so the columns
# take their widths from the first lines, at most SAMPLE of them, and keep them; what and result
# share what is left of the terminal. A cell that is too long is cut with an ellipsis on a terminal
# and kept whole in a pipe, where nobody needs it aligned.
#
# Text that came off a wire is never read as markup.

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
_CAPS = (7, 12, 24, 4, 22, 0, 0, 9)
_MINIMA = (2, 12, 5, 4, 8, 12, 8, 8)


class TransactionTable:
    """Takes rows, prints lines. Call finish at the end."""

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
            self._widths = _widths([row for _, row in self._waiting], self._console.width)
            self._print_line(HEADINGS, "bold")
        waiting, self._waiting = self._waiting, []
        for day, row in waiting:
            self._print(row, day)

    def finish(self) -> None:
        """Show the rest."""
        self.flush()

    def _print(self, row: Row, day: str) -> None:
        if day != self._day:
            self._day = day
            self._print_line(("", f"{day} UTC"), "dim")
        style = "yellow" if row.trouble and not row.number else "red" if row.trouble else ""
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
    if len(cell) > width and not whole:
        cell = cell[: max(width - 1, 0)] + "\u2026"
    return cell.rjust(width) if right else cell.ljust(width)


def _widths(rows: Sequence[Row], total: int) -> tuple[int, ...]:
    columns = list(zip(HEADINGS, *(row.cells() for row in rows), strict=True))
    wanted = [max(len(cell) for cell in column) for column in columns]
    widths = [
        wanted[index] if index in _LEFTOVER else max(min(wanted[index], cap), minimum)
        for index, (cap, minimum) in enumerate(zip(_CAPS, _MINIMA, strict=True))
    ]
    left = total - len(_GAP) * (len(widths) - 1)
    left -= sum(width for index, width in enumerate(widths) if index not in _LEFTOVER)
    what, result = _LEFTOVER
    if widths[what] + widths[result] > left:
        # The reference matters more than a long list of values.
        widths[what] = max(min(widths[what], left * 3 // 5), _MINIMA[what])
        widths[result] = max(left - widths[what], _MINIMA[result])
    return tuple(widths)
