"""Computes which share of the requests to a unit failed, and from when to when."""

# The share counts only requests in the time of the failures. The number of these requests is the
# sum of time bins (ledger/time_bins.py), so it can be wrong by a part of a bin.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.moments import DAY_NS
from mbtool.modbus import RESPONDED, Outcome

if TYPE_CHECKING:
    from mbtool.ledger.request_tally import RequestTally
    from mbtool.ledger.unit_account import FailureSpan, UnitAccount

# Limits with which `stats`, `report` and `watch` judge failed requests.

MIN_FAILED_SHARE = 0.01
"""Failures are grave only if they are at least this share (0 to 1) of the requests to a unit."""
MIN_FAILED = 3
"""Failures are grave only if they are at least this many of the requests to a unit."""
THROUGHOUT = 0.1
"""If no request failed in this first share (0 to 1) of the time in which a unit was asked, the
failures came late, and the report names the time of the first one. Else they were there from the
beginning."""
ENDED = 0.25
"""If no request failed in this last share (0 to 1) of the time in which a unit was asked, the
failures have ended, and the report names the time of the last one."""
SPREAD = 0.01
"""If the time from the first to the last failure is less than this share (0 to 1) of the time in
which a unit was asked, the report names no time: the failures are counted among all requests."""


def is_grave(failed: int, asked: int) -> bool:
    """True if at least MIN_FAILED requests of a unit failed, and at least the share
    MIN_FAILED_SHARE of them.
    """
    return failed >= MIN_FAILED and failed >= MIN_FAILED_SHARE * asked


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


_SHORTEST_NS = 2_000_000_000
"""A trouble names no time of failures if the unit was asked for less than this (ns), because times
are shown in whole seconds."""


class FailedShare(NamedTuple):
    """The number of requests to a unit that failed in one way, and of all requests in that time."""

    failed: int
    asked: int
    """The number of requests in the time from `since_ns` to `until_ns`."""
    since_ns: int | None = None
    """The time (ns since 1970) of the first failure; None if requests failed from the beginning."""
    until_ns: int | None = None
    """The time (ns since 1970) of the last failure; None if the failures have not ended."""
    is_long: bool = False
    """True if the unit was asked for a day or longer, so that times need a date."""

    @property
    def share(self) -> float:
        return self.failed / max(self.asked, self.failed)

    @property
    def is_grave(self) -> bool:
        return is_grave(self.failed, max(self.asked, self.failed))


def missing_share(tally: RequestTally, times: UnitAccount | None) -> FailedShare | None:
    """Return which share of a unit's requests got no answer; None if all got one. Ambiguous ones
    are left out.

    If the failures came late or have ended, the share is of the requests from the first failure to
    the last one or the end. Else, and without `times`, it is of all. If that is a small thing, but
    the unit is silent in the end, the share is of the requests since.
    """
    share = _share(tally.surely_unanswered, tally, times, None if times is None else times.missing)
    if share is None or times is None:
        return share
    is_silent = times.silent_since_ns > times.answered_ns
    if is_silent and share.failed == times.silent and share.since_ns is not None:
        return share._replace(asked=share.failed)
    if share.is_grave:
        return share
    silence_ns = times.last_ns - times.silent_since_ns
    if is_silent and times.silent >= MIN_FAILED and silence_ns >= _SHORTEST_NS:
        return FailedShare(
            times.silent, times.silent, times.silent_since_ns, is_long=_is_long(times)
        )
    return share


def refused_share(tally: RequestTally, times: UnitAccount | None) -> FailedShare | None:
    """Return which share of a unit's requests was refused; None if none was. As missing_share."""
    number = tally.count(Outcome.EXCEPTION)
    return _share(number, tally, times, None if times is None else times.refused)


def _share(
    failed: int, tally: RequestTally, times: UnitAccount | None, span: FailureSpan | None
) -> FailedShare | None:
    if not failed:
        return None
    if times is None or span is None or failed < MIN_FAILED:
        return FailedShare(failed, tally.requests)
    is_late, is_over = time_of_failures(times.first_ns, span.first_ns, span.last_ns, times.last_ns)
    if times.last_ns - times.first_ns < _SHORTEST_NS or not (is_late or is_over):
        return FailedShare(failed, tally.requests)
    before = times.bins.asked_before(span.first_ns) if is_late else 0
    end = times.bins.asked_before(span.last_ns) + 1 if is_over else tally.requests
    return FailedShare(
        failed,
        max(end - before, failed),
        span.first_ns if is_late else None,
        span.last_ns if is_over else None,
        is_long=_is_long(times),
    )


def _is_long(times: UnitAccount) -> bool:
    return times.last_ns - times.first_ns >= DAY_NS
