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


def refused_polls(polls: Sequence[PollStatistics]) -> str:
    """Return which requests a unit refuses each time, as text: `always refuses 03 holding 4 (3
    times)`.

    The text is empty if other refusals remain, or if the unit refuses all that it is asked.
    """
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
    often = sorted(tally.exceptions, key=lambda one: -tally.exceptions[one])
    first, *others = (exception_text(code, tally.exception_names[code]) for code in often)
    if not others:
        return f"with {first}"
    if tally.exceptions[often[0]] * 2 > total:
        return f"mostly with {first}"
    return f"with {first}{f', {others[0]} or others' if len(others) > 1 else f' or {others[0]}'}"


def joined_refusals(
    troubles: list[VerdictTrouble], units: Mapping[UnitRow, Sequence[PollStatistics]]
) -> list[VerdictTrouble]:
    """Join the refusals of many units into one trouble: the requests are wrong, not the units.

    `units` has the polls of all units.
    """
    refusing = [one for one in troubles if one.rank is Rank.FAILING and one.is_refusal]
    if len(refusing) < MANY_REFUSING or len(refusing) * 2 < len(units):
        return troubles
    rows = frozenset(unit for one in refusing for unit in one.units)
    every = len(refusing) == len(units)
    some = f"all {len(units)}" if every else f"{len(refusing)} of {len(units)}"
    text = f"{some} units refuse {_what(units, rows)}"
    joined = replace(refusing[0], text=text, who="these units", search="exception", units=rows)
    place = troubles.index(refusing[0])
    others = [one for one in troubles if one not in refusing]
    return [*others[:place], joined, *others[place:]]


def _what(units: Mapping[UnitRow, Sequence[PollStatistics]], rows: frozenset[UnitRow]) -> str:
    polls = [poll for row in rows for poll in units.get(row, ())]
    tally = merged([poll.tally for poll in polls])
    refused, asked = tally.count(Outcome.EXCEPTION), tally.transactions
    share = f"all their requests ({asked:,})"
    if refused < asked:
        share = f"{refused:,} of their {counted(asked, 'request', ',')}"
    if len(polls) < _SCAN or len(polls) < _ONCE * asked:
        return f"{share}, {codes_text(tally)}"
    masters = {poll.key.master for poll in polls} - {""}
    by = f" by {next(iter(masters))}" if len(masters) == 1 else ""
    return f"{share}, {codes_text(tally)}: {len(polls):,} different ones, as in a scan{by}"
