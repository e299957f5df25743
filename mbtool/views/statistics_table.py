"""Prints statistics in sections: a summary first, then links, polls, functions and others."""

# An empty section is left out. A section lists at most `top` rows; its last line says how many more
# there are. On a terminal, sections get fewer rows, and then the last sections are left out, until
# all lines fit the height. A line at the end names the sections and columns that have no room.

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core.moments import clock_time, day, duration, in_ms, in_s, percent, plural
from mbtool.core.moments import counted as counted_words
from mbtool.ledger.account import OTHER_UNITS
from mbtool.ledger.distribution import PERCENTILES, Bucket
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.modbus import Outcome, short_name
from mbtool.views.statistics_columns import (
    StatisticsColumn,
    StatisticsRow,
    StyledLine,
    counted,
    more_line,
    per_second,
    poll_text,
    shorten,
    table_lines,
    wrapped,
)
from mbtool.views.statistics_summary import summary_lines

if TYPE_CHECKING:
    from mbtool.ledger.poll_cycle import PollList
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.statistics_connections import ConnectionTally
    from mbtool.ledger.statistics_report import FunctionReport, LinkReport, MasterReport, PollReport
    from mbtool.troubles.judge import Judgement

# Prints the poll lists of masters: the requests that a master repeats in the same order.

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
        lines += [*_step_lines(one[2], title, width, top), *_polls_repeated_in_cycle(one[2], width)]
    lines += _part_line(found)
    return [*lines, *_untold_lists(len(long), shown), *_between_lines(links, width, top)]


def _part_line(found: Sequence[Found]) -> list[StyledLine]:
    """Return a line that says of which requests the cycles are; no line if they are of all."""
    masters = {(link.name, master.master): (link, master) for link, master, _ in found}
    parts = [
        (master.requests, asked)
        for link, master in masters.values()
        if (asked := _count_requests(link, master.master)) > master.requests
    ]
    if not parts:
        return []
    looked_at, asked = parts[0]
    of = f" of {asked:,}" if len(parts) == 1 else ""
    each = " of each master" if len(masters) > 1 else ""
    return [StyledLine(f"  of the last {looked_at:,}{of} requests{each}")]


def _count_requests(link: LinkReport, master: str) -> int:
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


def _polls_repeated_in_cycle(one: PollList[PollStatistics], width: int | None) -> list[StyledLine]:
    if not one.repeated:
        return []
    texts = "; ".join(f"{poll_text(poll)} x{one.polls.count(poll)}" for poll in one.repeated)
    return [StyledLine(shorten(f"  more than once a cycle: {texts}", width), "yellow")]


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
                lines.append(StyledLine(shorten(f"in no cycle{of}{at}: {texts}", width)))
    if len(links) == len(links[0].masters) == 1:
        timeout_ns = links[0].masters[0].lists.timeout_ns
        if timeout_ns is not None:
            text = f"the master waits {duration(timeout_ns)} for an answer"
            lines.append(StyledLine(text))
    return lines[:top] + more_line(len(lines), top, "masters with polls in no cycle")


FEWEST = 3
"""Each section keeps this many rows, however small the terminal is."""
USUAL = 10
MOST_IMPORTANT = 2
"""This many sections, the first ones, are shown even on the smallest terminal: they matter most."""
_ALIKE = 0.7
_BAR = 30
_EATERS = 3
LEAST_OF_HISTOGRAM = 20
"""Fewer latencies than this make no histogram."""
_FINEST_NS = 100_000
"""The histogram shows all latencies below this limit, in ns, in one line."""

_LATENCY = (
    StatisticsColumn(f"p{PERCENTILES[0]} ms", 6),
    *(StatisticsColumn(f"p{one}", 5) for one in PERCENTILES[1:-1]),
    StatisticsColumn(f"p{PERCENTILES[-1]}", 5, 3),
    StatisticsColumn("max", 5, 2),
)
_FAILED = (StatisticsColumn("exc", 5), StatisticsColumn("miss", 5))
_NOT_CAPTURED = StatisticsColumn("n/cap", 5, 4)
_OF_MISSING = (StatisticsColumn("late", 5), StatisticsColumn("crc", 5, 5))
"""How many answers came late, and how many of the missing ones came with a wrong CRC or LRC."""
_COUNTS = (StatisticsColumn("asked", 8), StatisticsColumn("/s", 6))
_POLLS = (
    StatisticsColumn("asked", 7),
    StatisticsColumn("every s", 7),
    StatisticsColumn("+-ms", 5, 1),
    *_LATENCY,
    StatisticsColumn("exc", 4),
    StatisticsColumn("miss", 4),
)
_LINE = StatisticsColumn("line", 6, 4)
_CONNECTIONS = (
    StatisticsColumn("opened", 7),
    StatisticsColumn("joined", 6, 2),
    StatisticsColumn("reset", 6),
    StatisticsColumn("refused", 7),
    StatisticsColumn("most open", 9, 1),
    StatisticsColumn("keep-alive", 10),
)


def statistics_lines(
    judgement: Judgement,
    *,
    width: int | None,
    height: int | None = None,
    top: int | None = None,
    option: str = "--top",
) -> list[StyledLine]:
    """Return all lines of the statistics, for a terminal or a pipe.

    `width` and `height` are the terminal's in characters, None on a pipe. Without `top`, a section
    has as many rows as fit the height, FEWEST to USUAL. `option` is what the user types to
    set `top`; empty if that is not possible.
    """
    if top is not None or height is None:
        return _joined(_sections(judgement, width, top or USUAL), (), width, option)
    for fewer in range(USUAL, FEWEST, -1):
        lines = _joined(_sections(judgement, width, fewer), (), width, option)
        if len(lines) < height:
            return lines
    sections = _sections(judgement, width, FEWEST)
    left_out: list[str] = []
    while (
        len(lines := _joined(sections, left_out, width, option)) >= height
        and len(sections) > MOST_IMPORTANT
    ):
        left_out.insert(0, sections.pop()[0])
    return lines


def _joined(
    sections: Sequence[tuple[str, list[StyledLine]]],
    left_out: Sequence[str],
    width: int | None,
    option: str,
) -> list[StyledLine]:
    """Return the lines of all sections, then a line that names what had no room, if anything.

    `sections` are pairs of name and lines. `left_out` names the sections that had no room; the
    lines themselves name the columns that had none. `width` is the terminal's, None on a pipe.
    `option` is the one that sets the number of rows.
    """
    lines: list[StyledLine] = []
    for _, section in sections:
        section = [_hinted(line, option) for line in section]
        lines += [StyledLine(""), *section] if lines else section
    told = [f"{', '.join(left_out)} ({option} {USUAL})"] if left_out else []
    if columns := dict.fromkeys(title for line in lines for title in line.without):
        told.append(f"{plural(len(columns), 'column')} {', '.join(columns)} (a wider terminal)")
    text = f"left out: {'; '.join(told)}"
    return [*lines, *(wrapped(StyledLine(text, "dim"), width) if told else ())]


def _hinted(line: StyledLine, option: str) -> StyledLine:
    """Return a line on rows that are left out with the `option` that shows them."""
    if not line.hint or not option:
        return line
    return replace(line, text=f"{line.text}; {option} {line.hint}", hint="")


def _sections(
    judgement: Judgement, width: int | None, top: int
) -> list[tuple[str, list[StyledLine]]]:
    """Return name and lines of each section that has lines, the most important section first.

    `width` is the terminal's in characters, None on a pipe. `top` limits the rows of a section.
    """
    links = judgement.links
    sections = [
        ("verdict", [line for one in summary_lines(judgement) for line in wrapped(one, width)]),
        ("line", _load(links, width)),
        ("links", _links(links, width, top)),
        ("polls", _polls(links, width, top)),
        ("poll cycles", cycle_lines(links, width, top)),
        ("functions", _functions(links, width, top)),
        ("hours", _hours(links, top)),
        ("connections", _connections(links, width, top)),
        ("histogram", _histogram(links)),
    ]
    return [one for one in sections if one[1]]


def _links(links: Sequence[LinkReport], width: int | None, top: int) -> list[StyledLine]:
    if len(links) < 2:
        return []
    ordered = sorted(links, key=lambda one: (-one.tally.not_in_time, -one.tally.transactions))
    missing = _missing_columns([one.tally for one in links])
    rows = [
        StatisticsRow(
            f"{one.transport} {one.name or 'other links'} {one.settings or ''}".rstrip(),
            _tally_cells(one.tally, one, with_missing=bool(missing)),
            _style(one.tally),
        )
        for one in ordered[:top]
    ]
    columns = (*_COUNTS, *_FAILED, *missing, _NOT_CAPTURED, *_LATENCY)
    lines = table_lines("link", columns, rows, width)
    return lines + more_line(len(links), top, "links")


def _functions(links: Sequence[LinkReport], width: int | None, top: int) -> list[StyledLine]:
    found = [(link, one) for link in links for one in link.functions]
    if len(found) < 2 or len(found) > _ALIKE * sum(len(link.polls) for link in links):
        return []  # This section would nearly repeat the section of polls.
    found.sort(key=lambda one: (-one[1].tally.not_in_time, -one[1].tally.transactions))
    missing = _missing_columns([one.tally for _, one in found])
    rows = [
        StatisticsRow(
            _prefix(link, links) + _function_text(one),
            _tally_cells(one.tally, link, with_missing=bool(missing)),
            _style(one.tally),
        )
        for link, one in found[:top]
    ]
    columns = (*_COUNTS, *_FAILED, *missing, _NOT_CAPTURED, *_LATENCY)
    lines = table_lines("unit, function", columns, rows, width)
    return lines + more_line(len(found), top, "functions")


def _function_text(one: FunctionReport) -> str:
    if one.unit == OTHER_UNITS:
        return "other units"
    return f"{one.unit} {one.function:02X} {short_name(one.function, one.function_name)}"


def _polls(links: Sequence[LinkReport], width: int | None, top: int) -> list[StyledLine]:
    found = [(link, one) for link in links for one in link.polls]
    found.sort(key=lambda one: _failures_sort_key(one[1].poll.tally))
    missing = _missing_columns([one.poll.tally for _, one in found])
    rows = [
        StatisticsRow(
            _master_prefix(link, one) + _prefix(link, links) + poll_text(one.poll),
            _poll_cells(one, link, with_missing=bool(missing)),
            _style(one.poll.tally),
        )
        for link, one in found[:top]
    ]
    if not rows:
        return []
    with_line = any(link.load is not None for link in links)
    columns = (*_POLLS, *missing, *((_LINE,) if with_line else ()))
    has_failed = _count_failed(found[0][1].poll.tally) > 0
    title = "polls: failed, slowest" if has_failed else "polls, slowest first"
    lines = table_lines(title, columns, rows, width)
    return lines + more_line(len(found), top, "polls")


def _failures_sort_key(tally: RequestTally) -> tuple[int, int]:
    """Return the sort key of a poll: those that failed most first, then the slowest."""
    return -_count_failed(tally), -tally.latency.percentile(95)


def _count_failed(tally: RequestTally) -> int:
    return tally.count(Outcome.EXCEPTION) + tally.count(Outcome.MALFORMED) + tally.not_in_time


def _master_prefix(link: LinkReport, one: PollReport) -> str:
    return f"{one.poll.key.master}: " if len(link.masters) > 1 else ""


def _poll_cells(one: PollReport, link: LinkReport, *, with_missing: bool) -> list[str]:
    poll = one.poll
    is_regular = poll.has_regular_period
    jitter_ns = poll.jitter_ns if is_regular and poll.period.count > 1 else None
    every = "varies" if poll.period.count else "-"
    share = ""
    if link.load is not None and one.line_time is not None:
        share = percent(link.load.share_of_time(one.line_time.total_ns))
    return [
        f"{poll.tally.requests:,}",
        in_s(poll.period.percentile(50)) if is_regular else every,
        "-" if jitter_ns is None else in_ms(jitter_ns),
        *_latency_cells(poll.tally),
        counted(poll.tally.count(Outcome.EXCEPTION)),
        counted(poll.tally.unanswered),
        *(_missing_cells(poll.tally) if with_missing else ()),
        share,
    ]


def _missing_columns(tallies: Iterable[RequestTally]) -> tuple[StatisticsColumn, ...]:
    """Return the columns that tell late and damaged answers apart, if there are any."""
    is_any = any(one.damaged or one.count(Outcome.LATE) for one in tallies)
    return _OF_MISSING if is_any else ()


def _missing_cells(tally: RequestTally) -> list[str]:
    return [counted(tally.count(Outcome.LATE)), counted(tally.damaged)]


def _tally_cells(tally: RequestTally, link: LinkReport, *, with_missing: bool) -> list[str]:
    return [
        f"{tally.requests:,}",
        per_second(link.rate(tally.requests)),
        counted(tally.count(Outcome.EXCEPTION)),
        counted(tally.unanswered),
        *(_missing_cells(tally) if with_missing else ()),
        counted(tally.count(Outcome.NOT_CAPTURED)),
        *_latency_cells(tally),
    ]


def _latency_cells(tally: RequestTally) -> list[str]:
    latency = tally.latency
    if not latency.count:
        return ["-"] * len(_LATENCY)
    return [*(in_ms(latency.percentile(one)) for one in PERCENTILES), in_ms(latency.greatest)]


def _style(tally: RequestTally) -> str:
    return "red" if tally.not_in_time or tally.count(Outcome.EXCEPTION) else ""


def _prefix(link: LinkReport, links: Sequence[LinkReport]) -> str:
    return "" if len(links) == 1 else f"{link.name} "


def _load(links: Sequence[LinkReport], width: int | None) -> list[StyledLine]:
    lines = []
    for link in links:
        load = link.load
        if load is None:
            continue
        parts = [f"busy {percent(load.busy_share)}"]
        parts.append(f"waits for slaves {percent(load.share_of_time(load.spent.slaves_ns))}")
        if load.spent.missing_ns:
            parts.append(
                f"for missing answers {percent(load.share_of_time(load.spent.missing_ns))}"
            )
        parts.append(f"free {percent(load.share_of_time(load.pauses_ns))}")
        text = f"{_prefix(link, links)}line: {', '.join(parts)}"
        lines += wrapped(StyledLine(text), width)
        lines += _longest_polls(link, width)
    return lines


def _longest_polls(link: LinkReport, width: int | None) -> list[StyledLine]:
    """Return a line on the polls (repeated requests) whose frames occupy the serial line longest.

    Returns no line for a network, or with fewer than two polls. Polls that do not fit the
    terminal are left out.
    """
    load = link.load
    if load is None or len(link.polls) < 2:
        return []
    found = [(one.line_time.total_ns, one.poll) for one in link.polls if one.line_time is not None]
    found.sort(key=lambda one: -one[0])
    texts = [f"{poll_text(poll)} {percent(load.share_of_time(ns))}" for ns, poll in found[:_EATERS]]
    text, *others = texts
    text = f"  kept most by {text}"
    for other in others:
        if width is not None and len(text) + len(other) + 2 > width:
            break
        text = f"{text}; {other}"
    return [StyledLine(shorten(text, width))]


def _histogram(links: Sequence[LinkReport]) -> list[StyledLine]:
    latency = merged([link.tally for link in links]).latency
    if latency.count < LEAST_OF_HISTOGRAM:
        return []
    buckets = _joined_below(_FINEST_NS, latency.histogram())
    most = max(one.number for one in buckets)
    lines = [StyledLine("latency of all", "bold")]
    for one in buckets:
        bar = "#" * -(-one.number * _BAR // most)
        lines.append(StyledLine(f"  < {duration(one.high_ns):<8} {one.number:>9,} {bar}".rstrip()))
    return lines


def _joined_below(finest_ns: int, buckets: list[Bucket]) -> list[Bucket]:
    """Return the buckets, with all whose upper bound is at most `finest_ns` joined into one.

    A bucket has the number of latencies between its bounds in ns.
    """
    below = sum(one.number for one in buckets if one.high_ns <= finest_ns)
    first = [Bucket(0, finest_ns, below)] if below else []
    return [*first, *(one for one in buckets if one.high_ns > finest_ns)]


def _hours(links: Sequence[LinkReport], top: int) -> list[StyledLine]:
    counts: dict[int, tuple[int, int]] = {}
    for link in links:
        for one in link.hours:
            requests, missing = counts.get(one.begin_ns, (0, 0))
            counts[one.begin_ns] = requests + one.requests, missing + one.missing
    missing_in = [(begin, *both) for begin, both in sorted(counts.items()) if both[1]]
    if len(counts) < 2 or not missing_in:
        return []
    worst = sorted(sorted(missing_in, key=lambda one: -one[2])[:top])
    lines = [StyledLine("answers missing, by hour (UTC)", "bold")]
    for begin_ns, requests, missing in worst:
        text = f"  {day(begin_ns)} {clock_time(begin_ns)[:5]} {missing:>9,} of {requests:,}"
        lines.append(StyledLine(text))
    return lines + more_line(len(missing_in), top, "hours")


def _connections(links: Sequence[LinkReport], width: int | None, top: int) -> list[StyledLine]:
    found = [(link, master, one) for link in links for master, one in link.connections]
    found.sort(key=lambda one: (-one[2].resets - one[2].refused, -one[2].opened))
    rows = []
    for link, master, one in found[:top]:
        alive = counted(one.keep_alives)
        if one.unanswered_keep_alives:
            alive = f"{alive} (-{one.unanswered_keep_alives})"
        cells = [
            f"{one.opened:,}",
            counted(one.joined),
            counted(one.resets),
            counted(one.refused),
            counted(one.most_at_once),
            alive,
        ]
        style = "yellow" if one.resets or one.refused else ""
        rows.append(StatisticsRow(f"{master or '?'} to {link.name}", cells, style))
    if not any(_is_notable(one) for _, _, one in found):
        return []
    lines = table_lines("connections", _CONNECTIONS, rows, width)
    return lines + more_line(len(found), top, "pairs")


def _is_notable(one: ConnectionTally) -> bool:
    """False for a single connection that stayed open, without resets or keep-alive probes."""
    return bool(one.resets or one.refused or one.keep_alives or one.opened + one.joined > 1)
