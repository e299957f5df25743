"""Writes troubles as lines of text, as JSON, and as rows of the report."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import product
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from mbtool.core.moments import counted
from mbtool.devices.checking.rules import Severity
from mbtool.views.statistics_columns import StyledLine
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from mbtool.troubles.judge import Judgement
    from mbtool.troubles.trouble import Evidence, Trouble

WATCH_LINES = 3
_NARROWEST = 20
MOST = 5
"""A text shows at most this many troubles, the worst ones, and says how many more there are."""
STYLES = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.NOTE: "cyan"}
_LEVELS = {"well": "green", "doubt": "yellow", "bad": "red"}


def trouble_text(trouble: Trouble) -> str:
    """Return cause, remedy and code: `unit 2 answers after ...: raise the time-out (LINE-LATE)`."""
    code = "" if f"({trouble.code}" in trouble.cause else f" ({trouble.code})"
    return printable(f"{trouble.sentence}{code}")


def trouble_lines(judgement: Judgement, most: int = MOST) -> list[StyledLine]:
    """Return a line for each of the worst troubles; or one that says that all is well, or that too
    little was heard to say so.
    """
    troubles = judgement.troubles
    if not troubles:
        return [StyledLine(judgement.summary, _LEVELS[judgement.level])]
    lines = [StyledLine(f"! {trouble_text(one)}", STYLES[one.severity]) for one in troubles[:most]]
    more = len(troubles) - most
    if more > 0:
        text = f"! and {counted(more, 'more trouble', ',')}: mbtool report shows all"
        lines.append(StyledLine(text, "yellow"))
    return lines


def trouble_documents(judgement: Judgement) -> dict[str, Any]:
    """Return the keys `level` and `troubles` of a JSON document."""
    return {
        "level": judgement.level,
        "troubles": [trouble_document(one) for one in judgement.troubles],
    }


def trouble_document(one: Trouble) -> dict[str, Any]:
    """Return a trouble as JSON data, with the list of those that have it."""
    return {
        "code": one.code,
        "severity": one.severity.value,
        "link": one.link,
        "unit": one.unit,
        "master": one.master or None,
        "count": one.count,
        "of": one.of or None,
        "since_ns": one.since_ns,
        "until_ns": one.until_ns,
        "cause": one.cause,
        "remedy": one.remedy,
        "sureness": one.sureness.value,
        "evidence": [_evidence(each) for each in one.evidence],
        "others": [trouble_document(each) for each in one.others],
    }


def _evidence(one: Evidence) -> dict[str, Any]:
    fields = {
        "ts_ns": one.ts_ns,
        "time": utc_text(one.ts_ns),
        "text": one.text,
        "file": one.file,
        "packets": list(one.packets),
        "offsets": list(one.offsets),
    }
    return {key: value for key, value in fields.items() if value}


def utc_text(ts_ns: int) -> str | None:
    """Write a time in UTC, with microseconds; None outside the years 1 to 9999."""
    seconds, ns = divmod(ts_ns, 1_000_000_000)
    try:
        time = datetime.fromtimestamp(seconds, UTC).replace(microsecond=ns // 1000)
    except (ValueError, OverflowError, OSError):
        return None
    return time.isoformat().replace("+00:00", "Z")


def watch_text(judgement: Judgement, width: int) -> tuple[list[str], str]:
    """Return the worst trouble with its remedy, and the others in a few words each, as at most
    WATCH_LINES lines of `width` characters, and their style; no lines if there is none.

    If there is no room, the last ones of the others are left out, and the last line says how many;
    then the cause of the worst one is shortened, and only then its remedy is left out.
    """
    troubles = judgement.troubles
    if not troubles:
        return [], ""
    worst, others = troubles[0], [_few_words(one) for one in troubles[1:]]
    short = printable(f"{_few_words(worst)}: {worst.remedy}")
    for text, named in product(
        (trouble_text(worst), short, printable(worst.cause)), range(len(others), -1, -1)
    ):
        whole = f"{text}{_also(others, named)}"
        lines = wrap(whole, max(width, _NARROWEST), break_on_hyphens=False)
        if len(lines) <= WATCH_LINES:
            break
    style = "bold red" if worst.severity is Severity.ERROR else "yellow"
    return lines[:WATCH_LINES], style


def _few_words(one: Trouble) -> str:
    more = f" and {len(one.others)} more" if one.others else ""
    return printable(f"{one.who}{more} {one.short}")


def _also(others: Sequence[str], named: int) -> str:
    """Return the first `named` of the other troubles, and how many more there are."""
    also = f"; also: {', '.join(others[:named])}" if named else ""
    left = len(others) - named
    return f"{also}; {left} more: key 6" if left else also
