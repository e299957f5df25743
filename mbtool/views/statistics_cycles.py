"""Prints the poll lists of masters: the requests that a master repeats in the same order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core.moments import counted as counted_words
from mbtool.core.moments import duration, in_ms, in_s
from mbtool.views.statistics_columns import (
    StatisticsColumn,
    StatisticsRow,
    StyledLine,
    counted,
    more_line,
    poll_text,
    shortened,
    table_lines,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.ledger.poll_cycle import PollList
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.statistics_report import LinkReport, MasterReport

_LIST = (
    StatisticsColumn("polls", 5),
    StatisticsColumn("every s", 7),
    StatisticsColumn("least", 6),
    StatisticsColumn("most", 6),
    StatisticsColumn("cycles", 6),
    StatisticsColumn("other", 5),
    StatisticsColumn("+miss ms", 8, 1),
)
_STEP = (
    StatisticsColumn("pause ms", 9),
    StatisticsColumn("took ms", 9),
    StatisticsColumn("miss", 6),
)
_LISTS_WITH_STEPS = 5
"""A section that may have N rows shows a row for each of N poll lists, but only for N / 5 of them
the single polls."""

Found = tuple["LinkReport", "MasterReport", "PollList[PollStatistics]"]


def cycle_lines(links: Sequence[LinkReport], width: int | None, top: int) -> list[StyledLine]:
    """Return a row for each poll list, then the polls of the longest lists in their order.

    A poll list is the sequence of requests that a master repeats. `top` limits the rows.
    """
    found = [
        (link, master, one)
        for link in links
        for master in link.masters
        for one in master.lists.lists
    ]
    if not found:
        return []
    found.sort(key=lambda one: -len(one[2].steps))
    rows = [
        StatisticsRow(_name(one, links), _cells(one[2]), "red" if one[2].missing_ns else "")
        for one in found[:top]
    ]
    lines = table_lines("poll cycles", _LIST, rows, width)
    lines += more_line(len(found), top, "cycles")
    long = [one for one in found if len(one[2].steps) > 1]
    shown = max(top // _LISTS_WITH_STEPS, 1)
    for one in long[:shown]:
        title = "  in this order" if len(found) == 1 else f"  in order: {_name(one, links)}"
        lines += [*_step_lines(one[2], title, width, top), *_repeated_line(one[2], width)]
    lines += _part_line(found)
    return [*lines, *_untold_lists(len(long), shown), *_between_lines(links, width, top)]


def _part_line(found: Sequence[Found]) -> list[StyledLine]:
    """Return a line that says of which requests the cycles are; no line if they are of all."""
    masters = {(link.name, master.master): (link, master) for link, master, _ in found}
    parts = [
        (master.requests, asked)
        for link, master in masters.values()
        if (asked := _asked(link, master.master)) > master.requests
    ]
    if not parts:
        return []
    looked_at, asked = parts[0]
    of = f" of {asked:,}" if len(parts) == 1 else ""
    each = " of each master" if len(masters) > 1 else ""
    return [StyledLine(f"  of the last {looked_at:,}{of} requests{each}")]


def _asked(link: LinkReport, master: str) -> int:
    """Return the number of requests that a master sent on a link, in the polls that are known."""
    polls = (one.poll for one in link.polls)
    return sum(poll.tally.requests for poll in polls if poll.key.master == master)


def _untold_lists(number: int, shown: int) -> list[StyledLine]:
    """Return a line with the number of poll lists, out of `number`, whose polls are not shown.

    `shown` is the number of lists whose polls are shown; if that is all of them, there is no line.
    """
    if number <= shown:
        return []
    lists = counted_words(number - shown, "more list", ",")
    top = number * _LISTS_WITH_STEPS
    return [StyledLine(f"  ... the polls of {lists}", "dim", hint=f"{top} shows them")]


def _name(found: Found, links: Sequence[LinkReport]) -> str:
    link, master, one = found
    more = ", .." if len(one.steps) > 1 else ""
    parts = [f"{master.master}:"] if len(link.masters) > 1 else []
    parts += [] if len(links) == 1 else [link.name]
    return " ".join((*parts, f"{poll_text(one.steps[0].poll)}{more}"))


def _cells(one: PollList[PollStatistics]) -> list[str]:
    cost = one.missing_cost_ns
    return [
        str(len(one.steps)),
        in_s(one.period_ns),
        in_s(one.times[0]),
        in_s(one.times[-1]),
        f"{one.cycles:,}",
        counted(one.other_cycles),
        "" if not cost else in_ms(cost),
    ]


def _step_lines(
    one: PollList[PollStatistics], title: str, width: int | None, top: int
) -> list[StyledLine]:
    rows = [
        StatisticsRow(
            f"  {poll_text(step.poll)}",
            [in_ms(step.pause_ns), in_ms(step.took_ns), counted(step.missing)],
            "red" if step.missing else "",
        )
        for step in one.steps[:top]
    ]
    return table_lines(title, _STEP, rows, width) + more_line(len(one.steps), top, "steps")


def _repeated_line(one: PollList[PollStatistics], width: int | None) -> list[StyledLine]:
    if not one.repeated:
        return []
    texts = "; ".join(f"{poll_text(poll)} x{one.polls.count(poll)}" for poll in one.repeated)
    return [StyledLine(shortened(f"  more than once a cycle: {texts}", width), "yellow")]


def _between_lines(links: Sequence[LinkReport], width: int | None, top: int) -> list[StyledLine]:
    """Return lines on the polls that a master sends between its poll lists, and on its timeout.

    `width` is the terminal's, None on a pipe; `top` limits the rows.
    """
    lines = []
    for link in links:
        for master in link.masters:
            of = f" of {master.master}" if len(link.masters) > 1 else ""
            at = "" if len(links) == 1 else f" at {link.name}"
            between = sorted(master.lists.between.items(), key=lambda one: -one[1])
            if between and master.lists.lists:
                texts = ", ".join(f"{poll_text(poll)} x{count:,}" for poll, count in between)
                lines.append(StyledLine(shortened(f"in no cycle{of}{at}: {texts}", width)))
    if len(links) == len(links[0].masters) == 1:
        timeout_ns = links[0].masters[0].lists.timeout_ns
        if timeout_ns is not None:
            text = f"the master waits {duration(timeout_ns)} for an answer"
            lines.append(StyledLine(text))
    return lines[:top] + more_line(len(lines), top, "masters with polls in no cycle")
