"""Shows transactions as a table that grows line by line, on a terminal or into a pipe."""

# A capture may be endless, so the columns get their widths from the first SAMPLE rows or fewer.
#
# On a terminal, the columns "what" and "result" share the width that the others leave; if it is too
# little, the column "function" becomes narrower. A cell of "what" or "result" that is too long is
# cut with an ellipsis, and repeated in full below its line. Any other column grows for a longer
# cell.
#
# In a pipe or a file, nothing is cut, and each transaction is one line. A column grows for a longer
# cell up to its cap; a cell beyond the cap moves the rest of its line to the right.
#
# A live table must show its first row before the next one is known, and the first rows say little
# about later ones. So its columns begin with the widths that most rows need, and "what" and
# "result" share the rest in a fixed proportion.
#
# Text from a wire is never markup, and control characters in it are replaced.

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
"""The columns "what" and "result", which share the width that the other columns leave."""
_MIN_FUNCTION = 6
"""The least width of the column "function": the code and the beginning of the name."""
_CAPS = (7, 12, 24, 4, 22, 60, 60, 10)
_MINIMA = (2, 12, 5, 4, 18, 12, 8, 8)
_LIVE_MINIMA = (4, 12, 5, 4, 18, 40, 33, 9)
"""The least width of each column of a live table, in characters. It fits, in "what",
HR400001..400004 := 4660, 22136, ...; in "result", exception 02 illegal data address; in "latency",
9999.9 ms."""


class TransactionTable:
    """Prints rows as lines. Call `pause` when no row comes for a while, and `flush` at the end."""

    def __init__(self, console: Console, *, sample: int = SAMPLE) -> None:
        self._console = console
        self._sample = sample
        self._pending: list[tuple[str, TransactionRow]] = []
        self._widths: tuple[int, ...] | None = None
        self._is_live = False
        self._styles: dict[str, tuple[str, str]] = {}
        self._day = ""

    def add(self, row: TransactionRow, day: str) -> None:
        """Add a row. If its day differs from that of the row before, a line with the day comes
        first.
        """
        if self._widths is not None:
            self._print(row, day)
            return
        self._pending.append((day, row))
        if len(self._pending) >= self._sample:
            self.flush()

    def pause(self) -> None:
        """Show the rows that wait for the widths of columns, although further rows may come, as a
        live table needs it.
        """
        if self._widths is None and self._pending:
            self._is_live = True
        self.flush()

    def flush(self) -> None:
        """Show the pending rows. If the columns have no widths yet, these rows determine them."""
        if self._widths is None and self._pending:
            self._set_widths([row for _, row in self._pending])
            self._print_line(HEADINGS, "bold")
        pending, self._pending = self._pending, []
        for day, row in pending:
            self._print(row, day)

    def _set_widths(self, rows: Sequence[TransactionRow]) -> None:
        minima = self._widths or (_LIVE_MINIMA if self._is_live else _MINIMA)
        if self._console.is_terminal:
            self._widths = _widths_within(self._console.width, rows, minima, live=self._is_live)
        else:
            self._widths = _widths(rows, minima)

    def _print(self, row: TransactionRow, day: str) -> None:
        if _outgrows(row, self._widths or (), whole=not self._console.is_terminal):
            self._set_widths([row])
        if day != self._day:
            self._day = day
            self._print_text(f"{' ' * self._indent}{day} UTC", "dim")
        style = ("red" if row.number else "yellow") if row.trouble else ""
        self._print_line(row.cells(), style)
        if self._console.is_terminal:
            self._print_cut_cells(row, style)

    def _print_cut_cells(self, row: TransactionRow, style: str) -> None:
        """Repeat cells that are cut, in full, below their line."""
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
        """The escape codes that a terminal gets before and after a text of this style.

        They are cached, because Console.print is slow.
        """
        codes = self._styles.get(style)
        if codes is None:
            with self._console.capture() as capture:
                self._console.print(Text("|", style=style), end="")
            before, _, after = capture.get().partition("|")
            codes = self._styles[style] = before, after
        return codes

    @property
    def _indent(self) -> int:
        """The position at which the second column begins, in characters."""
        return (self._widths or (0,))[0] + len(_GAP)


def _fitted(cell: str, width: int, *, whole: bool, right: bool) -> str:
    cell = printable(cell)
    if len(cell) > width and not whole:
        cell = cell[: width - 1] + "\u2026"
    return cell.rjust(width) if right else cell.ljust(width)


def _outgrows(row: TransactionRow, widths: Sequence[int], *, whole: bool) -> bool:
    """True if a column must grow for a row. A column whose long cells are cut never grows."""
    fixed = () if whole else (_FUNCTION, *_LEFTOVER)
    return any(
        width < len(cell) and width < cap
        for index, (cell, width, cap) in enumerate(zip(row.cells(), widths, _CAPS, strict=True))
        if index not in fixed
    )


def _widths(rows: Sequence[TransactionRow], minima: Sequence[int]) -> tuple[int, ...]:
    """The width of each column: as wide as its widest cell, within its least and greatest width."""
    columns = zip(HEADINGS, *(row.cells() for row in rows), strict=True)
    return tuple(
        max(min(max(map(len, column)), cap), minimum)
        for column, cap, minimum in zip(columns, _CAPS, minima, strict=True)
    )


def _widths_within(
    total: int, rows: Sequence[TransactionRow], minima: Sequence[int], *, live: bool
) -> tuple[int, ...]:
    """The width of each column, such that all columns together fill `total` characters."""
    widths = list(_widths(rows, minima))
    least = _MINIMA[_WHAT] + _MINIMA[_RESULT]
    taken = sum(width for index, width in enumerate(widths) if index not in _LEFTOVER)
    left = total - len(_GAP) * (len(widths) - 1) - taken
    if left < least:
        narrower = max(widths[_FUNCTION] - (least - left), _MIN_FUNCTION)
        left = max(left + widths[_FUNCTION] - narrower, least)
        widths[_FUNCTION] = narrower
    # "what" gets more than "result": the reference is more important than the last of many values.
    if live:
        widths[_WHAT] = max(left * 3 // 5, _MINIMA[_WHAT])
    elif widths[_WHAT] + widths[_RESULT] > left:
        widths[_WHAT] = max(min(widths[_WHAT], left * 3 // 5), left - widths[_RESULT])
    else:
        widths[_WHAT] += (left - widths[_WHAT] - widths[_RESULT]) // 2
    widths[_RESULT] = left - widths[_WHAT]
    return tuple(widths)
