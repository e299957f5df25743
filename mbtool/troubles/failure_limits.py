"""The limits by which `stats`, `report` and `watch` judge failed requests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus import RESPONDED

if TYPE_CHECKING:
    from mbtool.ledger.request_tally import RequestTally

FEW = 0.01
"""Failures of a unit are a small thing if they are a smaller share of its requests than this (0.01
is 1 %)."""
ENOUGH = 3
"""Failures of a unit are a small thing if they are fewer than this."""
THROUGHOUT = 0.1
"""A failure that shows in this first share (0.1 is 10 %) of a unit's time was there from the
beginning."""
ENDED = 0.25
"""A failure that does not show in this last share (0.25 is 25 %) of a unit's time has ended."""
SPREAD = 0.01
"""Failures that show in a smaller share of a unit's time than this have no time of their own."""


def is_grave(failed: int, asked: int) -> bool:
    """True if so many of a unit's requests failed that it is more than a small thing."""
    return failed >= ENOUGH and failed >= FEW * asked


def never_answers(tally: RequestTally) -> bool:
    """True if a unit was asked, and nothing was heard from it that could be read."""
    is_heard = tally.requests < tally.transactions or any(map(tally.count, RESPONDED))
    return tally.surely_unanswered > 0 and not is_heard


def are_damaged(tally: RequestTally) -> bool:
    """True if most of the missing answers came, but with a wrong CRC or LRC."""
    return tally.damaged * 2 > tally.unanswered


def time_of_failures(begin: int, first: int, last: int, end: int) -> tuple[bool, bool]:
    """Return if failures of a unit came late, and if they have ended.

    The unit was asked from `begin` to `end`, and requests failed from `first` to `last`, in any
    unit of time. If one is true, the failures are counted, and judged by `is_grave`, in their time
    only.
    """
    whole = end - begin
    if last - first < SPREAD * whole:
        return False, False
    return first - begin > THROUGHOUT * whole, end - last > ENDED * whole
