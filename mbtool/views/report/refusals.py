"""Says which requests units refuse, with which exception codes, and if it looks like a scan."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core.wording import counted
from mbtool.modbus import Outcome
from mbtool.troubles.refusals import always_refused, joint_refusals
from mbtool.views.report.troubles import Rank, VerdictTrouble
from mbtool.views.statistics_words import request_text
from mbtool.views.trouble_words import codes_text, joint_refusals_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.ledger.history import UnitRow
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.request_tally import RequestTally

_NAMED = 2
"""At most so many requests of a unit that it always refuses are named."""


def refused_polls(polls: Sequence[PollStatistics], tally: RequestTally) -> str:
    """Return which requests a unit refuses each time, as text: `always refuses 03 holding 4 (3
    times)`.

    `tally` has the counts of the unit, `polls` those of its polls that are still known. The text is
    empty if the unit also refuses other requests, or all that it is asked.
    """
    refused = always_refused(polls, tally)
    if not refused:
        return ""
    number = tally.count(Outcome.EXCEPTION)
    often = sorted(refused, key=lambda poll: -poll.tally.transactions)
    verb = "refuses" if number == len(refused) else "always refuses"
    if len(often) <= _NAMED:
        named = " and ".join(map(request_text, often))
        times = counted(number, "time", ",") if number > 1 else "once"
        return f"{verb} {named} ({times})"
    example = request_text(often[0])
    return f"{verb} {len(often):,} of its {len(polls):,} different requests, such as {example},"


def joined_refusals(
    troubles: list[VerdictTrouble],
    tallies: Mapping[UnitRow, RequestTally],
    polls: Mapping[UnitRow, Sequence[PollStatistics]],
) -> list[VerdictTrouble]:
    """Join the refusals of many units into one trouble: the requests are wrong, not the units.

    `tallies` has the counts of all units, `polls` the polls of each that are still known.
    """
    refusing = [one for one in troubles if _is_grave_refusal(one)]
    rows = frozenset(unit for one in refusing for unit in one.units)
    joint = joint_refusals(rows, tallies, polls)
    if joint is None:
        return troubles
    text = joint_refusals_text(joint, codes_text(joint.tally))
    joined = replace(refusing[0], text=text, who="these units", search="exception", units=rows)
    place = troubles.index(refusing[0])
    others = [one for one in troubles if not _is_grave_refusal(one)]
    return [*others[:place], joined, *others[place:]]


def _is_grave_refusal(trouble: VerdictTrouble) -> bool:
    return trouble.is_refusal and trouble.rank is Rank.FAILING
