"""Writes the first lines of statistics: a summary, and the most frequent failures."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from mbtool.core.wording import counted, plural
from mbtool.modbus import Outcome
from mbtool.overview.request_tally import RequestTally, merged
from mbtool.views.statistics_columns import StyledLine
from mbtool.views.statistics_words import duration, in_ms, per_second, percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.overview.statistics_report import LinkReport

_BAD, _DOUBT = "red", "yellow"
_MOST_UNITS = 3
_SLOW = 3
"""A unit is called slow if its median latency is at least this many times the median of all
units."""
_FEWEST_LATENCIES = 5
"""A unit with fewer responses than this is never called slow: one late response would decide its
median."""


def verdict(links: Sequence[LinkReport]) -> list[StyledLine]:
    """Return a line that sums up, then a line for each kind of failure.

    Failures are missing responses, exceptions, malformed and unsolicited responses, TCP resets, and
    a slow unit.
    """
    total = merged([link.tally for link in links])
    if not total.transactions:
        return [StyledLine("no transactions so far", "bold")]
    lines = [StyledLine(_sum(links, total), "bold")]
    if not all(link.has_times for link in links):
        text = "! no times: the bytes of the file have none, so there are no rates and periods"
        lines.append(StyledLine(text, _DOUBT))
    lines += _missing(links, total)
    lines += _exceptions(total)
    lines += _odd(total)
    lines += _resets(links)
    lines += _slow(links, total)
    return lines


def _sum(links: Sequence[LinkReport], total: RequestTally) -> str:
    watched_ns = max((link.watched_ns for link in links), default=0)
    units = {(link.name, one.unit): one.device for link in links for one in link.functions}
    rate = per_second(total.requests * 1e9 / watched_ns if watched_ns else None)
    time = f" in {duration(watched_ns)} ({rate}/s)" if watched_ns else ""
    where = f"{counted(len(links), 'link', ',')}, {counted(len(units), 'unit', ',')}"
    if len(links) == 1:
        one = links[0]
        settings = f" {one.settings}" if one.settings else ""
        of = counted(len(units), "unit", ",")
        if len(units) == 1:
            ((_, unit), device) = next(iter(units.items()))
            of = f"unit {unit} {device or ''}".rstrip()
        where = f"{one.transport} {one.name}{settings}, {of}"
    return f"{where}: {counted(total.requests, 'request', ',')}{time}, {_answered(total)}"


def _answered(total: RequestTally) -> str:
    """Return the share of requests that were answered as text, such as `98 % answered`.

    Broadcasts, and requests whose outcome the capture does not show, are not counted.
    """
    answers = sum(total.count(one) for one in (Outcome.OK, Outcome.EXCEPTION, Outcome.MALFORMED))
    asked = answers + total.unanswered
    return f"{percent(answers / asked)} answered" if asked else "no request to be answered"


def _missing(links: Sequence[LinkReport], total: RequestTally) -> list[StyledLine]:
    if not total.unanswered:
        return []
    dead: list[str] = []
    some: Counter[str] = Counter()
    damaged: set[str] = set()
    for link in links:
        for unit in dict.fromkeys(one.unit for one in link.functions):
            tally = merged([one.tally for one in link.functions if one.unit == unit])
            if tally.unanswered:
                name = f"unit {unit}" if len(links) == 1 else f"{link.name} unit {unit}"
                some[name] += tally.unanswered
                if is_damaged := tally.damaged * 2 > tally.unanswered:
                    damaged.add(name)
                if tally.unanswered == tally.transactions and not is_damaged:
                    dead.append(name)
    lines = [StyledLine(f"! {_listed(dead)} never answered", _BAD)] if dead else []
    share = sum(link.load.spent.missing_ns for link in links if link.load is not None)
    watched = sum(link.watched_ns for link in links if link.load is not None)
    cost = f"; waiting took {percent(share / watched)} of the time" if share and watched else ""
    worst = ", ".join(
        f"{count:,} of {name}{' with a wrong CRC' if name in damaged else ''}"
        for name, count in some.most_common(_MOST_UNITS)
    )
    more = f" and {len(some) - _MOST_UNITS} more" if len(some) > _MOST_UNITS else ""
    repeated = sum(one.poll.repetitions for link in links for one in link.polls)
    again = f"; {repeated:,} asked again at once" if repeated else ""
    number = total.unanswered
    text = f"! {counted(number, 'answer', ',')} missing: {worst}{more}{again}{cost}"
    return [*lines, StyledLine(text, _BAD)]


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_UNITS} more" if len(names) > _MOST_UNITS else ""
    return ", ".join(names[:_MOST_UNITS]) + more


def _exceptions(total: RequestTally) -> list[StyledLine]:
    number = sum(total.exceptions.values())
    if not number:
        return []
    by_count = sorted(total.exceptions.items(), key=lambda one: -one[1])
    codes = ", ".join(
        f"{count:,} x {exception_text(code, total.exception_names[code])}"
        for code, count in by_count[:_MOST_UNITS]
    )
    rest = len(by_count) - _MOST_UNITS
    more = f" and {counted(rest, 'more code')}" if rest > 0 else ""
    return [StyledLine(f"! {counted(number, 'exception', ',')}: {codes}{more}", _BAD)]


def exception_text(code: int, name: str) -> str:
    """Return code and name, such as `02 illegal data address`.

    The name of an unknown code has the number in it, so the name alone is returned.
    """
    return name if name.startswith("exception") else f"{code:02X} {name}".rstrip()


def _odd(total: RequestTally) -> list[StyledLine]:
    lines = []
    malformed, unsolicited = total.count(Outcome.MALFORMED), total.count(Outcome.UNSOLICITED)
    lacking = total.count(Outcome.NOT_CAPTURED)
    if malformed:
        lines.append(StyledLine(f"! {counted(malformed, 'answer', ',')} malformed", _BAD))
    if unsolicited:
        text = f"! {counted(unsolicited, 'answer', ',')} that nobody asked for"
        if total.unsolicited_exceptions:
            text = f"{text}, {total.unsolicited_exceptions:,} of them with an exception"
        lines.append(StyledLine(text, _DOUBT))
    if lacking:
        text = f"! {lacking:,} not captured whole: the capture's loss, not a device's fault"
        lines.append(StyledLine(text, _DOUBT))
    return lines


def _resets(links: Sequence[LinkReport]) -> list[StyledLine]:
    resets = sum(one.resets for link in links for _, one in link.connections)
    refused = sum(one.refused for link in links for _, one in link.connections)
    parts = [f"{resets:,} reset"] if resets else []
    parts += [f"{refused:,} refused"] if refused else []
    if not parts:
        return []
    word = plural(resets + refused, "connection")
    return [StyledLine(f"! {word}: {', '.join(parts)}", _DOUBT)]


def _slow(links: Sequence[LinkReport], total: RequestTally) -> list[StyledLine]:
    """Return a line on the unit with the greatest median latency if it is far above the others.

    That means at least _SLOW times the median of all units.
    """
    usual = total.latency.percentile(50)
    slowest: tuple[int, str] = (0, "")
    for link in links:
        for unit in dict.fromkeys(one.unit for one in link.functions):
            latency = merged([one.tally for one in link.functions if one.unit == unit]).latency
            if latency.count < _FEWEST_LATENCIES:
                continue
            name = f"unit {unit}" if len(links) == 1 else f"{link.name} unit {unit}"
            slowest = max(slowest, (latency.percentile(50), name))
    if not usual or slowest[0] < _SLOW * usual:
        return []
    text = f"! {slowest[1]} is slow: p50 {in_ms(slowest[0])} ms, of all {in_ms(usual)} ms"
    return [StyledLine(text, _DOUBT)]
