"""Judges the requests that units refuse: which ones, by how many units, and if in a scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from mbtool.ledger.request_tally import RequestTally, merged
from mbtool.modbus import Outcome

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from mbtool.ledger.poll_statistics import PollStatistics

K = TypeVar("K")

MANY_REFUSING = 4
"""If at least this many units, and half of all, refuse requests, one trouble reports all: the
requests are wrong, not the units."""
SCAN = 20
"""At least so many different requests, few of them sent twice, are called a scan."""
ONCE = 0.9
"""A scan sends at least this share (0 to 1) of its requests once."""


@dataclass(frozen=True, slots=True)
class JointRefusals:
    """Many units that refuse requests."""

    units: int
    of: int
    """The number of all units."""
    tally: RequestTally
    """The counts of the units that refuse."""
    scanned: int
    """The number of different requests if they look like a scan, else 0."""
    master: str
    """The host that scans; empty if it is not known, or if there are several."""


def joint_refusals(
    refusing: Collection[K],
    tallies: Mapping[K, RequestTally],
    polls: Mapping[K, Sequence[PollStatistics]],
) -> JointRefusals | None:
    """Return the refusals of the units `refusing` as one trouble; None if these are not many.

    `tallies` has the counts of all units, `polls` the polls of each that are still known.
    """
    if len(refusing) < MANY_REFUSING or len(refusing) * 2 < len(tallies):
        return None
    tally = merged([tallies[unit] for unit in refusing])
    known = [poll for unit in refusing for poll in polls.get(unit, ())]
    is_scan = are_all(known, tally) and len(known) >= max(SCAN, ONCE * tally.requests)
    masters = {poll.key.master for poll in known}
    return JointRefusals(
        units=len(refusing),
        of=len(tallies),
        tally=tally,
        scanned=len(known) if is_scan else 0,
        master=masters.pop() if is_scan and len(masters) == 1 else "",
    )


def always_refused(polls: Sequence[PollStatistics], tally: RequestTally) -> list[PollStatistics]:
    """Return the polls (repeated requests) that a unit refuses each time.

    `tally` has the counts of the unit, `polls` those of its polls that are still known. The list is
    empty if some are no longer known, if other refusals remain, or if the unit refuses all that it
    is asked.
    """
    refused = [poll for poll in polls if poll.tally.count(Outcome.EXCEPTION)]
    number = sum(poll.tally.transactions for poll in refused)
    is_certain = number == tally.count(Outcome.EXCEPTION) and are_all(polls, tally)
    return refused if is_certain and len(refused) < len(polls) else []


def are_all(polls: Sequence[PollStatistics], tally: RequestTally) -> bool:
    """False if some of the requests of `tally` are of polls that are no longer known."""
    return sum(poll.tally.requests for poll in polls) >= tally.requests
