"""The six views of `mbtool watch`: their rows and columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from mbtool.ledger.statistics_report import report
from mbtool.troubles.judge import Judgement
from mbtool.views.statistics_table import LEAST_OF_HISTOGRAM, statistics_lines
from mbtool.views.watch_columns import WatchColumn
from mbtool.views.watch_polls import POINT_COLUMNS, POLL_COLUMNS
from mbtool.views.watch_records import RECORD_COLUMNS, SLAVE_COLUMNS, TROUBLE_COLUMNS
from mbtool.watching.board import (
    Board,
    RecordRows,
    point_rows,
    poll_rows,
    record_rows,
    slave_rows,
    trouble_rows,
)

if TYPE_CHECKING:
    from mbtool.watching.watched_rows import KeptRecord


class LineRow(NamedTuple):
    """A line of text on the view `bus`, which shows bus load, links, polls and cycles.

    `key` is the number of the line, from 0; `style` is that of the text, such as `bold red`.
    """

    key: int
    text: str
    style: str
    kept: KeptRecord | None = None


@dataclass(frozen=True, slots=True)
class WatchView:
    """A view of `mbtool watch`: one of the six tables between which the user switches."""

    name: str
    what: str
    """The plural noun in the text of a view without rows, such as `requests to slaves`."""
    row_noun: str
    """The plural noun for the rows of the view, such as `slaves`."""
    columns: Sequence[WatchColumn]
    rows: Callable[[Board, int], Sequence[Any]]
    """Makes the rows from a board (figures and last records) and the screen's width in
    characters."""
    can_follow: bool = False
    """True if the newest row is the last one."""
    pause_s: float = 0
    """The least time between two drawings in seconds; more than 0 if its rows take long to make."""
    notes: Callable[[Sequence[Any]], Sequence[str]] = lambda _: ()
    """Makes from the rows a text that says what the view leaves out. It returns the text in several
    lengths, the longest first; no text if the view shows all."""


_MOST_ROWS = 50
"""A section of the view `bus` shows at most this many rows."""
_MORE_POLLS, _ALL_POLLS = (" more poll", " more polls"), ": key 1 lists all"


def _line_rows(board: Board, width: int) -> list[LineRow]:
    links = report(board.account)
    troubles = () if board.whole.judgement is None else board.whole.judgement.troubles
    lines = statistics_lines(Judgement(troubles, links), width=width, top=_MOST_ROWS, option="")
    rows = [
        LineRow(at, f"{line.text}{_ALL_POLLS * line.text.endswith(_MORE_POLLS)}", line.style)
        for at, line in enumerate(lines)
    ]
    latencies = sum(link.tally.latency.count for link in links)
    if board.account.transactions and latencies < LEAST_OF_HISTOGRAM:
        text = f"latency of all: shown from {LEAST_OF_HISTOGRAM} answers on; here {latencies}"
        rows.append(LineRow(len(rows), text, "dim"))
    return rows


_LINES = (
    WatchColumn(
        name="text",
        title="bus load, links, polls and poll cycles",
        width=0,
        cell=lambda row, _: [(row.text, row.style)],
        sort=lambda row: row.key,
    ),
)


def _older_left_out(rows: Sequence[Any]) -> Sequence[str]:
    """Say that the view of transactions has only the last ones, if it does."""
    heard = rows.heard if isinstance(rows, RecordRows) else len(rows)
    return (f"last {len(rows):,} of {heard:,}",) if heard > len(rows) else ()


_ELSEWHERE = ("rules over several transactions: mbtool check", "more rules: mbtool check")
VIEWS = (
    WatchView("polls", "requests", "requests", POLL_COLUMNS, lambda board, _: poll_rows(board)),
    WatchView(
        "points",
        "values read or written",
        "points",
        POINT_COLUMNS,
        lambda board, _: point_rows(board),
    ),
    WatchView(
        "transactions",
        "transactions or events",
        "transactions and events",
        RECORD_COLUMNS,
        lambda board, _: record_rows(board),
        can_follow=True,
        notes=_older_left_out,
    ),
    WatchView(
        "events",
        "events or findings",
        "kinds of events and findings",
        TROUBLE_COLUMNS,
        lambda board, _: trouble_rows(board),
        notes=lambda _: _ELSEWHERE,
    ),
    WatchView(
        "slaves",
        "requests to slaves",
        "slaves",
        SLAVE_COLUMNS,
        lambda board, _: slave_rows(board),
    ),
    WatchView("bus", "requests", "lines", _LINES, _line_rows, pause_s=1),
)
"""The views in the order of their keys, 1 to 6."""
