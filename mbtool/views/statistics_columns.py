"""Lays out tables of statistics as lines; the first column is as wide as the others allow."""

# On a terminal, columns with the highest rank are left out until the first column has room for its
# longest text or for ENOUGH_WIDTH characters. A text that is still too long is cut and ends in
# "..". On a pipe (width None) no column is left out, no text is cut, and the first column has at
# least PIPE_FIRST characters.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import TYPE_CHECKING

from mbtool.modbus import short_name
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from mbtool.ledger.poll_statistics import PollStatistics

# The functions below write the figures of statistics as text: rates, counts and polls.


def per_second(rate: float | None) -> str:
    """Write a rate per second: 39.1, 0.25, 0.0012; `-` for None."""
    if rate is None:
        return "-"
    if rate >= 99.95:
        return f"{rate:.0f}"
    return f"{rate:.1f}" if rate >= 0.995 else f"{rate:.2g}"


def counted(number: int) -> str:
    """Write a count for a cell of a table; a 0 gives an empty cell."""
    return f"{number:,}" if number else ""


def poll_text(poll: PollStatistics) -> str:
    """Return unit, function code and reference of a repeated request: `1 03 HR400001..400004`."""
    return f"{poll.key.unit} {request_text(poll)}"


def request_text(poll: PollStatistics) -> str:
    """Return function code and reference of a repeated request: `03 HR400001..400004`."""
    key = poll.key
    what = poll.reference or short_name(key.function, poll.function_name)
    if not poll.reference and key.sub_function is not None:
        what = f"{what} {key.sub_function:02X}"
    return f"{key.function:02X} {what}"


ENOUGH_WIDTH = 34
PIPE_FIRST = 40
_MORE = ".."
_KEPT = "\0%"
"""Replaces " %" while a text is wrapped, so that a number and its percent sign stay in one line."""


@dataclass(frozen=True, slots=True)
class StatisticsColumn:
    """A column to the right of the first one. Its cells are aligned to the right."""

    title: str
    width: int
    rank: int = 0
    """If there is little room, columns with the highest rank are left out first; rank 0 is never
    left out."""


@dataclass(frozen=True, slots=True)
class StatisticsRow:
    """A row of a table: the text of the first column, the other cells in order, and a style."""

    first: str
    cells: Sequence[str]
    style: str = ""


@dataclass(frozen=True, slots=True)
class StyledLine:
    """A line of text and its style in the notation of the library rich, such as `bold red`."""

    text: str
    style: str = ""
    without: tuple[str, ...] = ()
    """If this line has the titles of a table: the titles of columns that were left out for lack of
    room."""
    hint: str = ""
    """The value for the option that sets the number of rows, and its effect, such as `12 shows
    all`; empty unless the line tells that rows were left out."""


def table_lines(
    title: str,
    columns: Sequence[StatisticsColumn],
    rows: Sequence[StatisticsRow],
    width: int | None,
) -> list[StyledLine]:
    """Return the title line and a line for each row.

    `title` is that of the first column. `width` is the terminal's in characters, None on a pipe.
    """
    kept = [*range(len(columns))]
    longest = max(len(one.first) for one in (StatisticsRow(title, ()), *rows))
    while width is not None and _room(columns, kept, width) < min(longest, ENOUGH_WIDTH):
        rank = max(columns[at].rank for at in kept)
        if rank == 0:
            break
        kept = [at for at in kept if columns[at].rank != rank]
    if width is None:
        room = max(PIPE_FIRST, longest)
    else:
        room = min(longest, max(_room(columns, kept, width), 8))
    titles = StatisticsRow(title, [one.title for one in columns], "bold")
    without = tuple(one.title for at, one in enumerate(columns) if at not in kept)
    first, *others = (
        StyledLine(_line(one, columns, kept, room, is_cut=width is not None), one.style)
        for one in (titles, *rows)
    )
    return [replace(first, without=without), *others]


def _room(columns: Sequence[StatisticsColumn], kept: Sequence[int], width: int) -> int:
    return width - sum(columns[at].width + 1 for at in kept)


def _line(
    row: StatisticsRow,
    columns: Sequence[StatisticsColumn],
    kept: Sequence[int],
    room: int,
    *,
    is_cut: bool,
) -> str:
    first = shorten(row.first, room) if is_cut else printable(row.first)
    cells = [row.cells[at].rjust(columns[at].width) for at in kept]
    return " ".join((first.ljust(room), *cells)).rstrip()


def shorten(text: str, room: int | None) -> str:
    """Return a text of at most `room` characters; a longer text is cut and ends in `..`.

    With `room` None, as on a pipe, no text is cut.
    """
    text = printable(text)
    if room is None or len(text) <= room:
        return text
    return text[: max(room - len(_MORE), 0)] + _MORE


def more_line(number: int, top: int, what: str) -> list[StyledLine]:
    """Return a line that says how many of `number` rows are not shown; no line if all are.

    `top` is the number of rows that are shown, and `what` their name in the plural.
    """
    if number <= top:
        return []
    left = number - top
    text = f"  ... {left:,} more {what if left > 1 else what.removesuffix('s')}"
    return [StyledLine(text, "dim", hint=f"{number} shows all")]


def wrapped(line: StyledLine, width: int | None) -> list[StyledLine]:
    """Break a text into lines that fit the terminal; a pipe (`width` None) gets one line."""
    text = printable(line.text)
    if width is None:
        return [StyledLine(text, line.style)]
    lines = wrap(text.replace(" %", _KEPT), width, subsequent_indent="  ", break_on_hyphens=False)
    return [StyledLine(one.replace(_KEPT, " %"), line.style) for one in lines]
