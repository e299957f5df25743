"""Says in a few words what is wrong with a slave, for the live views."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.overview.failure_limits import ENDED, MANY_REFUSING, THROUGHOUT
from mbtool.overview.slow_units import are_many
from mbtool.views.cells import clock_time
from mbtool.views.place_columns import common_network
from mbtool.views.statistics_words import in_ms, percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.watching.board_rows import WatchedSlaveRow
    from mbtool.watching.watched_rows import FailureSpan

FEW = 0.01
"""Failures are not shown if they are fewer than ENOUGH, or a smaller share of the requests than
this (0.01 is 1 %)."""
ENOUGH = 3
_SHORTEST_NS = 2_000_000_000
"""No time of failures is told of a slave that was heard for less than this (ns), as times have
whole seconds."""
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
    elif row.missing_span is not None:
        word = "wrong CRC" if row.damaged * 2 > row.missing else "unanswered"
        parts.append(_share(row, row.missing_span, word, is_short=is_short))
    if _refuses_all(row):
        parts.append("refuses every request")
    elif _refuses_again(row):
        parts.append(f"always refuses {row.refused_polls} of {row.polls} polls")
    elif row.refused_span is not None:
        parts.append(_share(row, row.refused_span, "refused", is_short=is_short))
    if row.malformed:
        parts.append(f"{percent(row.malformed / row.asked)} malformed")
    if row.usual_ns is not None:
        others = "" if is_short else f" (others {in_ms(row.usual_ns)})"
        parts.append(f"slow, {in_ms(row.median_ns)} ms{others}")
    return ", ".join(parts)


def _share(row: WatchedSlaveRow, span: FailureSpan, word: str, *, is_short: bool) -> str:
    """Return which share of the requests failed, and since when, as the verdict of `report` does.

    If the failures came late or have ended, the share is of the requests from the first one that
    failed to the last one or the present, and the text tells the time. Else it is of all requests.
    """
    whole_ns = row.last_ns - row.first_ns
    is_late = span.first_ns - row.first_ns > THROUGHOUT * whole_ns
    is_over = row.last_ns - span.last_ns > ENDED * whole_ns
    is_short_time = whole_ns < _SHORTEST_NS or span.failed < ENOUGH
    if is_short_time or not (is_late or is_over):
        return f"{percent(span.failed / row.asked)} {word}"
    before = span.asked_before if is_late else 0
    end = span.asked_before + span.asked if is_over else row.asked
    digits = 5 if is_short else 8
    since, until = clock_time(span.first_ns)[:digits], clock_time(span.last_ns)[:digits]
    when = f"since {since}"
    if is_over:
        when = f"{since} to {until}" if is_late else f"until {until}"
    return f"{percent(span.failed / (end - before))} {word} {when}"


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
    refusing = [row for row in sick if _refuses_all(row)]
    joined = ""
    if len(refusing) >= MANY_REFUSING and 2 * len(refusing) >= len(rows):
        some = "all" if len(refusing) == len(rows) else f"{len(refusing)} of"
        joined = f"{some} {len(rows)} units refuse every request"
        sick = [row for row in sick if not _refuses_all(row)]
        width -= len(joined) + 2
    line = _line(sick, network if len(links) > 1 else None, width, is_short=False)
    if _MORE in line:
        line = _line(sick, network if len(links) > 1 else None, width, is_short=True)
    return "; ".join(filter(None, (line, joined)))


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


def _refuses_all(row: WatchedSlaveRow) -> bool:
    return 0 < row.exceptions == row.asked


def _refuses_again(row: WatchedSlaveRow) -> bool:
    """True if all refusals of a unit are of certain polls, which it refuses each time.

    If each of these polls came only once, as in a scan, that tells nothing.
    """
    is_repeated = row.exceptions >= ENOUGH and row.exceptions > row.refused_polls
    return 0 < row.refused_polls < row.polls and is_repeated


def _failed(row: WatchedSlaveRow) -> int:
    return row.missing + row.exceptions + row.malformed


def _fails(row: WatchedSlaveRow) -> bool:
    return _failed(row) >= ENOUGH and _failed(row) >= FEW * row.asked


def _weight(row: WatchedSlaveRow) -> tuple[bool, float]:
    return row.answered_ns is not None, -_failed(row) / (row.asked or 1)
