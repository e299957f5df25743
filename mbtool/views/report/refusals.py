"""Says which requests units refuse, with which exception codes, and if it looks like a scan."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core.wording import counted
from mbtool.modbus import Outcome
from mbtool.overview.failure_limits import MANY_REFUSING
from mbtool.overview.request_tally import RequestTally, merged
from mbtool.views.report.troubles import Rank, VerdictTrouble
from mbtool.views.statistics_verdict import exception_text
from mbtool.views.statistics_words import request_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.overview.poll_statistics import PollStatistics
    from mbtool.series.history import UnitRow

_NAMED = 2
"""At most so many requests of a unit that it always refuses are named."""
_SCAN = 20
"""At least so many different requests, few of them sent twice, are called a scan."""
_ONCE = 0.9
"""A scan sends at least this share (0 to 1) of its requests once."""


def refused_polls(polls: Sequence[PollStatistics], tally: RequestTally) -> str:
    """Return which requests a unit refuses each time, as text: `always refuses 03 holding 4 (3
    times)`.

    `tally` has the counts of the unit, `polls` those of its polls that are still known. The text is
    empty if some are no longer known, if other refusals remain, or if the unit refuses all that it
    is asked.
    """
    if not _are_all(polls, tally):
        return ""
    refused = [poll for poll in polls if poll.tally.count(Outcome.EXCEPTION)]
    number = sum(poll.tally.count(Outcome.EXCEPTION) for poll in refused)
    if len(refused) == len(polls) or number < sum(poll.tally.transactions for poll in refused):
        return ""
    often = sorted(refused, key=lambda poll: -poll.tally.transactions)
    verb = "refuses" if number == len(refused) else "always refuses"
    if len(often) <= _NAMED:
        named = " and ".join(map(request_text, often))
        times = counted(number, "time", ",") if number > 1 else "once"
        return f"{verb} {named} ({times})"
    example = request_text(often[0])
    return f"{verb} {len(often):,} of its {len(polls):,} different requests, such as {example},"


def codes_text(tally: RequestTally) -> str:
    """Return the exception code of most refusals in words, or the two most frequent codes."""
    total = sum(tally.exceptions.values())
    if not total:
        return "with unknown codes"  # Only a log that another program wrote lacks them.
    often = sorted(tally.exceptions, key=lambda one: -tally.exceptions[one])
    first, *others = (exception_text(code, tally.exception_names[code]) for code in often)
    if not others:
        return f"with {first}"
    if tally.exceptions[often[0]] * 2 > total:
        return f"mostly with {first}"
    return f"with {first}{f', {others[0]} or others' if len(others) > 1 else f' or {others[0]}'}"


def joined_refusals(
    troubles: list[VerdictTrouble],
    tallies: Mapping[UnitRow, RequestTally],
    polls: Mapping[UnitRow, Sequence[PollStatistics]],
) -> list[VerdictTrouble]:
    """Join the refusals of many units into one trouble: the requests are wrong, not the units.

    `tallies` has the counts of all units, `polls` the polls of each that are still known.
    """
    refusing = [one for one in troubles if _is_grave_refusal(one)]
    if len(refusing) < MANY_REFUSING or len(refusing) * 2 < len(tallies):
        return troubles
    rows = frozenset(unit for one in refusing for unit in one.units)
    every = len(refusing) == len(tallies)
    some = f"all {len(tallies)}" if every else f"{len(refusing)} of {len(tallies)}"
    what = _what(
        merged([tallies[row] for row in rows]),
        [poll for row in rows for poll in polls.get(row, ())],
    )
    text = f"{some} units refuse {what}"
    joined = replace(refusing[0], text=text, who="these units", search="exception", units=rows)
    place = troubles.index(refusing[0])
    others = [one for one in troubles if not _is_grave_refusal(one)]
    return [*others[:place], joined, *others[place:]]


def _is_grave_refusal(trouble: VerdictTrouble) -> bool:
    return trouble.is_refusal and trouble.rank is Rank.FAILING


def _are_all(polls: Sequence[PollStatistics], tally: RequestTally) -> bool:
    """False if some of the requests of `tally` are of polls that are no longer known."""
    return sum(poll.tally.requests for poll in polls) >= tally.requests


def _what(tally: RequestTally, polls: Sequence[PollStatistics]) -> str:
    refused, asked = tally.count(Outcome.EXCEPTION), tally.requests
    share = f"all their requests ({asked:,})"
    if refused < asked:
        share = f"{refused:,} of their {counted(asked, 'request', ',')}"
    if not _are_all(polls, tally) or len(polls) < max(_SCAN, _ONCE * asked):
        return f"{share}, {codes_text(tally)}"
    masters = {poll.key.master for poll in polls} - {""}
    by = f" by {next(iter(masters))}" if len(masters) == 1 else ""
    return f"{share}, {codes_text(tally)}: {len(polls):,} different ones, as in a scan{by}"
