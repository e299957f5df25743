"""Says in a few words what is wrong with a slave, for the live views."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.overview.slow_units import are_many
from mbtool.views.cells import clock_time
from mbtool.views.place_columns import common_network
from mbtool.views.statistics_words import in_ms, percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.watching.board_rows import WatchedSlaveRow

FEW = 0.01
"""Failures are not shown if they are fewer than ENOUGH, or a smaller share of the requests than
this (0.01 is 1 %)."""
ENOUGH = 3
_MORE = " more: key 5"
"""Ends the line on slaves with troubles, after the number of those that had no room in it. The key
5 opens the table of slaves."""


def slave_trouble(row: WatchedSlaveRow, *, is_short: bool = False) -> str:
    """Return what is wrong with a slave, the worst first; empty if nothing is.

    With `is_short`, the text for a slow slave leaves out the median latency of the other slaves.
    """
    if row.answered_ns is None and row.missing:
        is_damaged = row.damaged * 2 > row.missing
        return "every answer has a wrong CRC" if is_damaged else "never answers"
    parts = []
    if row.silent_since_ns is not None and row.damaged * 2 <= row.missing:
        parts.append(f"no answer since {clock_time(row.silent_since_ns)[:8]}")
    elif row.missing:
        word = "wrong CRC" if row.damaged * 2 > row.missing else "unanswered"
        parts.append(f"{percent(row.missing / row.asked)} {word}")
    refused = row.exceptions + row.malformed
    if refused:
        word = "refused" if row.exceptions >= row.malformed else "malformed"
        share = f"{percent(refused / row.asked)} {word}"
        parts.append("refuses every request" if row.exceptions == row.asked else share)
    if row.usual_ns is not None:
        others = "" if is_short else f" (others {in_ms(row.usual_ns)})"
        parts.append(f"slow, {in_ms(row.median_ns)} ms{others}")
    return ", ".join(parts)


def trouble_line(rows: Sequence[WatchedSlaveRow], width: int) -> str:
    """Return one line on the slaves with troubles; empty if all are well.

    Slaves that never answer come first. The line names as many as fit `width` characters, and
    always the worst one.
    """
    links = {row.link for row in rows}
    network = common_network(links) or ""
    slow = sum(row.usual_ns is not None for row in rows)
    told = not are_many(slow, len(rows))
    sick = sorted((row for row in rows if _fails(row) or (told and row.usual_ns)), key=_weight)
    line = _line(sick, network if len(links) > 1 else None, width, is_short=False)
    if _MORE in line:
        line = _line(sick, network if len(links) > 1 else None, width, is_short=True)
    return line


def _line(
    sick: Sequence[WatchedSlaveRow], network: str | None, width: int, *, is_short: bool
) -> str:
    """Return the first of the slaves `sick` with their troubles, as many as fit `width` characters.

    The first slave is always named. `network` is the prefix that is left out of the names of links;
    with None, the links are left out.
    """
    text = ""
    for at, row in enumerate(sick):
        place = "" if network is None else f" at {row.link.removeprefix(network)}"
        trouble = slave_trouble(row, is_short=is_short)
        colon = ":" if trouble[:1].isdigit() else ""  # `unit 4 17 %` is hard to read.
        part = f"{'; ' if text else ''}unit {row.unit}{place}{colon} {trouble}"
        left = len(sick) - at
        more = f"; {left}{_MORE}"
        room = width - len(text) - (len(more) if left > 1 else 0)
        if text and len(part) > room:
            return f"{text}{more}"
        text += part
    return text


def _failed(row: WatchedSlaveRow) -> int:
    return row.missing + row.exceptions + row.malformed


def _fails(row: WatchedSlaveRow) -> bool:
    return _failed(row) >= ENOUGH and _failed(row) >= FEW * row.asked


def _weight(row: WatchedSlaveRow) -> tuple[bool, float]:
    return row.answered_ns is not None, -_failed(row) / (row.asked or 1)
