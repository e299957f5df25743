"""Says in a few words what is wrong with a slave, for the live views."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.wording import clock_time, in_ms, percent
from mbtool.troubles.failure_limits import ENOUGH
from mbtool.troubles.slow_units import are_many
from mbtool.views.place_columns import common_network
from mbtool.views.trouble_words import (
    joined_oddities,
    joint_refusals_text,
    moment_text,
    oddities_text,
    unit_name,
    worst_stray_frames,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.troubles.failed_shares import FailedShare
    from mbtool.troubles.slower_units import Slower
    from mbtool.watching.board_judgement import BoardJudgement
    from mbtool.watching.board_rows import WatchedSlaveRow

_MORE = " more: key 5"
"""Ends the line on slaves with troubles, after the number of those that had no room in it. The key
5 opens the table of slaves."""
_MORE_ODD = " more: key 6"
"""Ends the line on odd polling likewise. The key 6 opens the statistics, which name all."""


def slave_trouble(row: WatchedSlaveRow, *, is_short: bool = False) -> str:
    """Return what is wrong with a slave, the worst first; empty if nothing is.

    With `is_short`, the text for a slow slave leaves out the median latency of the other slaves,
    or its own from before.
    """
    if row.never_answers:
        return "every answer has a wrong CRC" if row.is_damaged else "never answers"
    parts = []
    if row.silent_since_ns is not None and not row.is_damaged:
        parts.append(f"no answer since {clock_time(row.silent_since_ns)[:8]}")
    elif row.missing_share is not None:
        word = "wrong CRC" if row.is_damaged else "unanswered"
        parts.append(_share_text(row.missing_share, word, is_short=is_short))
    if _refuses_all(row):
        parts.append("refuses every request")
    elif _refuses_again(row):
        parts.append(f"always refuses {row.refused_polls} of {row.polls} polls")
    elif row.refused_share is not None:
        parts.append(_share_text(row.refused_share, "refused", is_short=is_short))
    if row.malformed:
        parts.append(f"{percent(row.malformed / (row.asked or row.malformed))} malformed")
    if row.usual_ns is not None:
        others = "" if is_short else f" (others {in_ms(row.usual_ns)})"
        parts.append(f"slow, {in_ms(row.median_ns)} ms{others}")
    elif row.slower is not None:
        parts.append(_slower_text(row.slower, is_short=is_short))
    return ", ".join(parts)


def _slower_text(slower: Slower, *, is_short: bool) -> str:
    """Return since when a slave is slower: `slower since 10:43:02, 110 ms (before 9.5)`."""
    since = _moment(slower.since_ns, is_long=slower.is_long, is_short=is_short)
    before = "" if is_short else f" (before {in_ms(slower.before_ns)})"
    return f"slower since {since}, {in_ms(slower.mean_ns)} ms{before}"


def _moment(ns: int, *, is_long: bool, is_short: bool) -> str:
    return moment_text(ns, is_long=is_long)[: 5 if is_short and not is_long else None]


def _share_text(share: FailedShare, word: str, *, is_short: bool) -> str:
    """Return which share of the requests failed, and since when: `33 % refused since 10:43`."""
    text = f"{percent(share.share)} {word}"
    since, until = (
        None if ns is None else _moment(ns, is_long=share.is_long, is_short=is_short)
        for ns in (share.since_ns, share.until_ns)
    )
    if until is None:
        return text if since is None else f"{text} since {since}"
    return f"{text} until {until}" if since is None else f"{text} {since} to {until}"


class TroubleLine(NamedTuple):
    """The line on what is wrong."""

    text: str
    """Empty if all is well."""
    is_grave: bool
    """False if all requests are answered, but some slaves are slow, or the polling is odd."""


def trouble_line(judgement: BoardJudgement, width: int) -> TroubleLine:
    """Return one line on the slaves with troubles, or, if there are none, on odd polling.

    Slaves that never answer come first. The line names as many as fit `width` characters, and
    always the worst one.
    """
    rows, refusing = judgement.slaves, judgement.refusing
    links = {row.link for row in rows}
    network = (common_network(links) or "") if len(links) > 1 else None
    slow = sum(row.usual_ns is not None for row in rows)
    told = not are_many(slow, len(rows))
    sick = [row for row in rows if row.is_failing or row.slower or (told and row.usual_ns)]
    sick.sort(key=_weight)
    joined = ""
    if refusing is not None:
        joined = joint_refusals_text(refusing)
        if len(joined) > width:
            joined = joint_refusals_text(refusing, is_short=True)
        sick = [row for row in sick if row.fails_otherwise or row.usual_ns or row.slower]
        width -= len(joined) + 2
    line = _line(sick, network, width, is_short=False)
    if _MORE in line:
        line = _line(sick, network, width, is_short=True)
    stray = worst_stray_frames(judgement.stray_frames, most=1)
    text = "; ".join(filter(None, [line, joined, *stray]))
    is_grave = bool(stray) or any(row.is_failing for row in rows)
    return TroubleLine(text or _odd_line(judgement, width), is_grave)


def _odd_line(judgement: BoardJudgement, width: int) -> str:
    """Return what is odd in the polling, the worst first; as much as fits `width` characters, and
    the worst in any case. It says how much more there is.
    """
    several = len({row.link for row in judgement.slaves}) > 1
    told = joined_oddities(judgement.odd)

    def line(number: int, *, is_short: bool) -> str:
        texts = [
            oddities_text(some, lambda unit: unit_name(unit, several=several), is_short=is_short)
            for some in told[:number]
        ]
        left = len(told) - number
        return "; ".join([*texts, f"{left}{_MORE_ODD}"] if left else texts)

    lines = [line(len(told), is_short=False)]
    lines += [line(number, is_short=True) for number in range(len(told), 0, -1)]
    return next((text for text in lines if len(text) <= width), lines[-1])


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


def _weight(row: WatchedSlaveRow) -> tuple[bool, float]:
    shares = [one.share for one in (row.missing_share, row.refused_share) if one is not None]
    return not row.never_answers, -max([*shares, row.malformed / (row.asked or 1)])
