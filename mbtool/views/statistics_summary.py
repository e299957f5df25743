"""Writes the first lines of statistics: a summary, what is wrong, and what the recording lacks."""

from __future__ import annotations

from collections.abc import Sequence

from mbtool.core.moments import counted, duration, percent
from mbtool.ledger.account import MAX_LINKS, MAX_USES
from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.ledger.statistics_report import LinkReport, is_counted_together
from mbtool.modbus import Outcome
from mbtool.troubles.judge import Judgement, units_text
from mbtool.views.statistics_columns import StyledLine, per_second
from mbtool.views.trouble_lines import trouble_lines

TOGETHER_TEXT = (
    f"there are more than {MAX_LINKS:,} links or units, or {MAX_USES:,} functions of units: "
    "others are counted together, and figures of single units may be too small"
)
_DOUBT = "yellow"


def summary_lines(judgement: Judgement) -> list[StyledLine]:
    """Return a line that sums up, then a line for each of the worst troubles, then remarks on what
    the recording lacks.
    """
    links = judgement.links
    total = merged([link.tally for link in links])
    if not total.transactions:
        return [StyledLine("no transactions so far", "bold"), *_lines_without_requests(judgement)]
    lines = [StyledLine(_sum(links, total), "bold"), *trouble_lines(judgement)]
    if not all(link.has_times for link in links):
        text = "no times: the bytes of the file have none, so there are no rates and periods"
        lines.append(StyledLine(text, _DOUBT))
    if is_counted_together(links):
        lines.append(StyledLine(TOGETHER_TEXT, _DOUBT))
    if alone := total.count(Outcome.UNSOLICITED):
        text = f"{counted(alone, 'answer', ',')} without a request, not counted above"
        lines.append(StyledLine(text, _DOUBT))
    if lacking := total.count(Outcome.NOT_CAPTURED):
        text = f"{lacking:,} not captured whole: the capture's loss, not a device's fault"
        lines.append(StyledLine(text, _DOUBT))
    share = sum(link.load.spent.missing_ns for link in links if link.load is not None)
    watched = sum(link.watched_ns for link in links if link.load is not None)
    if share and watched:
        text = f"waiting for missing answers took {percent(share / watched)} of the line's time"
        lines.append(StyledLine(text, _DOUBT))
    return lines


def _lines_without_requests(judgement: Judgement) -> list[StyledLine]:
    return trouble_lines(judgement) if judgement.troubles else []


def _sum(links: Sequence[LinkReport], total: RequestTally) -> str:
    watched_ns = links[0].all_watched_ns
    units = {(link.name, one.unit): one.device for link in links for one in link.functions}
    of = units_text(units)
    rate = per_second(total.requests * 1e9 / watched_ns if watched_ns else None)
    time = f" in {duration(watched_ns)} ({rate}/s)" if watched_ns else ""
    where = f"{counted(len(links), 'link', ',')}, {of}"
    if len(links) == 1:
        one = links[0]
        settings = f" {one.settings}" if one.settings else ""
        if len(units) == 1:
            ((_, unit), device) = next(iter(units.items()))
            of = f"unit {unit} {device or ''}".rstrip()
        where = f"{one.transport} {one.name}{settings}, {of}"
    return f"{where}: {counted(total.requests, 'request', ',')}{time}, {_answered_text(total)}"


def _answered_text(total: RequestTally) -> str:
    """Return the share of requests that were answered as text, such as `98 % answered`.

    Broadcasts, and requests whose outcome the capture does not show, are not counted.
    """
    answers = sum(total.count(one) for one in (Outcome.OK, Outcome.EXCEPTION, Outcome.MALFORMED))
    late, asked = total.count(Outcome.LATE), answers + total.not_in_time
    if not asked:
        return "no request to be answered"
    text = f"{percent(answers / asked)} answered"
    if late:
        text = f"{text}, {percent(late / asked)} late"
    if total.ambiguous:
        text = f"{text}, {percent(total.ambiguous / total.transactions)} ambiguous"
    return text
