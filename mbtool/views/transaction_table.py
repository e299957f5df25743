"""Shows transactions as a table that grows line by line, on a terminal or into a pipe."""

# Widths must be known before the first line is shown and a capture may be endless, so the columns
# take their widths from the first lines, at most SAMPLE of them; what and result share what is left
# of the terminal, and on a narrow one the function's name makes room for them. Where one of these
# two is too long it is cut with an ellipsis, and stands in full below its line; any other column
# grows when it must. In a pipe or a file nothing is cut and each transaction is one line: a column
# grows for what is longer, up to its cap; a cell beyond that moves the rest of its line to the
# right.
#
# A live table has a line to show before the next is known. What it begins with says little of what
# comes, so its columns are as wide from the start as most lines need, and what and result share
# what is left in a fixed proportion.
#
# Text that came off a wire is never read as markup, nor are control characters in it sent on.

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

from rich.text import Text

from mbtool.views.cells import HEADINGS, TransactionRow
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

SAMPLE = 100
_GAP = "  "
_FUNCTION, _WHAT, _RESULT = 4, 5, 6
_LEFTOVER = (_WHAT, _RESULT)
"""The columns that share what is left."""
_CODE = 6
"""What is left of the function on a narrow terminal: its code, and that there is a name."""
_CAPS = (7, 12, 24, 4, 22, 60, 60, 10)
_MINIMA = (2, 12, 5, 4, 18, 12, 8, 8)
_LIVE_MINIMA = (4, 12, 5, 4, 18, 40, 33, 9)
"""HR400001..400004 := 4660, 22136, ...; exception 02 illegal data address; 9999.9 ms."""


class TransactionTable:
    """Takes rows, prints lines. Call pause where nothing comes for a while, flush at the end."""

    def __init__(self, console: Console, *, sample: int = SAMPLE) -> None:
        self._console = console
        self._sample = sample
        self._waiting: list[tuple[str, TransactionRow]] = []
        self._widths: tuple[int, ...] | None = None
        self._is_live = False
        self._styles: dict[str, tuple[str, str]] = {}
        self._day = ""

    def add(self, row: TransactionRow, day: str) -> None:
        """Show a row; a day that differs from the last one gets a line of its own."""
        if self._widths is not None:
            self._print(row, day)
            return
        self._waiting.append((day, row))
        if len(self._waiting) >= self._sample:
            self.flush()

    def pause(self) -> None:
        """Show what there is, while more may come."""
        if self._widths is None and self._waiting:
            self._is_live = True
        self.flush()

    def flush(self) -> None:
        """Show what waits for the widths to be settled."""
        if self._widths is None and self._waiting:
            self._settle([row for _, row in self._waiting])
            self._print_line(HEADINGS, "bold")
        waiting, self._waiting = self._waiting, []
        for day, row in waiting:
            self._print(row, day)

    def _settle(self, rows: Sequence[TransactionRow]) -> None:
        minima = self._widths or (_LIVE_MINIMA if self._is_live else _MINIMA)
        if self._console.is_terminal:
            self._widths = _widths_within(self._console.width, rows, minima, live=self._is_live)
        else:
            self._widths = _widths(rows, minima)

    def _print(self, row: TransactionRow, day: str) -> None:
        if _outgrows(row, self._widths or (), whole=not self._console.is_terminal):
            self._settle([row])
        if day != self._day:
            self._day = day
            self._print_text(f"{' ' * self._indent}{day} UTC", "dim")
        style = ("red" if row.number else "yellow") if row.trouble else ""
        self._print_line(row.cells(), style)
        if self._console.is_terminal:
            self._print_long(row, style)

    def _print_long(self, row: TransactionRow, style: str) -> None:
        """Show in full below its line what is cut in it."""
        widths = self._widths or ()
        for index in _LEFTOVER:
            cell = row.cells()[index]
            if len(cell) > widths[index]:
                indent = " " * self._indent
                for line in wrap(cell, max(self._console.width - len(indent), 20)):
                    self._print_text(indent + printable(line), f"dim {style}")

    def _print_line(self, cells: Sequence[str], style: str) -> None:
        widths = self._widths or ()
        whole = not self._console.is_terminal
        parts = [
            _fitted(cell, width, whole=whole, right=index == 0)
            for index, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        self._print_text(_GAP.join(parts).rstrip(), style)

    def _print_text(self, line: str, style: str) -> None:
        before, after = self._codes(style) if style else ("", "")
        self._console.file.write(f"{before}{line}{after}\n")

    def _codes(self, style: str) -> tuple[str, str]:
        """What switches a style on and off; known once, as Console.print takes its time."""
        codes = self._styles.get(style)
        if codes is None:
            with self._console.capture() as capture:
                self._console.print(Text("|", style=style), end="")
            before, _, after = capture.get().partition("|")
            codes = self._styles[style] = before, after
        return codes

    @property
    def _indent(self) -> int:
        """Where the second column begins."""
        return (self._widths or (0,))[0] + len(_GAP)


def _fitted(cell: str, width: int, *, whole: bool, right: bool) -> str:
    cell = printable(cell)
    if len(cell) > width and not whole:
        cell = cell[: width - 1] + "\u2026"
    return cell.rjust(width) if right else cell.ljust(width)


def _outgrows(row: TransactionRow, widths: Sequence[int], *, whole: bool) -> bool:
    """Whether a column is too narrow for a row; those that are cut to fit never are."""
    fixed = () if whole else (_FUNCTION, *_LEFTOVER)
    return any(
        width < len(cell) and width < cap
        for index, (cell, width, cap) in enumerate(zip(row.cells(), widths, _CAPS, strict=True))
        if index not in fixed
    )


def _widths(rows: Sequence[TransactionRow], minima: Sequence[int]) -> tuple[int, ...]:
    """Each column's width, as wide as its rows up to its cap."""
    columns = zip(HEADINGS, *(row.cells() for row in rows), strict=True)
    return tuple(
        max(min(max(map(len, column)), cap), minimum)
        for column, cap, minimum in zip(columns, _CAPS, minima, strict=True)
    )


def _widths_within(
    total: int, rows: Sequence[TransactionRow], minima: Sequence[int], *, live: bool
) -> tuple[int, ...]:
    """Each column's width, where what and result fill the total."""
    widths = list(_widths(rows, minima))
    least = _MINIMA[_WHAT] + _MINIMA[_RESULT]
    taken = sum(width for index, width in enumerate(widths) if index not in _LEFTOVER)
    left = total - len(_GAP) * (len(widths) - 1) - taken
    if left < least:
        narrower = max(widths[_FUNCTION] - (least - left), _CODE)
        left = max(left + widths[_FUNCTION] - narrower, least)
        widths[_FUNCTION] = narrower
    # What is addressed matters more than the end of a long list of values.
    if live:
        widths[_WHAT] = max(left * 3 // 5, _MINIMA[_WHAT])
    elif widths[_WHAT] + widths[_RESULT] > left:
        widths[_WHAT] = max(min(widths[_WHAT], left * 3 // 5), left - widths[_RESULT])
    else:
        widths[_WHAT] += (left - widths[_WHAT] - widths[_RESULT]) // 2
    widths[_RESULT] = left - widths[_WHAT]
    return tuple(widths)
