"""Writes troubles (the room troubles): as lines of text, as JSON, and as rows of the report."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from mbtool.core.wording import counted
from mbtool.devices.checking.rules import Severity
from mbtool.views.statistics_columns import StyledLine
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.troubles.judge import Judgement
    from mbtool.troubles.trouble import Evidence, Trouble

MOST = 5
"""A text shows at most so many troubles, the worst ones, and says how many more there are."""
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


def watch_text(judgement: Judgement, width: int) -> tuple[str, str]:
    """Return one line of at most `width` characters on the worst troubles, and its style; an empty
    line if there is none.

    The worst one stands there with its remedy if there is room, and is never left out. The key 5
    opens the table of slaves, which has all.
    """
    troubles = judgement.troubles
    if not troubles:
        return "", ""

    def line(parts: Sequence[str]) -> str:
        left = len(troubles) - len(parts)
        return "; ".join([*parts, *([f"{left} more: key 5"] if left else [])])

    texts = [trouble_text(one) for one in troubles]
    causes = [printable(one.cause) for one in troubles]
    lines = [line(some) for some in (texts, causes)]
    lines += [line(causes[:number]) for number in range(len(causes) - 1, 1, -1)]
    lines += [line(texts[:1]), line(causes[:1])]
    fitting = (text for text in lines if len(text) <= width)
    style = "bold red" if troubles[0].severity is Severity.ERROR else "yellow"
    return next(fitting, lines[-1]), style
